"""Models side by side, and the ladder of one that grew: text, tables, charts, reports, files."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.diagnosis.grow import NAME as ROUNDS
from ident.diagnosis.grow import History, Step
from ident.diagnosis.result import errors_of
from ident.diagnosis.unobservable import name_of
from ident.display import render, renders, writing
from ident.errors import FitError, IdentError
from ident.files import json_bytes
from ident.fit import Fit
from ident.fit.files import fit_json, identified_files, identified_urdf, multipliers_csv, own_files
from ident.fit.identify import Comparison
from ident.fit.prediction import identifiable_multipliers
from ident.fit.residual import Residual, floor_of
from ident.information.blocks import Error
from ident.mechanism import Mechanism
from ident.mechanism.write import folder_files
from ident.show.charts import Chart, Level, Line, Mark, Panel
from ident.show.diagnosis import card, errors_with, in_order, noise_errors, short, verdict_line
from ident.show.diagnosis_report import diagnosis_files, diagnosis_sections, write_instead
from ident.show.html import (
    OTHER,
    SAME,
    Bar,
    Block,
    Card,
    Page,
    Section,
    by_log,
    enough,
    good_enough,
    named,
    next_command,
    table,
)
from ident.show.motion import made_of, understood
from ident.show.residual import (
    Models,
    all_parts,
    below,
    error_rows,
    errors_section,
    plot_forces,
    residual_sections,
    told_apart,
    where_lines,
)  # fmt: skip
from ident.show.sheet import Sheet
from ident.simulate.replay import Replay
from ident.text import WIDTH, percent, places, rounded, shortened, width, wrapped

SCHEMA = "ident.compare/1"
OTHERWISE = 0.1  # of the torque of every joint, from which a log may be of another machine


@renders(Comparison, "sheet")
def comparison_sheet(c: Comparison) -> Sheet:
    """Return how far the error falls, errors, the parts of the sum, and where each model fails."""
    first, shown = next(iter(c.residuals.values())), told_apart(c.residuals)
    tables: dict[str, list[list[str]]] = {}
    for i in range(0, len(shown), 2):  # as many as a terminal has room for
        names = {shown[name]: c.errors[name] for name in list(shown)[i : i + 2]}
        title = f"error of the predicted torque{below(first)}"
        tables[title if not tables else ", ".join(names)] = error_rows(names)
    lines = ["where it fails"]
    for name, residual in c.residuals.items():
        before = "" if len(shown) == 1 else f"{shown[name]}, "
        lines += [before + line for line in where_lines(residual)]
    return Sheet(comparison_card(c), tables=tables | all_parts(c.residuals), lines=lines)


def comparison_card(c: Comparison) -> Card:
    """Return the models, and how far the error falls from the first to the last, or from the fit
    of the only one.
    """
    first, last = (list(c.residuals.values())[i] for i in (0, -1))
    shown, floor = told_apart(c.residuals), floor_of(last.model, last.motion)
    alone, errors = first is last, judged(c, last)
    good = good_enough(errors, floor, last.away)
    before = _fitted(c, first.name) if alone else first.errors
    after = errors if alone else last.errors
    changed = first.risen(before) if alone else _changed(first, last)
    joints = [*changed, *(j for j in errors if j not in changed)]
    bars = tuple(
        Bar(j, before.get(j, after[j]), after[j] if j in before else None, floor[j]) for j in joints
    )
    models = shown[first.name] if alone else f"{shown[first.name]} → {shown[last.name]}"
    line = f"{models} on {', '.join(trace.name for trace in first.traces)}"
    larger = [bar.joint for bar in bars if bar.rises and bar.joint not in changed and before]
    grown = f"the error is larger in {places(larger)}, by no more than it differs from motion to "
    grown += "motion"
    if alone and changed:
        line += f": changed since it was fitted in {places(changed)}"
        others = grown if larger else "all other joints are as then"
        line += f"; {others}" * (len(changed) < len(joints))
        if all(((bar.after or bar.before).relative or 0.0) > OTHERWISE for bar in bars):
            line += f", by much of its torque: {OTHER}"
    elif alone:
        if larger:
            line += f": unchanged; {grown}"
        elif before:
            line += ": in all joints as when it was fitted"
    else:
        rises = [bar.joint for bar in bars if bar.rises]
        falls = [x.joint for x in bars if x.after and x.after.rms < (1 - SAME) * x.before.rms]
        ways = {"falls": falls, "rises": rises}
        parts = [f"{way} in {places(names)}" for way, names in ways.items() if names]
        line += f": the error {' and '.join(parts) or 'is the same in all joints'}"
        good = good and f"{shown[last.name]}: {good}"
    differs = alone and bool(changed)
    verb = "diagnose" if differs or not enough(errors, floor) else "monitor"
    return Card(line, good, bars, next_command(verb, known=differs))


def judged(c: Comparison, residual: Residual) -> Mapping[str, Error]:
    """Return the errors that count: on the data of its own fit those that were held out of it."""
    errors, train = residual.errors, c.fitted[residual.name].get("train", {})
    same = train.keys() == errors.keys() and all(
        math.isclose(train[j].rms, e.rms, rel_tol=SAME) for j, e in errors.items()
    )
    return _fitted(c, residual.name) if same else errors


def _fitted(c: Comparison, name: str) -> Mapping[str, Error]:
    """Return a model's errors when it was fitted, held out in time where that is known."""
    return c.fitted[name].get("held out") or c.fitted[name].get("train") or {}


