"""The picture of an excitation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ident.show.charts import RESIDUAL, Chart, Level, Line, Mark, Panel

if TYPE_CHECKING:
    from ident.excite.excitation import Excitation

CHANNELS = (("q", "position"), ("v", "speed"), ("a", "acceleration"), ("tau", "torque"))
NEAR = 2.0  # times what is reached: a limit farther away is not drawn


def plot_excitation(x: Excitation) -> Chart:
    """One row a drive, one column a quantity, one period; limits dashed."""
    one = x.log.t <= x.period
    t = x.log.t[one]
    rows: list[tuple[Panel, ...]] = []
    for name in (c.removeprefix("tau.") for c in x.log.columns if c.startswith("tau.")):
        row = []
        for channel, kind in CHANNELS:
            use = x.use(name, kind)
            y = x.log.columns[f"{channel}.{name}"][one]
            near = NEAR * float(np.abs(y).max())
            limits = [b for b in (use.lower, use.upper) if np.isfinite(b) and abs(b) < near]
            marks: list[Mark] = [Line(t, y)]
            marks += [Level(b, dashed=True, colour=RESIDUAL) for b in limits]
            label = f"{name} [{use.unit}]" if channel == "q" else f"[{use.unit}]"
            row.append(Panel(tuple(marks), "t [s]", label, kind if not rows else "", height=1.9))
        rows.append(tuple(row))
    words = "One period of the motion: position, speed, acceleration and torque of every drive"
    return Chart(words, tuple(rows), shared_x=True, width=13, clock=x.log.name)
