"""A growing model as a ladder: one rung an effect, the held-out error of every joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from ident.diagnose.phrases import labels
from ident.diagnose.tables import WIDTH, wrapped
from ident.residual.error import Error
from ident.text import percent

if TYPE_CHECKING:
    from ident.diagnose.grow import History, Step

START = "as given"
NAME, CELL, FALL = 30, 7, 7  # characters of the columns
GAP = "  "


def head(joints: Sequence[str]) -> str:
    """The ladder's head; joints whose names do not fit beside each other are numbered."""
    names = list(joints)
    lines = ["held-out error"]
    if len(_row("", names, "")) > WIDTH:
        names = [f"[{i + 1}]" for i in range(len(names))]
        legend = ", ".join(f"[{i + 1}] {joint}" for i, joint in enumerate(joints))
        lines = wrapped(f"held-out error of {legend}", "  ")
    return "\n".join([*lines, _row("effect", names, "fall")])


def rung(step: Step, joints: Sequence[str]) -> str:
    """One rung: what was added, errors, the fall of the held-out weighted sum of squares."""
    numbered = len(_row("", joints, "")) > WIDTH
    width = [0 if numbered else len(joint) for joint in joints]
    lines = [_row(changed(step), _cells(step.errors, joints), _fall(step), width)]
    for log, errors in step.fit.validation.items():
        name = log if len(log) <= NAME - 4 else f"…{log[-(NAME - 5) :]}"
        lines.append(_row(f"  on {name}", _cells(errors, joints), "", width))
    if step.rivals:
        lines += wrapped(f"    or {labels(step.rivals, 'or')}: not to be told apart", "      ")
    if step.removed and (step.added is not None or len(step.removed) > 1):
        lines += wrapped(f"    without {labels(step.removed)}: superfluous now", "      ")
    return "\n".join(lines)


def _row(first: str, cells: Sequence[str], last: str, least: Sequence[int] = ()) -> str:
    width = least or [0] * len(cells)
    middle = [cell.rjust(max(CELL, w)) for cell, w in zip(cells, width, strict=True)]
    return GAP.join([first.ljust(NAME), *middle, last.rjust(FALL)]).rstrip()


def changed(step: Step) -> str:
    """What this rung has that the one before had not, or the reverse."""
    if step.added is not None:
        return f"+ {step.added.label}"
    if len(step.removed) == 1:
        return f"− {step.removed[0].label}"
    return f"− {len(step.removed)} effects" if step.removed else START


def _fall(step: Step) -> str:
    return "" if step.added is None else f"{100 * step.fall:.1f} %"


def _cells(errors: Mapping[str, Error], joints: Sequence[str]) -> list[str]:
    """Relative errors; of a joint without torque its rms."""
    found = []
    for joint in joints:
        error = errors.get(joint)
        if error is None:
            found.append("–")
        else:
            found.append(f"{error.rms:.2g}" if error.relative is None else percent(error.relative))
    return found


def ladder_text(history: History) -> str:
    """The whole ladder."""
    joints = history.fit.motion.independent
    return "\n".join([head(joints), *(rung(step, joints) for step in history.steps)])


def ladder_rows(history: History) -> list[list[str]]:
    """As a table: effect, a column a joint, fall, rivals."""
    joints = history.fit.motion.independent
    rows = [["effect", *joints, "fall", "rivals"]]
    for step in history.steps:
        rivals = labels(step.rivals, "or") if step.rivals else ""
        removed = ""
        if step.added is not None or len(step.removed) > 1:
            removed = "".join(f" − {effect.label}" for effect in step.removed)
        cells = _cells(step.errors, joints)
        rows.append([f"{changed(step)}{removed}", *cells, _fall(step), rivals])
    return rows
