"""Comparisons of models with measurement as text, HTML, charts and files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ident.display import renders
from ident.errors import FitError, one_of
from ident.fit.compare import Comparison
from ident.fit.multipliers import identifiable_multipliers
from ident.fit.residual import Residual, zero_of
from ident.information.blocks import Error
from ident.show import residual as report
from ident.show.charts import Chart, Line, Panel
from ident.show.html import Block, Page, Section, folded, in_frame, items, strong
from ident.show.html import table as html_table
from ident.show.motion import made_of, understood
from ident.show.residual import (
    error_rows,
    errors_text,
    failure_lines,
    parts_table,
    plot_maps,
    plot_parts,
    plot_predictions,
    short,
    time_label,
    where_text,
)
from ident.text import table

SCHEMA = "ident.compare/1"


@renders(Comparison, "text")
def text(c: Comparison) -> str:
    """Return errors, the parts of the sum, and where each model fails."""
    lines = [c.summary]
    for name, residual in c.residuals.items():
        lines += ["", name] if len(c.residuals) > 1 else []
        lines += [*parts_table(residual), "", *where_text(residual)]
    return "\n".join(lines)


@renders(Comparison, "summary")
def summary(c: Comparison) -> str:
    """Return errors on this motion, those of the fits, and how far the error falls."""
    lines = errors_text(c.residuals)
    for name, errors in c.fitted.items():
        if any(errors.values()):
            lines += ["", f"errors of {name} as it was fitted", *table(error_rows(errors))]
    return "\n".join(lines)


@renders(Comparison, "html")
def html(c: Comparison) -> str:
    """Return the change of the error, a table of errors, and where each model fails."""
    where = [
        folded(f"Where {name} fails", *(items(failure_lines(f, True)) for f in each.where))
        for name, each in c.residuals.items()
    ]
    errors = html_table(error_rows(c.errors), "Error of the predicted torque")
    return in_frame([strong(headline(c)), errors, *where])


def headline(c: Comparison) -> str:
    """Return the models, and how far the error falls from the first to the last, in one line."""
    first, *_, last = (*c.residuals.values(), *c.residuals.values())
    names = " and ".join(c.residuals)
    if first is last:
        return f"{names} on {', '.join(trace.name for trace in first.traces)}"
    falls = {j: 1 - last.errors[j].rms / e.rms for j, e in first.errors.items() if e.rms > 0}
    if not falls:
        return names
    best, worst = max(falls, key=lambda j: falls[j]), min(falls, key=lambda j: falls[j])
    return (
        f"From {first.name} to {last.name} the error changes by {-100 * falls[best]:+.3g} % "
        f"({best}) to {-100 * falls[worst]:+.3g} % ({worst})."
    )


@renders(Comparison, "plot")
def plot(c: Comparison, experiment: int = 0) -> Chart:
    """Return measured torque and every model's prediction, with residuals below, per joint."""
    return plot_predictions(c.predictions, c.units, experiment)


@renders(Comparison, "plot_parts")
def parts(c: Comparison, experiment: int = 0) -> Chart:
    """Return rigid bodies, each kind of effect and the residual over time."""
    return plot_parts(c.residuals, experiment)


@renders(Comparison, "plot_maps")
def maps(c: Comparison, joint: str | None = None) -> Chart:
    """Return a joint's residual against its signals."""
    last = list(c.residuals.values())[-1]
    joint = last.where[0].joint if joint is None else joint
    if joint not in last.joints:
        raise FitError(f"no residual of joint '{joint}'; {one_of(joint, last.joints)}")
    return plot_maps(c.residuals, joint)


@renders(Comparison, "files")
def files(c: Comparison) -> dict[str, bytes]:
    """Return report.html and compare.json."""
    return {"report.html": comparison_html(c), "compare.json": comparison_json(c)}


def comparison_html(comparison: Comparison) -> bytes:
    """One file that opens without a network."""
    residuals = comparison.residuals
    first = next(iter(residuals.values()))
    mechanism, motion = first.model.mechanism, first.motion
    fitted = [
        html_table(error_rows(errors), f"{name} as it was fitted")
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
    return Page(title, headline(comparison), sections).html()


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
        blocks.append(html_table(rows, "Effects"))
    mechanism = models[0].mechanism
    at = {name: i for i, name in enumerate(mechanism.bodies.names)}
    unknown = [name for name in mechanism.unknown if name in at]
    if unknown:
        rows = [["parameter about the joint", "prior", *residuals]]
        for name in unknown:
            own = (f"{model.point.pi[at[name]]:.5g}" for model in models)
            rows.append([name, f"{mechanism.prior[at[name]]:.5g}", *own])
        blocks.append(
            html_table(rows, "Unknown parameters of the bodies; fit.json has standard errors")
        )
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
            "parts": _by_part(residual.parts, residual),
            "own_row": _by_part(residual.own, residual),
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


def _by_part(parts: Mapping[str, np.ndarray], residual: Residual) -> dict[str, Any]:
    """rms by part, then joint; null where a joint has no row of its own."""
    return {
        name: {
            joint: None if np.isnan(x) else float(x)
            for joint, x in zip(residual.joints, values, strict=True)
        }
        for name, values in parts.items()
    }
