"""Models side by side: first lines, tables, report and compare.json; what has changed since an
earlier fit; forces of one or several models.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ident.display import Plotted, render, renders
from ident.effects.library import named
from ident.files import json_bytes
from ident.fit.identify import Comparison
from ident.fit.prediction import identifiable_multipliers
from ident.fit.residual import floor_of, zero_of
from ident.fit.result import Fit
from ident.fit.values import Change, Changes
from ident.information.blocks import Error
from ident.show.card import OTHER, SAME, Card, bars_of, enough, good_enough, next_command
from ident.show.charts import BELOW, MEASURED, Chart, Line, Panel
from ident.show.html import Block, Section, Sheet, by_log, report_page, table
from ident.show.motion import made_of, understood
from ident.show.residual import (
    Models,
    all_parts,
    below,
    error_rows,
    errors_section,
    failure_text,
    fitted,
    judged,
    residual_sections,
    short,
    time_label,
    told_apart,
)
from ident.text import WIDTH, listed, places, rounded, shortened, significant, some, two_digits

SCHEMA = "ident.compare/1"
COEFFICIENT = re.compile(r"(?<= )[\d.]+(?:e[+-]\d+)?(?= )")
OTHERWISE = 0.1  # of the torque of every joint, from which a log may be of another machine


@renders(Comparison, "sheet")
def comparison_sheet(c: Comparison) -> Sheet:
    """Return how far the error falls, errors, the parts of the sum, and where each model fails."""
    first, shown = next(iter(c.residuals.values())), told_apart(c.residuals)
    tables: dict[str, list[list[str]]] = {}
    for i in range(0, len(shown), 2):  # as many as a terminal has room for
        names = dict(list(_error_columns(c).items())[i : i + 2])
        title = f"error of the predicted torque{below(first)}"
        tables[title if not tables else ", ".join(names)] = error_rows(names)
    lines = ["where it fails"]
    for name, residual in c.residuals.items():
        before, several = f"{shown[name]}, " * (len(shown) > 1), len(residual.traces) > 1
        texts = (failure_text(each, several, judged(c, name)) for each in residual.where)
        lines += [before + text for text in texts]
    return Sheet(comparison_card(c), tables=tables | all_parts(c.residuals), lines=lines)


def comparison_card(c: Comparison) -> Card:
    """Return the models, and how far the error falls from the first, or its fit, to the last."""
    from ident.show.front import most_changed  # pages only: it is slow to import

    first, last = (list(c.residuals.values())[i] for i in (0, -1))
    shown, floor = told_apart(c.residuals), floor_of(last.model, last.motion)
    alone, (_, errors) = first is last, judged(c, last.name)
    good = good_enough(errors, floor, last.errors_away_from_reversals)
    before = fitted(c, first.name) if alone else judged(c, first.name)[1]
    now = {joint for joint, e in errors.items() if not e.unmeasured}
    blind = [joint for joint, e in before.items() if e.unmeasured and joint in now]
    before = {joint: e for joint, e in before.items() if joint not in blind}
    changed = first.increased_errors(before) if alone else []
    bars = bars_of(before, errors, floor)
    models = shown[first.name] if alone else f"{shown[first.name]} → {shown[last.name]}"
    line = f"{models} on {', '.join(trace.name for trace in first.traces)}"
    larger = [bar.joint for bar in bars if bar.rises and bar.joint not in changed and before]
    more = f"the error is larger in {places(larger)}"
    if alone and changed:
        line += f": changed since it was fitted in {places(changed)}"
        others = f"{more} too, less surely" if larger else "all other joints are as then"
        line += f"; {others}" * (len(changed) + len(blind) < len(errors))
        if all(((bar.after or bar.before).relative or 0.0) > OTHERWISE for bar in bars):
            line += f", by much of its torque: {OTHER}"
    elif alone and larger:
        line += f": unchanged; {more}, by no more than it differs from motion to motion"
    elif alone and before:
        line += f": in all {'other ' * bool(blind)}joints as when it was fitted"
    elif not alone:
        rises = [bar.joint for bar in bars if bar.rises]
        falls = [x.joint for x in bars if x.after and x.after.rms < (1 - SAME) * x.before.rms]
        ways = {"falls": falls, "rises": rises}
        parts = [f"{way} in {places(names)}" for way, names in ways.items() if names]
        line += f": the error {' and '.join(parts) or 'is the same in all joints'}"
        good = good and f"Of {shown[last.name]}: {good}"
    if alone and blind:
        line += f"; without a measured torque when it was fitted: {listed(blind)}"
    differs = alone and bool(changed)
    verb = "diagnose" if differs or not enough(errors, floor) else "monitor"
    columns = list(_error_columns(c))
    change = f"of {columns[0]} → of {columns[-1]}"
    if alone:
        change = "when it was fitted → on this log" * bool(before)
    worst = changed[0] if changed else "" if alone else most_changed(first, last)[0]
    return Card(line, good, bars, next_command(verb, known=differs), "", change, first=worst)


def _error_columns(c: Comparison) -> dict[str, Mapping[str, Error]]:
    """Return the errors of every model, by its name and what they are."""
    columns = dict[str, Mapping[str, Error]]()
    for name, shown in told_apart(c.residuals).items():
        what, errors = judged(c, name)
        how = {"held-out error": ", held out", "error in the fit": ", in the fit"}.get(what, "")
        columns[shown + how] = errors
    return columns


@renders(Comparison, "files")
def comparison_files(c: Comparison, replay: Plotted | None = None) -> dict[str, bytes]:
    """Return report.html and compare.json, with the simulated motions if they are given."""
    from ident.show.front import first_screen, most_changed  # pages only: it is slow to import

    residuals = c.residuals
    first, last = (list(residuals.values())[i] for i in (0, -1))
    mechanism, motion = first.model.mechanism, first.motion
    changed = "" if first is last else most_changed(first, last)[0]
    sections = (
        errors_section(error_rows(_error_columns(c))),
        Section("Parameters", _parameters(residuals)),
        *residual_sections(c, changed),
        *([render(replay, "section")] if replay else []),
        Section("Multipliers", _multipliers(c)),
        understood(mechanism, motion),
        made_of(mechanism, motion, [Path(name) for name in residuals if Path(name).is_file()]),
    )
    title = f"{mechanism.name}: model against measurement"
    screen = first_screen(first, last, changed)
    report = report_page(title, comparison_card(c), sections, screen.front, screen.machine)
    return {"report.html": report, "compare.json": json_bytes(comparison_json(c, replay))}


def _parameters(residuals: Models) -> tuple[Block, ...]:
    """Return values ± standard errors, model beside model: effects, then base parameters."""
    models, names = [each.model for each in residuals.values()], told_apart(residuals).values()
    shown: dict[str, str] = {}  # the first name of combinations that differ by rounding
    found = [
        {
            shown.setdefault(rounded_name(each.name), each.name): each
            for each in model.base_parameters
        }
        for model in models
    ]
    values = [dict(model.point.values) for model in models]
    rigid = set(models[0].mechanism.bodies.names)
    effects = dict.fromkeys(name for own in values for name in own if name not in rigid)
    bodies = dict.fromkeys(name for own in found for name in own if name not in effects)

    def row(name: str) -> list[str]:
        cells, unit = [], ""
        for base, own in zip(found, values, strict=True):
            known = significant(own[name], 5) if name in own else "–"
            cells.append(rounded(base[name].value, base[name].stderr) if name in base else known)
            unit = base[name].unit if name in base else unit
        return [shortened(name, WIDTH), *cells, unit]

    head, titles = ["parameter", *names, "unit"], ("Effects", "Base parameters of the bodies")
    return tuple(
        table([head, *map(row, own)], f"{title}; a value without ± is known or is a shape")
        for title, own in zip(titles, (effects, bodies), strict=True)
        if own
    )


def rounded_name(name: str) -> str:
    """Return the name of a combination with three digits of its coefficients."""
    return COEFFICIENT.sub(lambda number: f"{float(number[0]):.3g}", name)


def _multipliers(c: Comparison) -> tuple[Block, ...]:
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


def comparison_json(c: Comparison, replay: Plotted | None = None) -> dict[str, Any]:
    """Return the content of compare.json."""
    first = next(iter(c.residuals.values()))
    models = {
        name: {
            "error": residual.errors, "fitted": c.fitted[name],
            "changed": residual.increased_errors(fitted(c, name)),
            "noise": floor_of(residual.model, residual.motion),
            "parts": {
                part: dict(zip(residual.joints, values, strict=True))
                for part, values in residual.parts.items()
            },
            "where": [failure.json for failure in residual.where],
        }
        for name, residual in c.residuals.items()
    }  # fmt: skip
    return {
        "schema": SCHEMA, "logs": [trace.name for trace in first.traces],
        "cutoff": first.motion.band.cutoff, "rows": first.rows, "models": models,
        **({"replay": render(replay, "json")} if replay else {}),
    }  # fmt: skip


# --- since an earlier fit ------------------------------------------------------------------------


def changes_line(x: Changes, worse: Sequence[str] = ()) -> str:
    """Return which parameters differ from an earlier fit; `worse`: joints it fits worse."""
    since, n = short(x.since), len(x.compared)
    if not n:
        return f"Nothing can be compared with {since}: no parameter is determined by both logs."
    apart = f"; {len(x.apart)} more cannot be compared" * bool(x.apart)
    if not x.changed and worse:
        none = f"No parameter has changed since {since} beyond the errors of both"
        return f"{none}, but the model does not explain what is new in {listed(worse)}."
    if not x.changed:
        return (
            f"Nothing has changed since {since}: none of {n} parameters differs by more than "
            f"{x.least:.2g} standard errors, the most {two_digits(abs(x.compared[0].z))}{apart}."
        )
    bodies = [c for c in x.changed if c.effect is None]
    by_z = [(abs(c.z), _change_words(c)) for c in x.changed if c.effect is not None]
    if bodies:
        by_z.append((abs(bodies[0].z), _bodies_words(bodies)))
    words = [text for _, text in sorted(by_z, key=lambda each: -each[0])]
    found = f"{some(words, 2 if bodies else 3)}: {len(x.changed)} of {n} parameters{apart}."
    found += f" Most have: {OTHER}" * (2 * len(x.changed) > n)
    if worse:  # what differs may stand in for a cause that the model does not have
        cause = f"New since {since}: in {listed(worse)} an effect that the model does not contain"
        return f"{cause}. Changed, perhaps only to make up for it: {found}"
    return f"Changed since {since}: {found}"


def fitted_anew(fit: Fit) -> str:
    """Return what has changed since an earlier fit, for a diagnosis that fitted everything anew."""
    assert fit.changes is not None
    words = changes_line(fit.changes).rstrip(".")
    cause = f"; for the cause: {next_command('diagnose')}" * bool(fit.changes.changed)
    return f"all parameters were fitted anew. {words}{cause}"


def _change_words(c: Change) -> str:
    """Return a change in words: of an effect with its name, of a body with that of the number."""
    name = c.after.name
    if c.effect is not None:
        name = f"{named([c.effect])}, {name.rpartition('.')[2]}"
    return f"{shortened(name, 60)} ({_then_now(c)} {c.after.unit})"


def _bodies_words(changes: Sequence[Change]) -> str:
    """Return what has changed of bodies: one number, or the link that has part in all of them."""
    first = _change_words(changes[0])
    if not changes[1:]:
        return first
    links = [{name.rpartition(".")[0] for name in each.terms} for each in changes]
    common = sorted(set.intersection(*links))
    where = listed(common, "or") if common else places(sorted(set.union(*links)))
    both = f"part of all {len(changes)} combinations" if common else f"{len(changes)} combinations"
    return (
        f"the mass of {where} or its distribution ({both} that have changed, most of all {first})"
    )


def _then_now(x: Change) -> str:
    return " → ".join(rounded(each.value, each.stderr) for each in (x.before, x.after))


@renders(Changes, "sheet")
def changes_sheet(x: Changes) -> Sheet:
    """Return which parameters differ from those of an earlier fit."""
    return Sheet(changes_line(x), tables=change_tables(x))


def change_tables(x: Changes | None, most: int = 48) -> dict[str, list[list[str]]]:
    """Return the table of what has changed since an earlier fit, the most significant first."""
    if x is None or not x.changed:
        return {}
    rows = [["parameter", "then → now", "unit", "difference / its error"]]
    rows += [
        [shortened(c.after.name, most), _then_now(c), c.after.unit, f"{c.z:+.3g}"]
        for c in x.changed
    ]
    return {f"Changed since {short(x.since)}, beyond the errors of both": rows}


# --- forces --------------------------------------------------------------------------------------


def plot_forces(
    names: Sequence[str],
    units: Sequence[str],
    series: Mapping[str, tuple[np.ndarray, np.ndarray]],
    log: str = "",
) -> Chart:
    """Draw λ(t) of a log, a panel a multiplier with its unit.

    `series`: times (n,) [s] and values (n, m) [N | N m] by label; `known` is drawn in grey.
    """
    zero = zero_of(list(series.values())[-1][0])
    rows = []
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        lines: list[Line] = []
        for label, (t, values) in series.items():
            y, known = values[:, i], label == "known"
            colour, width = MEASURED if known else len(lines), BELOW if known else 1.2
            lines.append(Line(t - zero, y, label, colour, width))
        if np.isfinite(lines[-1].y).any():
            label = f"{name} [{unit}]"
            rows.append((Panel(tuple(lines), time_label(zero), label, height=1.8),))
    if not rows:
        rows = [(Panel((), "t [s]", title="this motion determines none of them"),)]
    words = "Multipliers λ over time, the reaction forces of the closures"
    return Chart(words, tuple(rows), shared_x=True, clock=log)
