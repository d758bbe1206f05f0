"""The ladder of a model that grew: text, tables, chart, report, files."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.assess.diagnosis import (
    assess_growth,
    before_words,
    causes_of_growth,
    larger_on_validation,
)
from ident.assess.errors import largest_change, noise_errors
from ident.assess.exploration import Exploration
from ident.assess.verdict import formulas_explain
from ident.diagnosis.grow import NAME as ROUNDS
from ident.diagnosis.grow import History
from ident.diagnosis.grow import Step as Rung
from ident.diagnosis.unobservable import name_of
from ident.display import renders
from ident.effects.library import named
from ident.errors import FitError, IdentError
from ident.files import json_bytes, write_all
from ident.fit import Fit
from ident.fit.files import fit_json, identified_files, identified_urdf, multipliers_csv, own_files
from ident.information.blocks import Error
from ident.mechanism import Mechanism
from ident.mechanism.write import folder_files
from ident.request import PYTHON, Request, Step, with_noun
from ident.show.card import Card
from ident.show.charts import Chart, Level, Line, Mark, Panel
from ident.show.diagnosis import card, short
from ident.show.diagnosis import sheet as diagnosis_sheet
from ident.show.diagnosis_report import diagnosis_files, diagnosis_sections, write_instead
from ident.show.error_axis import ErrorAxis
from ident.show.front import FirstScreen, first_screen, main_effect
from ident.show.headline import headline, values_words
from ident.show.html import Section, Sheet, report_page, table
from ident.show.verdict import formulas_of
from ident.text import percent, shortlist, significant, width, wrapped
from ident.text import table as text_table

NAME, CELL = 30, 7  # characters of the columns
LONG = "+ viscous friction in "  # and a joint: as long as most names are
NOISE, NOTHING_ADDED = "noise alone", "nothing added"
CAPTION = "Held-out error, rung by rung"


# --- text -----------------------------------------------------------------------------------------


def head(joints: Sequence[str]) -> str:
    """Return the ladder's head; joints whose names do not fit beside each other are numbered."""
    names, lines = _columns(joints), ["held-out error"]
    if names != list(joints):
        legend = ", ".join(f"{name} {joint}" for name, joint in zip(names, joints, strict=True))
        lines = wrapped(f"held-out error of {legend}", "  ")
    return "\n".join([*lines, _row("effect", names, joints)])


def _columns(joints: Sequence[str]) -> list[str]:
    wide = NAME + sum(2 + max(CELL, len(joint)) for joint in joints)
    return list(joints) if wide <= width() else [f"[{i + 1}]" for i in range(len(joints))]


def _room(joints: Sequence[str]) -> int:
    """Return the characters of the column of effects: one of a joint is whole, if there is room."""
    longest = max([NAME, *(len(LONG) + len(joint) for joint in joints)])
    wide = longest + sum(2 + max(CELL, len(name)) for name in _columns(joints))
    return longest if wide <= width() else NAME


def _row(first: str, cells: Sequence[str], joints: Sequence[str], last: str = "") -> str:
    columns = zip(cells, _columns(joints), strict=True)
    middle = [cell.rjust(max(CELL, len(name))) for cell, name in columns]
    return "  ".join([first.ljust(_room(joints)), *middle, last]).rstrip()


