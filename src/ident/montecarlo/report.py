"""What a Monte Carlo writes into a folder."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from ident.errors import FitError
from ident.files import write_all
from ident.montecarlo.words import multiplier_rows, notes, parameter_rows
from ident.motion import complete
from ident.motion.report import made_of, understood
from ident.show.charts import Chart
from ident.show.charts.still import image
from ident.show.html import Block, Page, Section, items, table

if TYPE_CHECKING:
    from ident.montecarlo.montecarlo import MonteCarlo

SCHEMA = "ident.montecarlo/1"


def write_monte_carlo(x: MonteCarlo, folder: str | Path) -> list[Path]:
    """montecarlo.json, runs.csv, multiplier_errors.csv, montecarlo.png, report.html; all or none.

    Raises:
        IdentError: if the folder cannot be written.
    """
    return write_all(Path(folder), study_files(x))


def study_files(x: MonteCarlo) -> dict[str, bytes]:
    """The same, by name."""
    return {
        "montecarlo.json": (json.dumps(as_json(x), indent=1, ensure_ascii=False) + "\n").encode(),
        "runs.csv": _csv(x.samples),
        "multiplier_errors.csv": _csv(x.errors),
        "montecarlo.png": image(x.plot().figure, "png"),
        "report.html": _html(x),
    }


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


def _html(x: MonteCarlo) -> bytes:
    plan = x.plan
    said = [
        f"{x.runs} runs at each SNR, seed {plan.seed}; noise on {', '.join(plan.columns)}",
        *(f"truth of {words}" for words in plan.truth.words),
        *(f"{each.name}: {each.words}" for each in plan.estimators if each.words),
    ]
    forces: tuple[Block, ...] = ()
    if rows := multiplier_rows(x):
        forces = (table(rows, "rms error, mean over runs"), *_typical(x))
    lost = notes(x)
    made = plan.mechanism, complete(plan.mechanism, [plan.log])
    sections = (
        Section("What noise does", (items(said), x.plot())),
        Section("Parameters", (table(parameter_rows(x), "Bias and spread of all runs"),)),
        Section("Multipliers", forces),
        Section("Warnings", (items(lost),) if lost else ()),
        understood(*made),
        made_of(*made),
    )
    line = f"{x.runs} runs at each of {', '.join(f'{snr:g}' for snr in x.snr)} dB"
    return Page(f"{plan.mechanism.name} on {plan.log.name}: Monte Carlo", line, sections).html()


def _typical(x: MonteCarlo) -> tuple[Chart, ...]:
    """The picture of typical multipliers at the lowest SNR at which every estimator has one."""
    for snr in reversed(x.snr):
        try:
            return (x.plot_multipliers(snr),)
        except FitError:  # every run of an estimator failed there, as the notes say
            continue
    return ()
