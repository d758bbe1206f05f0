"""What a Monte Carlo writes into a folder."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
from matplotlib.figure import Figure

from ident.errors import FitError
from ident.files import write_all
from ident.fit.report import figure_html, page, table_html, text
from ident.montecarlo.words import multiplier_rows, notes, parameter_rows

if TYPE_CHECKING:
    from ident.montecarlo.montecarlo import MonteCarlo

SCHEMA = "ident.montecarlo/1"


def write_monte_carlo(x: MonteCarlo, folder: str | Path) -> list[Path]:
    """montecarlo.json, runs.csv, multiplier_errors.csv, montecarlo.png, report.html; all or none.

    Raises:
        IdentError: if the folder cannot be written.
    """
    files = {
        "montecarlo.json": (json.dumps(as_json(x), indent=1, ensure_ascii=False) + "\n").encode(),
        "runs.csv": _csv(x.samples),
        "multiplier_errors.csv": _csv(x.errors),
        "montecarlo.png": _png(x.plot()),
        "report.html": _html(x).encode(),
    }
    return write_all(Path(folder), files)


def as_json(x: MonteCarlo) -> dict[str, Any]:
    """Statistics and what they rest on; what is not finite is null."""
    plan = x.plan
    return {
        "schema": SCHEMA,
        "mechanism": plan.mechanism.name,
        "log": plan.log.name,
        "snr": list(x.snr),
        "runs": x.runs,
        "seed": plan.seed,
        "noise_on": list(plan.columns),
        "estimators": [{"name": each.name, "words": each.words} for each in plan.estimators],
        "truth": list(plan.truth.words),
        "parameters": _rows(x.table),
        "multipliers": _rows(x.multipliers),
        "failures": _rows(x.failures),
    }


def _rows(frame: pl.DataFrame) -> list[dict[str, Any]]:
    return [
        {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}
        for row in frame.iter_rows(named=True)
    ]


def _csv(frame: pl.DataFrame) -> bytes:
    stream = io.BytesIO()
    frame.write_csv(stream)
    return stream.getvalue()


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=150)
    return stream.getvalue()


def _html(x: MonteCarlo) -> str:
    plan = x.plan
    said = [
        f"{x.runs} runs at each SNR, seed {plan.seed}; noise on {', '.join(plan.columns)}",
        *(f"truth of {words}" for words in plan.truth.words),
        *(f"{each.name}: {each.words}" for each in plan.estimators if each.words),
    ]
    parts = [
        f"<h1>{text(plan.mechanism.name)} on {text(plan.log.name)}: Monte Carlo</h1>",
        f"<ul>{''.join(f'<li>{text(line)}</li>' for line in said)}</ul>",
        figure_html(x.plot(), "values and errors of all runs over signal-to-noise ratio"),
        "<h2>Parameters</h2>",
        table_html(parameter_rows(x)),
    ]
    if rows := multiplier_rows(x):
        parts += ["<h2>Multipliers: rms error, mean over runs</h2>", table_html(rows)]
        parts += _typical(x)
    if lost := notes(x):
        items = "".join(f"<li>{text(note)}</li>" for note in lost)
        parts += ["<h2>Notes</h2>", f"<ul>{items}</ul>"]
    return page(f"{plan.mechanism.name}: Monte Carlo", parts)


def _typical(x: MonteCarlo) -> list[str]:
    """The picture of typical multipliers at the lowest SNR at which every estimator has one."""
    for snr in reversed(x.snr):
        try:
            figure = x.plot_multipliers(snr)
        except FitError:  # every run of an estimator failed there, as the notes say
            continue
        return [figure_html(figure, f"multipliers of typical runs at {snr:g} dB")]
    return []
