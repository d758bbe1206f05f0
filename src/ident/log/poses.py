"""Tables of poses: each row is an average over a machine that is held at rest; rows have no order.

A log of a motion is told from one by the order of its rows (von Neumann, Annals of Mathematical
Statistics 12(4), 1941): the mean squared step from row to row, over the variance,

    η = mean (x_{i+1} − x_i)² / var x         2 where rows have no order, near 0 in a motion
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.log.table import Array

UNORDERED = 1.0  # level: η, over all joints, from which rows have no order
ORDERED = 0.3  # level: η below which they have one; a sine of 12 samples a period
MOVED = 0.02  # range: rad or m: standard deviation of a position that is no noise
FEWEST_POSES = 4  # range
REST = 1e-12  # numerics: rad/s, m/s and rad/s², m/s²: what is less is 0, but for rounding


def order(columns: Mapping[str, Array]) -> float | None:
    """Return η, the mean over all positions `q.` that change; None where none does."""
    etas = []
    for name, x in columns.items():
        known = x[np.isfinite(x)] if name.startswith("q.") else x[:0]
        if len(known) < FEWEST_POSES:
            continue
        size = float(np.abs(known).max()) or 1.0
        known = known / size  # a number near the largest has a square too
        spread = float(np.std(known))
        if spread * size > MOVED:
            etas.append(float(np.mean(np.diff(known) ** 2)) / spread**2)
    return float(np.mean(etas)) if etas else None


def are_poses(columns: Mapping[str, Array], t: Array | None) -> bool:
    """Return whether rows are poses: velocities and accelerations that are all logged as 0 while
    positions change; or positions without order whose `t` only counts them, in any order; without
    a `t` (None), unless they have an order. Stamps of a clock are those of a motion.
    """
    eta = order(columns)
    if eta is None or not any(name.startswith("tau.") for name in columns):
        return False
    moved = [
        name[2:]
        for name, x in columns.items()
        if name.startswith("q.") and len(known := x[np.isfinite(x)]) and known.min() < known.max()
    ]
    rates = [columns.get(f"{letter}.{name}") for name in moved for letter in "va"]
    at_rest = bool(rates) and all(
        x is not None and np.nanmax(np.abs(x), initial=0.0) <= REST for x in rates
    )
    if t is None:
        return at_rest or eta > ORDERED
    counted = np.isfinite(t).all() and np.array_equal(np.sort(t), t.min() + np.arange(len(t)))
    return at_rest or (bool(counted) and eta > UNORDERED)