def rung(step: Rung, joints: Sequence[str]) -> str:
    """Return one rung: what was added, and errors; ≈ marks those that are announced, not fitted."""
    room = _room(joints)
    tied = changed(step).replace("+ ", "+\u00a0").replace("− ", "−\u00a0")  # sign and label
    wrapped_lines = textwrap.wrap(
        tied, room, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
    name, *rest = (line.replace("\u00a0", " ") for line in wrapped_lines)
    lines = [name] * (len(name) > room)  # a line of its own
    name *= not lines
    lines += [_row(name, cells(step.errors, joints), joints, "" if step.fit else "≈"), *rest]
    for log, errors in step.fit.validation.items() if step.fit else ():
        lines.append(_row(f"  on {log[-(NAME - 5) :]}", cells(errors, joints), joints))
    if step.rivals:
        lines += wrapped(f"    or {named(step.rivals, 'or')}: not distinguishable", "      ")
    return "\n".join(lines)


def changed(step: Rung) -> str:
    """Return what this rung adds to the one before, and removes from it."""
    ways = {"+": step.added, "−": step.removed}
    return " ".join(f"{sign} {named(x)}" for sign, x in ways.items() if x) or NOTHING_ADDED


def noise_rung(history: History) -> str:
    """Return the last row of the ladder: what noise alone would leave."""
    joints = history.fit.motion.independent
    return _row(NOISE, cells(noise_errors(history.fit), joints), joints)


def cells(errors: Mapping[str, Error], joints: Sequence[str]) -> list[str]:
    """Return relative errors; of a joint without torque its rms."""
    errors_by_joint = (errors.get(joint) for joint in joints)
    return [
        "–"
        if e is None or e.unmeasured
        else significant(e.rms, 2)
        if e.relative is None
        else percent(e.relative)
        for e in errors_by_joint
    ]


renders(Rung, "text")(lambda step: rung(step, list(step.errors)))


@renders(History, "text")
def text(history: History) -> str:
    """Return the whole ladder."""
    return f"{rungs(history.steps, history.fit.motion.independent)}\n{noise_rung(history)}"


def rungs(steps: Sequence[Rung], joints: Sequence[str]) -> str:
    """Return the ladder without its last row: its head, and one rung a step."""
    return "\n".join([head(joints), *(rung(step, joints) for step in steps)])


@renders(History, "ladder")
def rows(history: History) -> list[list[str]]:
    """Return a table: effect, a column a joint, rivals; ≈ marks errors that are announced."""
    joints = history.fit.motion.independent
    table_rows = [["effect", *joints, "rivals"]]
    for step in history.steps:
        errors = [f"{'' if step.fit else '≈ '}{cell}" for cell in cells(step.errors, joints)]
        rivals = named(step.rivals, "or") if step.rivals else ""
        table_rows.append([changed(step), *errors, rivals])
        held = step.fit.validation.items() if step.fit else ()
        table_rows += [[f"on {log}", *cells(by_joint, joints), ""] for log, by_joint in held]
    return [*table_rows, [NOISE, *cells(noise_errors(history.fit), joints), ""]]


@renders(History, "sheet")
def sheet(history: History) -> Sheet:
    """Return the verdict and the ladder."""
    return Sheet(headline(assess_growth(history)), tables={CAPTION: history.table()})


def plot_rungs(steps: Sequence[Rung], noise: Mapping[str, Error]) -> Chart:
    """Draw the held-out error of every joint against models one after the other; dashed: noise."""
    names = [_code_name(step) for step in steps]
    errors, at = [step.errors for step in steps], np.arange(len(names), dtype=float)
    lines: list[Mark] = []
    for i, joint in enumerate(errors[0]):
        y = [by_joint[joint].relative or 0.0 for by_joint in errors]
        if all(y):  # else there is no torque to be relative to
            lines.append(Line(at, 100 * np.array(y), joint, i, 1.6, dotted=True))
        if floor := joint in noise and noise[joint].relative:
            lines.append(Level(100 * floor, colour=i, dashed=True))
    axis = ErrorAxis.of(
        error.relative for by_joint in (*errors, noise) for error in by_joint.values()
    )
    panel = Panel(
        tuple(lines), "model", "held-out error [%]", logarithmic=True, height=4.0,
        y_range=axis.percents, x_names=tuple(names),
    )  # fmt: skip
    dashed = "; dashed: what noise alone would leave" if noise else ""
    return Chart(f"Held-out error of every joint, rung by rung{dashed}", ((panel,),))


renders(History, "plot")(lambda history: plot_rungs(history.steps, noise_errors(history.fit)))


def _code_name(step: Rung) -> str:
    """Return what a rung changes by code names, which fit below a chart."""
    if len(step.added) > 1:
        return f"+ {step.added[0].kind} in {len(step.added)} places"
    parts = [*(f"− {x.label}" for x in step.removed), *(f"+ {x.label}" for x in step.added)]
    return " ".join(parts) or changed(step)


# --- report and files -----------------------------------------------------------------------------


def screen_of(history: History) -> FirstScreen:
    """Return the joint that changed most from the first rung to the last, and the curve of what
    changed it.
    """
    before, now = history.fits[0].residual, history.fit.residual
    after = replace(now, name="with all that was added")
    if len(history.fits) == 1:
        return first_screen(after, after)
    joint = (largest_change(before.errors, now.errors) or [now.where[0].joint])[0]
    labels = [effect.label for effect in history.added]
    added = [values for values in history.fit.effects if values.effect.label in labels]
    effect = main_effect(now, joint, labels)
    before = replace(before, name=before_words(history.fits[0]).removeprefix("with "))
    sites = [x for values in added if values.effect.label == effect for x in values.effect.joints]
    site = next((x for x in sites if x in history.mechanism.joint_index), joint)
    return first_screen(before, after, joint, effect, {site: effect or joint}, added)


def history_card(history: History, request: Request = PYTHON) -> Card:
    """Return what was gained from the model as given to the last one, and what is left."""
    d = history.diagnosis
    a = assess_growth(history, acceptable=request.acceptable)
    if request == PYTHON:  # the effects that it added are in its own fit's mechanism
        request = with_noun(request, "history.fit")
        a = replace(a, next=replace(a.next, grown=()))
    top = card(d, history.added, request, a)
    line = top.line if a.doubts else f"{headline(a)}{_named_beside(history)}"
    sizes = values_words(causes_of_growth(history))
    values = f"Values: {sizes}. " if sizes else ""
    return replace(top, line=line, sure=f"{values}{_larger(history)}{top.sure}")


def _named_beside(history: History) -> str:
    """Return the formulas that a diagnosis of the grown model gives for what is left."""
    d = history.diagnosis
    if not d.laws or d.best is not None:
        return ""
    does = "explains it" if formulas_explain(d) else "lowers the error"
    return f" A formula {does}: {formulas_of(d)}."


def _larger(history: History) -> str:
    """Return which errors on validation logs were clearly smaller on an earlier rung."""
    text = f"It ends there: with {history.stopped}. " if history.stopped else ""
    for log, joints in larger_on_validation(history).items():
        rises = [f"{joint} ({percent(then)} instead of {percent(x)})" for joint, then, x in joints]
        text += f"On {log} an earlier rung predicts {shortlist(rises, 3)} better: "
        text += "not all that was added after it helps there. "
    return text


# the first lines of a diagnosis, with the error before and after
@renders(History, "short")
def short_of(history: History, request: Request = PYTHON) -> str:
    """Return what was gained, the error by joint, the ladder, and what to do next."""
    return short(history.diagnosis, _top(history, request), request)


@renders(History, "details")
def details(history: History, request: Request = PYTHON) -> str:
    """Return the first lines, the ladder, and all that the last diagnosis says."""
    return diagnosis_sheet(history.diagnosis, request, _top(history, request)).text()


def _top(history: History, request: Request) -> Card:
    """Return the first card with the ladder in it, for a terminal."""
    return replace(history_card(history, request), ladder=text(history))


@renders(History, "files")
def write(history: History, place: str | Path, request: Request = PYTHON) -> list[Path]:
    """Write the grown mechanism's folder, with the last fit, diagnosis and a report of the ladder.

    Raises:
        IdentError: if it is the folder of the mechanism itself, or cannot be written.
    """
    refuse_own(history.mechanism, Path(place))
    ladder = Section("The error falls", [history.plot()], unfolded=True)
    request = replace(request, folder=str(place))
    added = Step(grown=tuple(effect.label for effect in history.added))
    sections = (ladder, *diagnosis_sections(history.diagnosis, request, added))
    title = f"{history.mechanism.name}: grown model"
    screen, top = screen_of(history), history_card(history, request)
    ladder_rows = rows(history)
    if not any(row[-1] for row in ladder_rows[1:]):  # without rivals
        ladder_rows = [row[:-1] for row in ladder_rows]
    below = [table(ladder_rows, CAPTION, tied=False)]  # so the machine has room on the right
    report = report_page(title, top, sections, screen.front, below, screen.machine)
    data = {**diagnosis_files(history.diagnosis), "report.html": report}
    data["grow.json"] = json_bytes(history_json(history))
    written = write_instead(history.diagnosis, Path(place), model_files(history.fit) | data)
    (Path(place) / ROUNDS).unlink(missing_ok=True)  # it serves an interrupted run only
    return written


@renders(History, "json")
def history_json(history: History) -> dict[str, Any]:
    """Return the content of grow.json."""
    ways = ("added", "removed", "rivals")
    steps = [
        {way: list(map(name_of, getattr(step, way))) for way in ways}
        | {"fitted": step.fit is not None, "errors": step.errors}
        for step in history.steps
    ]
    return {
        "schema": "ident.grow/1", "mechanism": history.mechanism.name,
        "logs": list(history.fit.motion.names),
        "added": list(map(name_of, history.added)), "verdict": history.diagnosis.verdict,
        "steps": steps, "noise": noise_errors(history.fit), "stopped": history.stopped,
    }  # fmt: skip


def model_files(fit: Fit) -> dict[str, bytes]:
    """Return the folder of a fit's mechanism, its unknowns unknown, and identified/, where all is
    known; without that where no URDF can state the inertias.
    """
    mechanism = fit.mechanism
    effects = [(effect, effect.values) for effect in mechanism.effects]
    urdf, errors = mechanism.urdf.read_bytes(), fit.known_errors
    files = folder_files(mechanism, urdf, effects, None, fit.found, errors)
    with suppress(FitError):
        files |= identified_files(fit, identified_urdf(fit, possible=False))
    files |= dict(own_files(fit).values())
    return files | {"fit.json": json_bytes(fit_json(fit)), "multipliers.csv": multipliers_csv(fit)}


def refuse_own(mechanism: Mechanism, folder: Path) -> None:
    """Refuse, as an IdentError, to replace what a person wrote by what a program has grown."""
    for path in (mechanism.toml, mechanism.urdf):
        if path is not None and path.parent.resolve() == folder.resolve():
            raise IdentError(
                f"{folder}: holds {path.name} of the mechanism itself, which is not overwritten; "
                "name another folder, or change it with `ident add`"
            )


# --- models tried by hand -------------------------------------------------------------------------


@renders(Exploration, "ladder")
def exploration_rows(e: Exploration) -> list[list[str]]:
    """Return a table: the change, and every joint's held-out error."""
    joints = e.fit.motion.independent
    return [["model", *joints], *([changed(r), *cells(r.errors, joints)] for r in e.rungs)]


renders(Exploration, "text")(lambda e: "\n".join(text_table(e.table(), "")))


@renders(Exploration, "summary")
def exploration_summary(e: Exploration) -> str:
    """Return what is offered or announced first, in a sentence, and what to do about it."""
    if e.offered:
        return "What no effect explains has a law or a curve: accept it or refuse it."
    best, has_verdict = e.first, e.diagnosis is not None
    if best is None:
        sure = "the verdict is under Verdict" if has_verdict else "judge it to be sure"
        return f"No effect lowers the error by more than chance would; {sure}."
    proof = ". A falling error is no proof: judge it"
    rest = "; the verdict on it is under Verdict" if has_verdict else proof
    return f"The first candidate is {named([best.effect])}{rest}."


@renders(Exploration, "files")
def write_exploration(e: Exploration, folder: str | Path) -> list[Path]:
    """Write the present mechanism's folder with its fit, and its diagnosis, where there is one."""
    if e.diagnosis is not None:
        return write(History(e.rungs, e.diagnosis), folder)
    refuse_own(e.mechanism, Path(folder))
    return write_all(Path(folder), model_files(e.fit))
