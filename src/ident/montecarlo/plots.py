"""Pictures: the spread over SNR (Figs. 4, 7, 8), and typical multipliers (Figs. 5, 9)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ident.errors import FitError
from ident.montecarlo.statistics import FORCE
from ident.show.charts import MEASURED, PRIOR, Boxes, Chart, Level, Line, Mark, Panel
from ident.tables import shortened

if TYPE_CHECKING:
    from ident.montecarlo.montecarlo import MonteCarlo

MOST = 12  # parameters in one figure
ACROSS = 3
WIDTH = 0.8  # of a distance between two SNRs, that the boxes of all estimators take
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def plot_spread(x: MonteCarlo, parameters: Sequence[str] | None) -> Chart:
    """One panel a parameter and a multiplier; boxes of all runs at each SNR, 5 to 95 %."""
    names = list(parameters or x.parameters[:MOST])
    shown = x.errors.drop_nulls("rms")["multiplier"].unique().to_list()
    forces = [name for name in (*x.plan.truth.multipliers, *FORCE) if name in shown]
    panels = []
    for name in names:
        own = x.samples.filter(pl.col("parameter") == name)
        truth = Level(x.plan.truth.values[name], colour=PRIOR, dashed=True)
        label = f"{shortened(name, 40)} [{x.plan.truth.units[name]}]"
        panels.append(_spread(x, (truth, *_boxes(x, own, "value")), label))
    for name in forces:
        own = x.errors.filter(pl.col("multiplier") == name)
        label = f"rms error of {name} [{own['unit'][0]}]"
        panels.append(_spread(x, _boxes(x, own, "rms"), label, logarithmic=True))
    rows = tuple(tuple(panels[i : i + ACROSS]) for i in range(0, len(panels), ACROSS))
    words = f"{x.plan.mechanism.name}: {x.runs} runs at each SNR, 5 to 95 %; dashed: the truth"
    if (left := len(x.parameters) - len(names)) > 0 and parameters is None:
        words += f"; {left} parameters more are not drawn"
    return Chart(words, rows, width=13)


def _spread(x: MonteCarlo, marks: tuple[Mark, ...], label: str, logarithmic: bool = False) -> Panel:
    names = tuple(f"{snr:g}" for snr in x.snr)
    return Panel(marks, "SNR [dB]", label, x_names=names, logarithmic=logarithmic, height=3.0)


def _boxes(x: MonteCarlo, rows: pl.DataFrame, column: str) -> tuple[Boxes, ...]:
    """Of each estimator, beside each other at every SNR."""
    step = WIDTH / len(x.estimators)
    found = []
    for i, estimator in enumerate(x.estimators):
        at, quantiles = [], []
        for place, snr in enumerate(x.snr):
            here = (pl.col("estimator") == estimator) & (pl.col("snr") == snr)
            values = rows.filter(here)[column].drop_nulls().to_numpy()
            if len(values):
                at.append(place + (i + 0.5) * step - WIDTH / 2)
                quantiles.append(np.quantile(values, QUANTILES))
        if at:
            boxes = np.array(quantiles)
            found.append(Boxes(np.array(at), boxes, 0.85 * step, estimator, i))
    return tuple(found)


def plot_typical(x: MonteCarlo, snr: float) -> Chart:
    """True multipliers, and those of the run whose error is closest to the estimator's average."""
    truth = x.plan.truth
    known = [i for i in range(len(truth.multipliers)) if np.isfinite(truth.reactions[:, i]).any()]
    if not known:
        raise FitError(
            f"{x.plan.mechanism.name}: has no multipliers that are known; nothing to draw"
        )
    lines = {i: [Line(truth.t, truth.reactions[:, i], "true", MEASURED, 2.4)] for i in known}
    for number, estimator in enumerate(x.estimators):
        run = x.typical(estimator, snr)
        t, values = x.fit(estimator, snr, run).multipliers[0]
        for i in known:
            label = f"{estimator}, run {run}"
            lines[i].append(Line(t, values[:, i], label, number, 0.9))
    rows = []
    for i in known:
        label = f"{truth.multipliers[i]} [{truth.multiplier_units[i]}]"
        rows.append((Panel(tuple(lines[i]), "t [s]", label),))
    words = f"Multipliers of {x.plan.mechanism.name} at {snr:g} dB: runs of average error"
    return Chart(words, tuple(rows), shared_x=True, width=10, clock=x.plan.log.name)
