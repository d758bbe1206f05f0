"""A growing model as a ladder: one rung an effect, the held-out error of every joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from ident.diagnose.phrases import labels
from ident.diagnose.report import diagnosis_parts
from ident.diagnose.tables import TIE, WIDTH, wrapped
from ident.fit.report import figure_html, page, table_html, text
from ident.fit.score import Error
from ident.fit.summary import percent

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
    lines = [_row(_changed(step), _cells(step.errors, joints), _fall(step), width)]
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


def _changed(step: Step) -> str:
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
        rows.append([f"{_changed(step)}{removed}", *cells, _fall(step), rivals])
    return rows


def _table(history: History) -> str:
    """In HTML, where nothing but the rivals may be broken into lines."""
    rows = ladder_rows(history)
    return table_html([[*(cell.replace(" ", TIE) for cell in row[:-1]), row[-1]] for row in rows])


def plot_ladder(history: History) -> Figure:
    """Held-out error of every joint against the rungs."""
    joints = history.fit.motion.independent
    figure = Figure(figsize=(9, 4.8), layout="constrained")
    axis = figure.subplots()
    places = list(range(len(history.steps)))
    for i, joint in enumerate(joints):
        errors = [step.errors[joint] for step in history.steps]
        relative = [e.relative for e in errors]
        if any(each is None for each in relative):  # no torque to be relative to
            continue
        y = [100 * each for each in relative if each is not None]
        axis.plot(places, y, "o-", ms=4, color=f"C{i % 10}", label=joint)
    axis.set_yscale("log")
    axis.set_xticks(places, [_changed(step) for step in history.steps], rotation=30, ha="right")
    axis.set_ylabel("held-out error of the torque [%]")
    axis.grid(alpha=0.3, which="both")
    if axis.lines:
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
    return figure


def history_html(history: History) -> bytes:
    """report.html of a grown model: the ladder, then the last diagnosis."""
    title = f"{history.mechanism.name}: grown model"
    added = [effect.label for effect in history.added]
    parts = [
        f"<h1>{text(title)}</h1>",
        f"<p>Added: {text(', '.join(added) or 'nothing')}.</p>",
        "<h2>Held-out error, rung by rung</h2>",
        _table(history),
        figure_html(plot_ladder(history), "held-out error of every joint, rung by rung"),
        "<h2>Diagnosis of the last model</h2>",
        *diagnosis_parts(history.diagnosis),
    ]
    return page(title, parts).encode()
