"""A model that grew: the ladder of held-out errors as text, table, chart, report and files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ident.diagnosis.grow import History, Step
from ident.display import renders
from ident.errors import IdentError
from ident.files import json_bytes, write_all
from ident.fit import Fit
from ident.fit.files import fit_json, multipliers_csv
from ident.information.blocks import Error
from ident.mechanism import Mechanism
from ident.mechanism.write import folder_files
from ident.show.card import Bar, Card
from ident.show.charts import Chart, Line, Panel
from ident.show.diagnosis import errors_of, labels, verdict_line
from ident.show.diagnosis_report import diagnosis_files, diagnosis_sections
from ident.show.html import Page, Section, table
from ident.show.sheet import Sheet
from ident.text import WIDTH, percent, wrapped

NAME, CELL, FALL = 30, 7, 7  # characters of the columns
CAPTION = "Held-out error, rung by rung"


# --- text -----------------------------------------------------------------------------------------


def head(joints: Sequence[str]) -> str:
    """Return the ladder's head; joints whose names do not fit beside each other are numbered."""
    names, lines = list(joints), ["held-out error"]
    if len(_row("", names, "")) > WIDTH:
        names = [f"[{i + 1}]" for i in range(len(names))]
        legend = ", ".join(f"[{i + 1}] {joint}" for i, joint in enumerate(joints))
        lines = wrapped(f"held-out error of {legend}", "  ")
    return "\n".join([*lines, _row("effect", names, "fall")])


def rung(step: Step, joints: Sequence[str]) -> str:
    """Return one rung: what was added, errors, the fall of the held-out weighted squares."""
    numbered = len(_row("", joints, "")) > WIDTH
    width = [0 if numbered else len(joint) for joint in joints]
    lines = [_row(changed(step), _cells(step.errors, joints), _fall(step), width)]
    for log, errors in step.fit.validation.items() if step.fit else ():
        name = log if len(log) <= NAME - 4 else f"…{log[-(NAME - 5) :]}"
        lines.append(_row(f"  on {name}", _cells(errors, joints), "", width))
    if step.rivals:
        lines += wrapped(f"    or {labels(step.rivals, 'or')}: not distinguishable", "      ")
    if step.removed and (step.added is not None or len(step.removed) > 1):
        lines += wrapped(f"    without {labels(step.removed)}: superfluous now", "      ")
    return "\n".join(lines)


def changed(step: Step) -> str:
    """Return what this rung adds to the one before, or removes from it."""
    if step.added is not None:
        return f"+ {step.added.label}"
    if len(step.removed) == 1:
        return f"− {step.removed[0].label}"
    return f"− {len(step.removed)} effects" if step.removed else "as given"


def _row(first: str, cells: Sequence[str], last: str, least: Sequence[int] = ()) -> str:
    widths = (max(CELL, each) for each in least or [0] * len(cells))
    middle = [cell.rjust(width) for cell, width in zip(cells, widths, strict=True)]
    return "  ".join([first.ljust(NAME), *middle, last.rjust(FALL)]).rstrip()


def _fall(step: Step) -> str:
    about = "" if step.fit else "≈ "  # announced by the search, not fitted
    return "" if step.added is None else f"{about}{100 * step.fall:.1f} %"


def _cells(errors: Mapping[str, Error], joints: Sequence[str]) -> list[str]:
    """Return relative errors; of a joint without torque its rms."""
    found = (errors.get(joint) for joint in joints)
    return [
        "–" if e is None else f"{e.rms:.2g}" if e.relative is None else percent(e.relative)
        for e in found
    ]


renders(Step, "text")(lambda step: rung(step, list(step.errors)))


@renders(History, "text")
def text(history: History) -> str:
    """Return the whole ladder."""
    joints = history.fit.motion.independent
    return "\n".join([head(joints), *(rung(step, joints) for step in history.steps)])


