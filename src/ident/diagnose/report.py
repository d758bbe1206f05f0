"""report.html of a diagnosis and of a grown model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ident.diagnose.explanation import Explanation
from ident.diagnose.hidden import Invisible
from ident.diagnose.phrases import labels, numbers, what
from ident.diagnose.plots import plot_added, plot_before_after, plot_candidates, plot_ladder
from ident.diagnose.support import Unsupported
from ident.diagnose.tables import (
    candidate_rows,
    error_matrix,
    mark,
    tied,
    verdict_line,
    where_rows,
)
from ident.fit.report import found, misfit
from ident.motion.report import made_of, understood
from ident.residual import residual_of
from ident.residual.plots import plot_maps
from ident.show.html import (
    Block,
    Choice,
    Option,
    Page,
    Section,
    code,
    headed,
    items,
    paragraph,
    table,
)
from ident.text import percent

if TYPE_CHECKING:
    from ident.diagnose.diagnosis import Diagnosis
    from ident.diagnose.grow import History

MOST = 8  # candidates whose residuals are drawn
TITLES = {
    "missing": "What is missing",
    "nothing": "What adding an effect would do",
    "unexplained": "What comes nearest",
}
MARKS = "* named; = this data cannot tell it from the one named."
FALLS = (
    "The chart counts all joints, weighed, on rows away from reversals, ± one standard error over "
    "stretches of time; the table the error of one joint on all rows. z: the fall in standard "
    "errors, candidate by candidate; gap closed: of what noise does not explain; visible: how much "
    "of its torque no other parameter could take over."
)
ADDED = (
    "Each point is a row of the fit. What is really this effect lies along the line; a bend or a "
    "loop is something else."
)


def diagnosis_html(d: Diagnosis, first: Sequence[Section] = ()) -> bytes:
    """The page of a diagnosis, after further sections."""
    sections = (*first, *diagnosed(d), *_basis(d))
    return Page(f"{d.fit.mechanism.name}: diagnosis", _capital(verdict_line(d)), sections).html()


def history_html(history: History) -> bytes:
    """The page of a grown model: the ladder, the last diagnosis, the last fit."""
    d, added = history.diagnosis, [effect.label for effect in history.added]
    ladder = Section(
        "The error falls",
        (
            paragraph(f"Added: {', '.join(added) or 'nothing'}."),
            plot_ladder(history),
            table(history.table(), "Held-out error, rung by rung", tied=False),
        ),
    )
    title = f"{history.mechanism.name}: grown model"
    return Page(title, _capital(verdict_line(d)), (ladder, *diagnosed(d), *_basis(d))).html()


def _basis(d: Diagnosis) -> tuple[Section, ...]:
    """The fit that was diagnosed, and what it was made of."""
    mechanism, motion = d.fit.mechanism, d.fit.motion
    return (
        *misfit(d.fit),
        *found(d.fit),
        understood(mechanism, motion),
        made_of(mechanism, motion),
    )


def diagnosed(d: Diagnosis) -> tuple[Section, ...]:
    """Verdict, candidates, what is invisible or unsupported, the data's health."""
    words = tuple(paragraph(each) for each in d.text.split("\n\n"))
    where = table(where_rows(d), "Joint by joint: held-out error, and what noise would leave")
    suggestion: tuple[Block, ...] = ()
    if d.suggestion is not None:
        suggestion = (paragraph(str(d.suggestion)), code(d.suggestion.code))
    return (
        Section("Where it fails", (where,)),
        Section(TITLES[d.verdict], _candidates(d)),
        Section("In words", words),
        Section("Suggested expression", suggestion),
        Section("Invisible in this data", _reasons(d.invisible)),
        Section("In the model, but not supported", _reasons(d.unsupported)),
        Section("Health of the data", (code(str(d.health)),)),
    )


def _capital(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."


def _reasons(hidden: Sequence[Invisible | Unsupported]) -> tuple[Block, ...]:
    """Effects with what is to be said of them, one line each."""
    return (items(f"{each.effect.label}: {each.why}" for each in hidden),) if hidden else ()


def _candidates(d: Diagnosis) -> tuple[Block, ...]:
    """All of them beside each other; each by itself, before and after; the table of all joints."""
    if not d.candidates:
        return ()
    head, *rows = candidate_rows(d)
    shown = [[*head, "parameters"]]
    shown += [
        [*row, tied(numbers(each.parameters))] for row, each in zip(rows, d.candidates, strict=True)
    ]
    marked = any(mark(d, i).strip() for i in range(len(d.candidates)))
    options = tuple(_option(d, i, each) for i, each in enumerate(d.candidates[:MOST]))
    return (
        *((paragraph(MARKS),) if marked else ()),
        plot_candidates(d),
        paragraph(FALLS),
        table(shown, "Candidates, refitted; errors are held out in time"),
        headed("Its residual before and after"),
        Choice("Which candidate", options),
        table(error_matrix(d), "Held-out error of every joint, with each of them"),
    )


def _option(d: Diagnosis, i: int, each: Explanation) -> Option:
    """What one candidate would do."""
    before, after = d.fit.residual, residual_of(each.fit)
    label = each.effect.label
    both = {"as it is": before, f"with {label}": after}
    said = [
        what(each.effect),
        f"held-out error of {each.joint}: {percent(each.error_before)} → "
        f"{percent(each.error_after)}; noise alone would leave {d.floor[each.joint]:.2g} "
        f"{before.units[before.joints.index(each.joint)]}",
        numbers(each.parameters),
    ]
    if each.rivals:
        said.append(f"not to be told from it by this data: {labels(each.rivals, 'or')}")
    charts = (plot_before_after(before, after, each), plot_maps(both, each.joint))
    added = plot_added(before, after, each)
    last: tuple[Block, ...] = ()
    if added is not None:
        last = (headed(f"{label} alone, all else taken off"), paragraph(ADDED), added)
    name = f"{mark(d, i)} {label}".strip()
    return Option(name, (headed(f"With {label}"), items(said), *charts, *last))
