"""The picture of an excitation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from ident.excite.excitation import Excitation

CHANNELS = (("q", "position"), ("v", "speed"), ("a", "acceleration"), ("tau", "torque"))
NEAR = 2.0  # times what is reached: a limit farther away is not drawn


def plot_excitation(x: Excitation) -> Figure:
    """One row a drive, one column a quantity, one period; limits dashed."""
    t = x.log.t
    one = t <= x.period
    drives = [name.removeprefix("tau.") for name in x.log.columns if name.startswith("tau.")]
    figure = Figure(figsize=(13, 0.8 + 1.9 * len(drives)), layout="constrained")
    axes = figure.subplots(len(drives), 4, sharex=True, squeeze=False)
    for row, name in zip(axes, drives, strict=True):
        for axis, (channel, kind) in zip(row, CHANNELS, strict=True):
            use = x.use(name, kind)
            y = x.log.columns[f"{channel}.{name}"][one]
            axis.plot(t[one], y, color="C0", lw=1.2)
            size = float(np.abs(y).max())
            for limit in (use.lower, use.upper):
                if np.isfinite(limit) and abs(limit) < NEAR * size:
                    axis.axhline(limit, color="C3", lw=0.8, ls="--")
            axis.set_ylabel(f"{name} [{use.unit}]" if channel == "q" else f"[{use.unit}]")
            axis.grid(alpha=0.3)
    for axis, (_, kind) in zip(axes[0], CHANNELS, strict=True):
        axis.set_title(kind)
    for axis in axes[-1]:
        axis.set_xlabel("t [s]")
    return figure