@renders(History, "ladder")
def rows(history: History) -> list[list[str]]:
    """Return a table: effect, a column a joint, fall, rivals."""
    joints = history.fit.motion.independent
    found = [["effect", *joints, "fall", "rivals"]]
    for step in history.steps:
        removed = ""
        if step.added is not None or len(step.removed) > 1:
            removed = "".join(f" − {effect.label}" for effect in step.removed)
        cells = [*_cells(step.errors, joints), _fall(step)]
        rivals = labels(step.rivals, "or") if step.rivals else ""
        found.append([f"{changed(step)}{removed}", *cells, rivals])
    return found


@renders(History, "sheet")
def sheet(history: History) -> Sheet:
    """Return the verdict and the ladder."""
    return Sheet(verdict_line(history.diagnosis), tables={CAPTION: history.table()})


@renders(History, "plot")
def plot(history: History) -> Chart:
    """Draw the held-out error of every joint against the rungs."""
    names = [changed(step) for step in history.steps]
    return plot_rungs(names, [step.errors for step in history.steps])


def plot_rungs(names: Sequence[str], errors: Sequence[Mapping[str, Error]]) -> Chart:
    """Draw the held-out error of every joint against models one after the other."""
    at = np.arange(len(names), dtype=float)
    lines = []
    for i, joint in enumerate(errors[0]):
        y = [each[joint].relative or 0.0 for each in errors]
        if all(y):  # else there is no torque to be relative to
            lines.append(Line(at, 100 * np.array(y), joint, i, 1.6, dotted=True))
    panel = Panel(
        tuple(lines), "", "held-out error [%]", logarithmic=True, height=4.0,
        x_names=tuple(names),
    )  # fmt: skip
    return Chart("Held-out error of every joint, rung by rung", ((panel,),))


# --- report and files -----------------------------------------------------------------------------


def history_card(history: History) -> Card:
    """Return what was added, the verdict on what is left, and the error before and after."""
    d = history.diagnosis
    added = ", ".join(effect.label for effect in history.added) or "nothing"
    first = history.steps[0].errors
    bars = tuple(
        Bar(joint, first[joint], error, d.floor[joint]) for joint, error in errors_of(d).items()
    )
    return Card(f"Added: {added}.", f"Now {verdict_line(d)}.", bars)


@renders(History, "files")
def write(history: History, folder: str | Path) -> list[Path]:
    """Write the grown mechanism's folder, with the last fit, diagnosis and a report of the ladder.

    Unknown parameters stay unknown in it: values are in fit.json.

    Raises:
        IdentError: if it is the folder of the mechanism itself, or cannot be written.
    """
    refuse_own(history.mechanism, Path(folder))
    ladder = Section("The error falls", (plot(history), table(rows(history), CAPTION, tied=False)))
    sections = (ladder, *diagnosis_sections(history.diagnosis))
    page = Page(f"{history.mechanism.name}: grown model", history_card(history), sections)
    data = {**diagnosis_files(history.diagnosis), "report.html": page.html()}
    return write_all(Path(folder), model_files(history.fit) | data)


def model_files(fit: Fit) -> dict[str, bytes]:
    """Return the folder of a fit's mechanism, its unknowns unknown, with fit.json, multipliers."""
    mechanism = fit.mechanism
    effects = [(effect, effect.values) for effect in mechanism.effects]
    files = folder_files(mechanism, mechanism.urdf.read_bytes(), effects, unknown=None)
    return files | {"fit.json": json_bytes(fit_json(fit)), "multipliers.csv": multipliers_csv(fit)}


def refuse_own(mechanism: Mechanism, folder: Path) -> None:
    """Refuse to replace what a person wrote by what a program has grown.

    Raises:
        IdentError: if `folder` holds the mechanism's own files.
    """
    for path in (mechanism.toml, mechanism.urdf):
        if path is not None and path.parent.resolve() == folder.resolve():
            raise IdentError(
                f"{folder}: holds {path.name} of the mechanism itself, which is not overwritten; "
                "name another folder, or change it with `ident add`"
            )