def _changed(first: Residual, last: Residual) -> list[str]:
    """Return the joints, the one whose error changes most against its torque first."""
    change = {
        joint: abs(error.rms - last.errors[joint].rms) * ((error.relative or 0) / (error.rms or 1))
        for joint, error in first.errors.items()
    }
    return sorted(change, key=lambda joint: -change[joint])


@renders(Comparison, "files")
def comparison_files(c: Comparison, replay: Replay | None = None) -> dict[str, bytes]:
    """Return report.html and compare.json, with the simulated motions if they are given."""
    residuals = c.residuals
    first, shown = next(iter(residuals.values())), told_apart(residuals)
    mechanism, motion = first.model.mechanism, first.motion
    changed = _changed(first, list(residuals.values())[-1])[0] if len(residuals) > 1 else ""
    sections = (
        errors_section(error_rows({shown[name]: each for name, each in c.errors.items()})),
        Section("Parameters", _parameters(residuals)),
        *residual_sections(c.predictions, residuals, changed),
        *([render(replay, "section")] if replay else []),
        Section("Multipliers", _multipliers(c)),
        understood(mechanism, motion),
        made_of(mechanism, motion, [Path(name) for name in residuals if Path(name).is_file()]),
    )
    title = f"{mechanism.name}: model against measurement"
    report = Page(title, comparison_card(c), sections).html()
    return {"report.html": report, "compare.json": json_bytes(comparison_json(c, replay))}


def _parameters(residuals: Models) -> tuple[Block, ...]:
    """Return values ± standard errors, model beside model: effects, then the bodies' base
    parameters, of which models may have different ones.
    """
    models, names = [each.model for each in residuals.values()], told_apart(residuals).values()
    found = [{each.name: each for each in model.base_parameters} for model in models]
    values = [dict(model.point.values) for model in models]
    rigid = set(models[0].mechanism.bodies.names)
    effects = dict.fromkeys(name for own in values for name in own if name not in rigid)
    bodies = dict.fromkeys(name for own in found for name in own if name not in effects)

    def row(name: str) -> list[str]:
        cells, unit = [], ""
        for base, own in zip(found, values, strict=True):
            known = f"{own[name]:.5g}" if name in own else "–"
            cells.append(rounded(base[name].value, base[name].stderr) if name in base else known)
            unit = base[name].unit if name in base else unit
        return [shortened(name, WIDTH), *cells, unit]

    head, titles = ["parameter", *names, "unit"], ("Effects", "Base parameters of the bodies")
    return tuple(
        table([head, *map(row, own)], f"{title}; a value without ± is known or is a shape")
        for title, own in zip(titles, (effects, bodies), strict=True)
        if own
    )


def _multipliers(c: Comparison) -> tuple[Block, ...]:
    """Draw λ of every model, log by log."""
    first = next(iter(c.residuals.values()))
    mechanism, shown = first.model.mechanism, told_apart(c.predictions)
    known = identifiable_multipliers(mechanism, first.motion)
    kinematics = mechanism.kinematics
    names, units = (np.array(x)[known] for x in (kinematics.multipliers, kinematics.units))

    def draw(i: int) -> Chart:
        series = {}
        for name, predictions in c.predictions.items():
            p = predictions[i]
            values = np.where(p.usable[:, None], p.multipliers, np.nan)
            series[shown[name]] = (p.t, values[:, known])
        return plot_forces(names, units, series, first.motion.experiments[i].name)

    logs = [experiment.name for experiment in first.motion.experiments]
    return by_log(logs, draw) if np.any(known) else ()


