"""report.html and compare.json of a comparison."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.motion.report import made_of, understood
from ident.page import Page, Section, table
from ident.residual import report
from ident.residual.error import Error, error_rows
from ident.residual.residual import Residual

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
        understood(mechanism, motion),
        made_of(mechanism, motion),
    )
    title = f"{mechanism.name}: model against measurement"
    return Page(title, comparison.headline, sections).html()


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
