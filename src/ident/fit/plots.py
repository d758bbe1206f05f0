"""Pictures of a fit: torques, multipliers, parameters; the same serve Jupyter and the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ident.fit.values import Value
from ident.residual.plots import time_label
from ident.residual.residual import zero_of
from ident.show.charts import MEASURED, PRIOR, Chart, Dots, Line, Panel

if TYPE_CHECKING:
    from ident.mechanism.mechanism import Mechanism

MOST = 60  # parameters in one picture


def plot_multipliers(
    mechanism: Mechanism,
    t: np.ndarray,
    values: np.ndarray,
    reference: tuple[np.ndarray, np.ndarray] | None = None,
    log: str = "",
) -> Chart:
    """λ(t) (n, m) of a log, beside known reactions (t, (n, m)) where there are any."""
    zero = zero_of(t)
    names, units = mechanism.kinematics.multipliers, mechanism.kinematics.units
    rows = []
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        if not np.isfinite(values[:, i]).any():
            continue
        lines = []
        if reference is not None:
            lines.append(Line(reference[0] - zero, reference[1][:, i], "known", MEASURED, 2.4))
        lines.append(Line(t - zero, values[:, i], "identified", 0))
        rows.append((Panel(tuple(lines), time_label(zero), f"{name} [{unit}]", height=1.8),))
    if not rows:
        rows = [(Panel((), "t [s]", title="this motion determines none of them"),)]
    words = "Multipliers λ over time, the reaction forces of the closures"
    return Chart(words, tuple(rows), shared_x=True, clock=log)


def plot_parameters(values: Sequence[Value]) -> Chart | None:
    """Values ± 1.96 standard errors beside the prior, a panel a unit; None where there are none."""
    known = [v for v in values if v.stderr is not None and np.isfinite(v.stderr)]
    shown = known[:MOST]
    units = list(dict.fromkeys(v.unit for v in shown))
    rows = [(_of_unit(unit, [v for v in shown if v.unit == unit]),) for unit in units]
    words = "Identified values with their 95 % intervals, beside what was assumed before"
    if len(known) > MOST:
        words += f"; the first {MOST} of {len(known)}, all are in the tables"
    return Chart(words, tuple(rows)) if rows else None


def _of_unit(unit: str, values: Sequence[Value]) -> Panel:
    at, none = np.arange(len(values), dtype=float), np.zeros(len(values))
    prior, found = (np.array([getattr(v, key) for v in values]) for key in ("prior", "value"))
    reach = np.array([1.96 * (v.stderr or 0.0) for v in values])
    marks = (Dots(at, prior, none, "prior", PRIOR), Dots(at, found, reach, "identified", 0))
    names = tuple(v.name for v in values)
    return Panel(marks, f"[{unit}]", y_names=names, height=0.7 + 0.22 * len(values))
