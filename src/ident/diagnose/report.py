"""report.html of a diagnosis: one file that opens without a network."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ident.diagnose.hidden import Invisible
from ident.diagnose.phrases import failing, numbers
from ident.diagnose.plots import plot_added, plot_candidates
from ident.diagnose.support import Unsupported
from ident.diagnose.tables import (
    TIE,
    candidate_rows,
    error_matrix,
    mark,
    tied,
    verdict_line,
    where_rows,
)
from ident.fit.report import figure_html, page, table_html, text
from ident.residual import Residual, residual_of
from ident.residual.plots import plot_maps

if TYPE_CHECKING:
    from ident.diagnose.diagnosis import Diagnosis

CODE = re.compile(r"`([^`]*)`")
JOINTS = 3  # whose maps are drawn
TITLES = {
    "missing": "What is missing",
    "nothing": "What adding an effect would do",
    "unexplained": "What comes nearest",
}
MARKS = "* named; = this data cannot tell it from the one named."


def diagnosis_html(d: Diagnosis) -> bytes:
    """The page of a diagnosis."""
    title = f"{d.fit.mechanism.name}: diagnosis"
    return page(title, [f"<h1>{text(title)}</h1>", *diagnosis_parts(d)]).encode()


def diagnosis_parts(d: Diagnosis) -> list[str]:
    """Verdict, where it fails, candidates, what is invisible or unsupported, the data's health."""
    parts = [f"<p><strong>{text(_capital(verdict_line(d)))}.</strong></p>"]
    parts += [f"<p>{_code(text(paragraph))}</p>" for paragraph in d.text.split("\n\n")]
    residuals = _residuals(d)
    parts += ["<h2>Where the model fails</h2>", table_html(where_rows(d)), *_maps(d, residuals)]
    if d.candidates:
        parts += _candidates(d, residuals)
    if d.suggestion is not None:
        parts += [
            "<h2>Suggested expression</h2>",
            f"<p>{text(str(d.suggestion))}</p><pre>{text(d.suggestion.code)}</pre>",
        ]
    if d.invisible:
        parts += ["<h2>Invisible in this data</h2>", _reasons(d.invisible)]
    if d.unsupported:
        parts += ["<h2>In the model, but not supported</h2>", _reasons(d.unsupported)]
    return [*parts, "<h2>Health of the data</h2>", f"<pre>{text(str(d.health))}</pre>"]


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]


def _code(words: str) -> str:
    """What stands between backticks, as code."""
    return CODE.sub(r"<code>\1</code>", words)


def _reasons(found: Sequence[Invisible | Unsupported]) -> str:
    """Effects with what is to be said of them, one line each."""
    items = [f"<li>{text(each.effect.label)}: {text(each.why)}</li>" for each in found]
    return f"<ul>{''.join(items)}</ul>"


def _residuals(d: Diagnosis) -> dict[str, Residual]:
    """As it is, and with the first candidate, where one is worth a look."""
    found = {"as it is": residual_of(d.fit, name="as it is")}
    if d.verdict != "nothing" and d.candidates:
        best = d.candidates[0]
        name = f"with {best.effect.label}"
        found[name] = residual_of(best.fit, name=name)
    return found


def _maps(d: Diagnosis, residuals: dict[str, Residual]) -> list[str]:
    joints = [each.joint for each in failing(d)[:JOINTS]] or [d.where[0].joint]
    return [
        figure_html(plot_maps(residuals, joint), f"residual of {joint} against its signals")
        for joint in joints
    ]


def _candidates(d: Diagnosis, residuals: dict[str, Residual]) -> list[str]:
    head, *rows = candidate_rows(d)
    shown = [[*head, "parameters"]]
    shown += [
        [*(cell.replace(" ", TIE) for cell in row), tied(numbers(each.parameters))]
        for row, each in zip(rows, d.candidates, strict=True)
    ]
    parts = [
        f"<h2>{TITLES[d.verdict]}</h2>",
        table_html(shown),
        figure_html(plot_candidates(d), "held-out fall of every candidate"),
    ]
    if any(mark(d, i).strip() for i in range(len(d.candidates))):
        parts.insert(2, f"<p>{MARKS}</p>")
    before, *after = residuals.values()
    if after and (figure := plot_added(before, after[0], d.candidates[0])) is not None:
        label = d.candidates[0].effect.label
        parts += [
            f"<h3>{text(label)} alone, all else taken off</h3>",
            "<p>Each point is a row of the fit. What is really this effect lies along the line; "
            "a bend or a loop is something else.</p>",
            figure_html(figure, f"residual against what {label} explains"),
        ]
    return [
        *parts,
        "<h3>Held-out error of every joint, with each of them</h3>",
        table_html(error_matrix(d)),
    ]
