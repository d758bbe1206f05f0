"""Pictures: the spread over SNR (Figs. 4, 7, 8), and typical multipliers (Figs. 5, 9)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ident.errors import FitError
from ident.fit.summary import shortened
from ident.montecarlo.statistics import FORCE

if TYPE_CHECKING:
    from ident.montecarlo.montecarlo import MonteCarlo

MOST = 12  # parameters in one figure
ACROSS = 3
WIDTH = 0.8  # of a distance between two SNRs, that the boxes of all estimators take
FLIERS = {"marker": ".", "markersize": 3}


def plot_spread(x: MonteCarlo, parameters: Sequence[str] | None) -> Figure:
    """One panel a parameter and a multiplier; boxes of all runs at each SNR."""
    names = list(parameters or x.parameters[:MOST])
    shown = x.errors.drop_nulls("rms")["multiplier"].unique().to_list()
    forces = [name for name in (*x.plan.truth.multipliers, *FORCE) if name in shown]
    panels = len(names) + len(forces)
    down = -(-panels // ACROSS)
    figure = Figure(figsize=(13, 0.8 + 3.0 * down), layout="constrained")
    axes = figure.subplots(down, ACROSS, squeeze=False).ravel()
    for axis, name in zip(axes, names, strict=False):
        own = x.samples.filter(pl.col("parameter") == name)
        _boxes(axis, x, own, "value")
        axis.axhline(x.plan.truth.values[name], color="0.3", lw=0.8, ls="--")
        axis.set_ylabel(f"{shortened(name, 40)} [{x.plan.truth.units[name]}]")
    for axis, name in zip(axes[len(names) :], forces, strict=False):
        own = x.errors.filter(pl.col("multiplier") == name)
        _boxes(axis, x, own, "rms")
        axis.set_yscale("log")
        axis.set_ylabel(f"rms error of {name} [{own['unit'][0]}]")
    for axis in axes[panels:]:
        axis.set_visible(False)
    title = f"{x.plan.mechanism.name}: {x.runs} runs at each SNR"
    if (left := len(x.parameters) - len(names)) > 0 and parameters is None:
        title += f"; {left} parameters more are not drawn"
    figure.suptitle(title)
    handles = [axes[0].plot([], [], color=f"C{i}", lw=6)[0] for i in range(len(x.estimators))]
    figure.legend(handles, x.estimators, loc="outside lower center", ncols=len(x.estimators))
    return figure


def _boxes(axis: Axes, x: MonteCarlo, rows: pl.DataFrame, column: str) -> None:
    """Median, quartiles, and whiskers of 1.5 times their distance; all else is a point."""
    step = WIDTH / len(x.estimators)
    for i, estimator in enumerate(x.estimators):
        for at, snr in enumerate(x.snr):
            here = (pl.col("estimator") == estimator) & (pl.col("snr") == snr)
            values = rows.filter(here)[column].drop_nulls().to_numpy()
            if len(values):
                box = axis.boxplot(
                    values, positions=[at + (i + 0.5) * step - WIDTH / 2], widths=0.85 * step,
                    patch_artist=True, manage_ticks=False,
                    flierprops=FLIERS | {"markeredgecolor": f"C{i}"},
                )  # fmt: skip
                box["boxes"][0].set(facecolor=f"C{i}", alpha=0.6)
                box["medians"][0].set(color="black")
    axis.set_xticks(range(len(x.snr)), [f"{snr:g}" for snr in x.snr])
    axis.set_xlim(-0.5, len(x.snr) - 0.5)
    axis.set_xlabel("SNR [dB]")
    axis.grid(alpha=0.3)


def plot_typical(x: MonteCarlo, snr: float) -> Figure:
    """True multipliers, and those of the run whose error is closest to the estimator's average."""
    truth = x.plan.truth
    known = [i for i in range(len(truth.multipliers)) if np.isfinite(truth.reactions[:, i]).any()]
    if not known:
        raise FitError(
            f"{x.plan.mechanism.name}: has no multipliers that are known; nothing to draw"
        )
    figure = Figure(figsize=(10, 1.2 + 2.2 * len(known)), layout="constrained")
    axes = figure.subplots(len(known), 1, sharex=True, squeeze=False)[:, 0]
    for axis, i in zip(axes, known, strict=True):
        axis.plot(truth.t, truth.reactions[:, i], color="0.6", lw=2.5, label="true")
        axis.set_ylabel(f"{truth.multipliers[i]} [{truth.multiplier_units[i]}]")
        axis.grid(alpha=0.3)
    for number, estimator in enumerate(x.estimators):
        run = x.typical(estimator, snr)
        t, values = x.fit(estimator, snr, run).multipliers[0]
        for axis, i in zip(axes, known, strict=True):
            axis.plot(t, values[:, i], color=f"C{number}", lw=0.9, label=f"{estimator}, run {run}")
    axes[-1].set_xlabel("t [s]")
    figure.suptitle(f"{x.plan.mechanism.name} at {snr:g} dB: runs of average error")
    handles = axes[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=len(x.estimators) + 1)
    return figure
