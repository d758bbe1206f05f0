"""Comparisons of models as text, report and JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ident.display import renders
from ident.files import json_bytes
from ident.fit.compare import Comparison
from ident.fit.multipliers import identifiable_multipliers
from ident.fit.residual import Residual, floor_of
from ident.information.blocks import Error
from ident.show.card import SAME, Bar, Card, good_enough, next_command
from ident.show.charts import Chart
from ident.show.html import Block, Page, Section, by_log
from ident.show.html import table as html_table
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
from ident.text import places

SCHEMA = "ident.compare/1"


@renders(Comparison, "sheet")
def comparison_sheet(c: Comparison) -> Sheet:
    """Return how far the error falls, errors, the parts of the sum, and where each model fails."""
    first, shown = next(iter(c.residuals.values())), told_apart(c.residuals)
    tables: dict[str, list[list[str]]] = {}
    for i in range(0, len(shown), 2):  # as many as a terminal has room for
        names = {shown[name]: c.errors[name] for name in list(shown)[i : i + 2]}
        title = f"error of the predicted torque{below(first)}"
        tables[title if not tables else ", ".join(names)] = error_rows(names)
    for name, fitted in c.fitted.items():
        if any(fitted.values()):
            tables[f"errors of {shown[name]} as it was fitted"] = error_rows(fitted)
    lines = ["where it fails"]
    for name, residual in c.residuals.items():
        before = "" if len(shown) == 1 else f"{shown[name]}, "
        lines += [before + line for line in where_lines(residual)]
    return Sheet(comparison_card(c), tables=tables | all_parts(c.residuals), lines=lines)


def comparison_card(c: Comparison) -> Card:
    """Return the models, and how far the error falls from the first to the last."""
    first, last = (list(c.residuals.values())[i] for i in (0, -1))
    logs = ", ".join(trace.name for trace in first.traces)
    shown, floor = told_apart(c.residuals), floor_of(last.model, last.motion)
    good = good_enough(last.errors, floor)
    command = next_command("monitor" if "? Yes" in good else "diagnose")
    if first is last:
        bars = tuple(Bar(j, e, noise=floor[j]) for j, e in last.errors.items())
        return Card(f"{shown[first.name]} on {logs}", good, bars, command)
    bars = tuple(Bar(j, first.errors[j], last.errors[j], floor[j]) for j in _changed(first, last))
    ratio = {bar.joint: bar.after.rms / max(bar.before.rms, 1e-300) for bar in bars if bar.after}
    ways = {
        "falls": [joint for joint, x in ratio.items() if x < 1 - SAME],
        "rises": [joint for joint, x in ratio.items() if x > 1 + SAME],
    }
    parts = [f"{way} in {places(joints)}" for way, joints in ways.items() if joints]
    words = " and ".join(parts) or "is the same in all joints"
    line = f"{shown[first.name]} → {shown[last.name]} on {logs}: the error {words}"
    return Card(line, good and f"{shown[last.name]}: {good}", bars, command)


def _changed(first: Residual, last: Residual) -> list[str]:
    """Return the joints, the one whose error changes most against its torque first."""
    change = {
        joint: abs(error.rms - last.errors[joint].rms) * ((error.relative or 0) / (error.rms or 1))
        for joint, error in first.errors.items()
    }
    return sorted(change, key=lambda joint: -change[joint])


@renders(Comparison, "files")
def comparison_files(c: Comparison) -> dict[str, bytes]:
    """Return report.html and compare.json."""
    residuals = c.residuals
    first, shown = next(iter(residuals.values())), told_apart(residuals)
    mechanism, motion = first.model.mechanism, first.motion
    changed = _changed(first, list(residuals.values())[-1])[0] if len(residuals) > 1 else ""
    fitted = [
        html_table(error_rows(errors), f"{shown[name]} as it was fitted")
        for name, errors in c.fitted.items()
        if any(errors.values())
    ]
    sections = (
        errors_section(error_rows({shown[name]: each for name, each in c.errors.items()}), *fitted),
        *residual_sections(c.predictions, residuals, changed),
        Section("Parameters", _parameters(residuals)),
        Section("Multipliers", _multipliers(c)),
        understood(mechanism, motion),
        made_of(mechanism, motion, [Path(name) for name in residuals if Path(name).is_file()]),
    )
    title = f"{mechanism.name}: model against measurement"
    report = Page(title, comparison_card(c), sections).html()
    return {"report.html": report, "compare.json": json_bytes(comparison_json(c))}


def _parameters(residuals: Models) -> tuple[Block, ...]:
    """Return values of the effects and of the bodies' unknowns, model beside model."""
    models, names = [each.model for each in residuals.values()], told_apart(residuals).values()
    mechanism, values = models[0].mechanism, [dict(each.point.values) for each in models]
    effects, bodies = [["effect", *names]], [["parameter about the joint", "prior", *names]]
    for name in dict.fromkeys(name for own in values for name in own):
        effects.append([name, *(f"{own[name]:.5g}" if name in own else "–" for own in values)])
    for i, name in enumerate(mechanism.bodies.names):
        if name in mechanism.unknown:
            found = (mechanism.prior[i], *(model.point.pi[i] for model in models))
            bodies.append([name, *(f"{value:.5g}" for value in found)])
    titles = "Effects", "Unknown parameters of the bodies; fit.json has standard errors"
    tables = zip((effects, bodies), titles, strict=True)
    return tuple(html_table(rows, title) for rows, title in tables if len(rows) > 1)


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


def comparison_json(c: Comparison) -> dict[str, Any]:
    """Return the content of compare.json."""

    def errors(named: Mapping[str, Error]) -> dict[str, Any]:
        return {joint: asdict(error) for joint, error in named.items()}

    def parts(residual: Residual, named: Mapping[str, np.ndarray]) -> dict[str, Any]:
        joints = residual.joints
        return {name: dict(zip(joints, values, strict=True)) for name, values in named.items()}

    first = next(iter(c.residuals.values()))
    models = {
        name: {
            "error": errors(residual.errors),
            "fitted": {key: errors(each) for key, each in c.fitted[name].items()},
            "noise": floor_of(residual.model, residual.motion),
            "parts": parts(residual, residual.parts),
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
    }
