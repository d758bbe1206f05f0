"""report.html and compare.json of a comparison."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.fit.report import figure_html, page, table_html, text
from ident.fit.score import Error
from ident.fit.summary import error_rows
from ident.residual.residual import Residual
from ident.residual.tables import parts_table, where_text

if TYPE_CHECKING:
    from ident.residual.compare import Comparison

SCHEMA = "ident.compare/1"


def comparison_html(comparison: Comparison) -> bytes:
    """One file that opens without a network."""
    residuals = comparison.residuals
    parts = ["<h1>Model against measurement</h1>"]
    parts += ["<h2>Error of the predicted torque</h2>", table_html(error_rows(comparison.errors))]
    for name, errors in comparison.fitted.items():
        if any(errors.values()):
            parts += [f"<h3>{text(name)} as it was fitted</h3>", table_html(error_rows(errors))]
    for name, residual in residuals.items():
        parts.append(f"<h2>{text(name)}</h2>")
        lines = "\n".join([*parts_table(residual, ""), "", *where_text(residual)]).strip()
        parts.append(f"<pre>{text(lines)}</pre>")
    first = next(iter(residuals.values()))
    for number, trace in enumerate(first.traces):
        parts += [
            f"<h2>{text(trace.name)}</h2>",
            figure_html(comparison.plot(number), "measured and predicted torque of every joint"),
            figure_html(comparison.plot_parts(number), "parts of the predicted torque"),
        ]
    parts.append("<h2>Residual against signals</h2>")
    for joint in first.joints:
        parts += [
            f"<h3>{text(joint)}</h3>",
            figure_html(comparison.plot_maps(joint), f"residual of {joint} against its signals"),
        ]
    return page("model against measurement", parts).encode()


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