def comparison_json(c: Comparison, replay: Replay | None = None) -> dict[str, Any]:
    """Return the content of compare.json."""

    first = next(iter(c.residuals.values()))
    models = {
        name: {
            "error": residual.errors,
            "fitted": c.fitted[name],
            "changed": residual.risen(_fitted(c, name)),
            "noise": floor_of(residual.model, residual.motion),
            "parts": {
                part: dict(zip(residual.joints, values, strict=True))
                for part, values in residual.parts.items()
            },
            "where": [failure.json for failure in residual.where],
        }
        for name, residual in c.residuals.items()
    }
    return {
        "schema": SCHEMA,
        "logs": [trace.name for trace in first.traces],
        "cutoff": first.motion.band.cutoff,
        "rows": first.rows,
        "models": models,
        **({"replay": render(replay, "json")} if replay else {}),
    }


NAME, CELL = 30, 7  # characters of the columns
LONG = "+ friction_width:"  # and a joint: as long as most labels are
NOISE = "noise alone"
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
    """Return the names of the columns."""
    wide = NAME + sum(2 + max(CELL, len(joint)) for joint in joints)
    return list(joints) if wide <= width() else [f"[{i + 1}]" for i in range(len(joints))]


def _room(joints: Sequence[str]) -> int:
    """Return the characters of the column of effects: one of a joint is whole, if there is room."""
    longest = len(LONG) + max(map(len, joints), default=0)
    wide = longest + sum(2 + max(CELL, len(name)) for name in _columns(joints))
    return max(NAME, longest) if wide <= width() else NAME


def _row(first: str, cells: Sequence[str], joints: Sequence[str], last: str = "") -> str:
    columns = zip(cells, _columns(joints), strict=True)
    middle = [cell.rjust(max(CELL, len(name))) for cell, name in columns]
    return "  ".join([first.ljust(_room(joints)), *middle, last]).rstrip()


def rung(step: Step, joints: Sequence[str]) -> str:
    """Return one rung: what was added, and errors; ≈ marks those that are announced, not fitted."""
    room = _room(joints)
    tied = changed(step).replace("+ ", "+\u00a0").replace("− ", "−\u00a0")  # sign and label
    name, *rest = (
        line.replace("\u00a0", " ")
        for line in textwrap.wrap(
            tied, room, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
        )
    )
    own_line = [name] * (len(name) > room)
    name = "" if own_line else name
    row = _row(name, cells(step.errors, joints), joints, "" if step.fit else "≈")
    lines = [*own_line, row, *rest]
    for log, errors in step.fit.validation.items() if step.fit else ():
        lines.append(_row(f"  on {log[-(NAME - 5) :]}", cells(errors, joints), joints))
    if step.rivals:
        lines += wrapped(f"    or {named(step.rivals, 'or')}: not distinguishable", "      ")
    return "\n".join(lines)


def changed(step: Step) -> str:
    """Return what this rung adds to the one before, and removes from it."""
    ways = {"+": step.added, "−": step.removed}
    return " ".join(f"{sign} {named(x)}" for sign, x in ways.items() if x) or "as given"


def noise_rung(history: History) -> str:
    """Return the last row of the ladder: what noise alone would leave."""
    joints = history.fit.motion.independent
    return _row(NOISE, cells(noise_errors(history.fit), joints), joints)


def cells(errors: Mapping[str, Error], joints: Sequence[str]) -> list[str]:
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
    steps = (rung(step, joints) for step in history.steps)
    return "\n".join([head(joints), *steps, noise_rung(history)])


@renders(History, "ladder")
def rows(history: History) -> list[list[str]]:
    """Return a table: effect, a column a joint, rivals; ≈ marks errors that are announced."""
    joints = history.fit.motion.independent
    found = [["effect", *joints, "rivals"]]
    for step in history.steps:
        errors = [f"{'' if step.fit else '≈ '}{cell}" for cell in cells(step.errors, joints)]
        rivals = named(step.rivals, "or") if step.rivals else ""
        found.append([changed(step), *errors, rivals])
    return [*found, [NOISE, *cells(noise_errors(history.fit), joints), ""]]


@renders(History, "sheet")
def sheet(history: History) -> Sheet:
    """Return the verdict and the ladder."""
    return Sheet(verdict_line(history.diagnosis), tables={CAPTION: history.table()})


@renders(History, "plot")
def plot(history: History) -> Chart:
    """Draw the held-out error of every joint against the rungs."""
    return plot_rungs(history.steps, noise_errors(history.fit))


def plot_rungs(steps: Sequence[Step], noise: Mapping[str, Error]) -> Chart:
    """Draw the held-out error of every joint against models one after the other; dashed: noise."""
    names = [
        f"+ {step.added[0].kind} in {len(step.added)} places"
        if len(step.added) > 1
        else changed(step)
        for step in steps
    ]  # as it fits below a chart
    errors, at = [step.errors for step in steps], np.arange(len(names), dtype=float)
    lines: list[Mark] = []
    for i, joint in enumerate(errors[0]):
        y = [each[joint].relative or 0.0 for each in errors]
        if all(y):  # else there is no torque to be relative to
            lines.append(Line(at, 100 * np.array(y), joint, i, 1.6, dotted=True))
        if floor := joint in noise and noise[joint].relative:
            lines.append(Level(100 * floor, colour=i, dashed=True))
    panel = Panel(
        tuple(lines), "model", "held-out error [%]", logarithmic=True, height=4.0,
        x_names=tuple(names),
    )  # fmt: skip
    dashed = "; dashed: what noise alone would leave" if noise else ""
    return Chart(f"Held-out error of every joint, rung by rung{dashed}", ((panel,),))


