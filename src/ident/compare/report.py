"""report.html and compare.json of a comparison."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.fit.reach import identifiable_multipliers
from ident.motion.report import made_of, understood
from ident.residual import report
from ident.residual.error import Error, error_rows
from ident.residual.plots import short, time_label
from ident.residual.residual import Residual, zero_of
from ident.show.charts import Chart, Line, Panel
from ident.show.html import Block, Page, Section, table

if TYPE_CHECKING:
    from ident.compare.compare import Comparison

SCHEMA = "ident.compare/1"


def comparison_html(comparison: Comparison) -> bytes:
    """One file that opens without a network."""
    residuals = comparison.residuals
    first = next(iter(residuals.values()))
    mechanism, motion = first.model.mechanism, first.motion
    fitted = [
        table(error_rows(errors), f"{name} as it was fitted")
        for name, errors in comparison.fitted.items()
        if any(errors.values())
    ]
    missed = report.errors(comparison.errors)
    sections = (
        Section(missed.title, (*missed.blocks, *fitted)),
        report.torques(comparison.predictions, comparison.units),
        report.maps(residuals),
        report.parts(residuals),
        Section("Parameters", _parameters(residuals)),
        Section("Multipliers", _multipliers(comparison)),
        understood(mechanism, motion),
        made_of(mechanism, motion, [Path(name) for name in residuals if Path(name).is_file()]),
    )
    title = f"{mechanism.name}: model against measurement"
    return Page(title, comparison.headline, sections).html()


def _parameters(residuals: Mapping[str, Residual]) -> tuple[Block, ...]:
    """Effects' values, then what was unknown of the bodies, model beside model."""
    models = [residual.model for residual in residuals.values()]
    values = [dict(model.point.values) for model in models]
    effects = list(dict.fromkeys(name for own in values for name in own))
    blocks: list[Block] = []
    if effects:
        rows = [["effect", *residuals]]
        for name in effects:
            rows.append([name, *(f"{own[name]:.5g}" if name in own else "–" for own in values)])
        blocks.append(table(rows, "Effects"))
    mechanism = models[0].mechanism
    at = {name: i for i, name in enumerate(mechanism.bodies.names)}
    unknown = [name for name in mechanism.unknown if name in at]
    if unknown:
        rows = [["parameter about the joint", "prior", *residuals]]
        for name in unknown:
            own = (f"{model.point.pi[at[name]]:.5g}" for model in models)
            rows.append([name, f"{mechanism.prior[at[name]]:.5g}", *own])
        blocks.append(table(rows, "What was unknown of the bodies; fit.json has standard errors"))
    return tuple(blocks)


def _multipliers(comparison: Comparison) -> tuple[Block, ...]:
    """λ of every model, log by log."""
    first = next(iter(comparison.residuals.values()))
    kinematics = first.model.mechanism.kinematics
    if not kinematics.multipliers:
        return ()
    known = identifiable_multipliers(first.model.mechanism, first.motion)
    names = [e.name for e in first.motion.experiments]

    def draw(i: int) -> Chart:
        rows = []
        for k in np.flatnonzero(known):
            label = f"{kinematics.multipliers[k]} [{kinematics.units[k]}]"
            lines = []
            for colour, (model, predictions) in enumerate(comparison.predictions.items()):
                p = predictions[i]
                zero, y = zero_of(p.t), np.where(p.usable, p.multipliers[:, k], np.nan)
                lines.append(Line(p.t - zero, y, short(model), colour))
            rows.append((Panel(tuple(lines), time_label(zero), label, height=1.8),))
        words = "Multipliers λ over time, the reaction forces of the closures, of every model"
        return Chart(words, tuple(rows), shared_x=True, clock=names[i])

    return report.by_log(names, draw) if known.any() else ()


def comparison_json(comparison: Comparison) -> bytes:
    """The same as data."""
    models = {
        name: {
            "error": _errors(residual.errors),
            "fitted": {k: _errors(errors) for k, errors in comparison.fitted[name].items()},
            "parts": _parts(residual.parts, residual),
            "own_row": _parts(residual.own, residual),
            "where": [failure.json for failure in residual.where],
        }
        for name, residual in comparison.residuals.items()
    }
    first = next(iter(comparison.residuals.values()))
    content = {
        "schema": SCHEMA,
        "logs": [trace.name for trace in first.traces],
        "cutoff": first.motion.band.cutoff,
        "rows": first.rows,
        "models": models,
    }
    return json.dumps(content, indent=1, ensure_ascii=False).encode() + b"\n"


def _errors(errors: Mapping[str, Error]) -> dict[str, Any]:
    return {
        joint: {"rms": e.rms, "relative": e.relative, "unit": e.unit} for joint, e in errors.items()
    }


def _parts(parts: Mapping[str, np.ndarray], residual: Residual) -> dict[str, Any]:
    """rms by part, then joint; null where a joint has no row of its own."""
    return {
        name: {
            joint: None if np.isnan(x) else float(x)
            for joint, x in zip(residual.joints, values, strict=True)
        }
        for name, values in parts.items()
    }
