"""A diagnosis as tables and words that fit into a terminal of 100 columns."""

from __future__ import annotations

import re
import textwrap
from typing import TYPE_CHECKING

from ident.diagnose.explanation import Explanation
from ident.diagnose.phrases import closure, labels, listed, numbers, remaining
from ident.text import percent, table

if TYPE_CHECKING:
    from ident.diagnose.diagnosis import Diagnosis

WIDTH = 100
SIGNALS = 2  # on which a residual depends, in the table
UNITS = re.compile(r"(?<=[\d?]) (%|(N m|N|rad|kg|m|s)\b( s²?/| m²)?)| ± ")
TIE = "\u00a0"
Rows = list[list[str]]


def verdict_line(d: Diagnosis) -> str:
    """The verdict in one sentence."""
    if d.verdict == "missing":
        best = d.candidates[0].effect
        if not d.rivals:
            return f"missing: {best.label}"
        return f"missing: {labels([best, *d.rivals], 'or')}, which this data cannot tell apart"
    if d.verdict == "nothing":
        near = remaining(d)
        but = f"; but not all that is left in {listed(near)} is noise" if near else ""
        return f"nothing is missing that this data could show{but}"
    return "unexplained: something is missing, and no effect of the library explains it"


def summary(d: Diagnosis) -> str:
    """What `print` and the command show: the verdict, two tables, and all of it in words."""
    logs = ", ".join(e.name for e in d.fit.motion.experiments)
    lines = wrapped(f"{d.fit.mechanism.name} on {logs}: {verdict_line(d)}", "  ")
    lines += ["", "where it fails", *table(where_rows(d))]
    if d.candidates:
        head, *body = table(candidate_rows(d))
        lines += ["", "what adding an effect would do, held out", head]
        for line, each in zip(body, d.candidates, strict=True):
            lines.append(line)
            if d.verdict != "nothing":
                lines += wrapped(f"      {numbers(each.parameters)}", "      ")
    for paragraph in d.text.split("\n\n"):
        lines += ["", *wrapped(paragraph)]
    return "\n".join(lines)


def where_rows(d: Diagnosis) -> Rows:
    """Joint by joint: held-out error, noise floor, what repeats, on what the residual depends."""
    repeats = d.periods is not None
    rows = [["joint", "held out", "", "noise", "of misfit", "repeats", "depends on"]]
    errors = d.fit.held_out or d.fit.train
    for f in d.where:
        error = errors[f.joint]
        signals = [each.signal for each in f.depends_on[:SIGNALS]]
        if not signals:
            signals = ["noise" if f.white else "no single signal"]
        rows.append(
            [
                f.joint,
                f"{error.rms:.3g} {f.unit}",
                percent(error.relative),
                f"{d.floor[f.joint]:.2g} {f.unit}",
                f"{100 * f.share:.0f} %",
                "" if f.repeats is None else f"{f.repeats:.2f}",
                ", ".join(signals),
            ]
        )
    return rows if repeats else [[*row[:5], row[6]] for row in rows]


def candidate_rows(d: Diagnosis) -> Rows:
    """One a candidate that was refitted, best first; `=` marks what this data cannot tell apart."""
    rows = [["effect", "of joint", "error", "fall", "z", "gap closed", "visible"]]
    for i, each in enumerate(d.candidates):
        rows.append([f"{mark(d, i)} {each.effect.label}", each.joint, *_figures(d, each)])
    return rows


def mark(d: Diagnosis, i: int) -> str:
    """`*` for the best, `=` for its rivals."""
    if d.verdict != "missing":
        return " "
    rivals = {effect.label for effect in d.rivals}
    return "*" if i == 0 else "=" if d.candidates[i].effect.label in rivals else " "


def _figures(d: Diagnosis, each: Explanation) -> list[str]:
    return [
        f"{percent(each.error_before)} → {percent(each.error_after)}",
        f"{100 * each.fall:.1f} %",
        f"{each.evidence.z:.1f}",
        "–" if d.verdict == "nothing" else closure(each.evidence),  # there is no gap
        f"{100 * each.evidence.candidate.judged.visible:.0f} %",
    ]


def error_matrix(d: Diagnosis) -> Rows:
    """Held-out error of every joint as it is, with each candidate, and what noise would leave."""
    errors = d.fit.held_out or d.fit.train
    rows = [["", *errors], ["as it is", *(f"{e.rms:.3g} {e.unit}" for e in errors.values())]]
    for i, each in enumerate(d.candidates):
        cells = [f"{each.after[joint].rms:.3g}" for joint in errors]
        rows.append([f"{mark(d, i)} {each.effect.label}".strip(), *cells])
    return [*rows, ["noise alone", *(f"{d.floor[joint]:.3g}" for joint in errors)]]


def wrapped(text: str, indent: str = "") -> list[str]:
    """Lines of at most 100 characters, numbers and their units together."""
    lines = textwrap.wrap(
        tied(text), WIDTH, subsequent_indent=indent, break_on_hyphens=False, break_long_words=False
    )
    return [line.replace(TIE, " ") for line in lines]


def tied(text: str) -> str:
    """With unbreakable spaces between numbers and their units."""
    return UNITS.sub(lambda found: found[0].replace(" ", TIE), text)