# --- report and files -----------------------------------------------------------------------------


def history_card(history: History) -> Card:
    """Return the verdict on what is left, what was added, and the error before and after."""
    d, first = history.diagnosis, history.steps[0].errors
    top = card(d, history.added)
    errors = {**errors_of(history.fit), **errors_with(d)}
    last = next((s.added for s in history.steps[::-1] if s.added), ())
    own = [joint for effect in last for joint in effect.joints]
    if d.best is not None or d.laws:
        own = [d.candidates[0].joint if d.best is not None else d.laws[0].felt]
    bars = in_order((Bar(j, first[j], e, d.floor[j]) for j, e in errors.items()), *own[:1])
    if d.verdict == "nothing":
        top = replace(top, command=next_command("compare", history.added))
    return replace(top, sure=f"Added: {_added(history)}. {top.sure}", bars=tuple(bars))


def _added(history: History) -> str:
    """Return what was added, and beside it what this data cannot tell from it."""
    open_ = [step for step in history.steps if step.rivals and step.added]
    unsure = {effect.label for step in open_ for effect in step.added}
    sure = [effect for effect in history.added if effect.label not in unsure]
    parts = [named(sure)] * bool(sure)
    for step in open_:
        if kept := [effect for effect in step.added if effect in history.added]:
            rivals = f"{named(kept)} or {named(step.rivals, 'or')}"
            parts.append(f"{rivals}, which this data cannot tell apart")
    return "; ".join(parts) or "nothing"


@renders(History, "short")
def brief(history: History) -> str:
    """Return the first lines: as of a diagnosis, with the error before and after."""
    return short(history.diagnosis, history_card(history))


@renders(History, "files")
def write(history: History, place: str | Path) -> list[Path]:
    """Write the grown mechanism's folder, with the last fit, diagnosis and a report of the ladder.

    Unknown parameters stay unknown in it: values are in fit.json.

    Raises:
        IdentError: if it is the folder of the mechanism itself, or cannot be written.
    """
    refuse_own(history.mechanism, Path(place))
    blocks = (plot(history), table(rows(history), CAPTION, tied=False))
    ladder = Section("The error falls", blocks)
    with writing(place):
        sections = (ladder, *diagnosis_sections(history.diagnosis))
        page = Page(f"{history.mechanism.name}: grown model", history_card(history), sections)
        data = {**diagnosis_files(history.diagnosis), "report.html": page.html()}
    data["grow.json"] = json_bytes(history_json(history))
    written = write_instead(history.diagnosis, Path(place), model_files(history.fit) | data)
    (Path(place) / ROUNDS).unlink(missing_ok=True)  # it serves an interrupted run only
    return written


@renders(History, "json")
def history_json(history: History) -> dict[str, Any]:
    """Return the content of grow.json."""
    d = history.diagnosis
    return {
        "schema": "ident.grow/1",
        "mechanism": history.mechanism.name,
        "logs": [e.name for e in d.fit.motion.experiments],
        "added": [name_of(effect) for effect in history.added],
        "verdict": d.verdict,
        "steps": [
            {
                "added": [name_of(effect) for effect in step.added],
                "removed": [name_of(effect) for effect in step.removed],
                "rivals": [name_of(effect) for effect in step.rivals],
                "fitted": step.fit is not None,
                "errors": step.errors,
            }
            for step in history.steps
        ],
        "noise": noise_errors(history.fit),
    }  # fmt: skip


def model_files(fit: Fit) -> dict[str, bytes]:
    """Return the folder of a fit's mechanism, its unknowns unknown, with fit.json, multipliers and
    identified/, in which all is known; without that where no URDF can state the inertias.
    """
    mechanism = fit.mechanism
    effects = [(effect, effect.values) for effect in mechanism.effects]
    urdf, errors = mechanism.urdf.read_bytes(), fit.known_errors
    files = folder_files(mechanism, urdf, effects, None, fit.found, errors)
    with suppress(FitError):
        files |= identified_files(fit, identified_urdf(fit))
    return (
        files
        | dict(own_files(fit).values())
        | {"fit.json": json_bytes(fit_json(fit)), "multipliers.csv": multipliers_csv(fit)}
    )


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
