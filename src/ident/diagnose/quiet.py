"""Rows that may decide which effect is missing: those away from reversals of the joints they feel.

Around a reversal the sign of a filtered speed, stick phases and the torque's jump are out of step
by a little, and every such little looks like some effect; it is left out for the choice, not for
the fit.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from ident.equations.rows import LEVER, ROUNDING, reach
from ident.fit.table import Table

SLOW = 0.03  # share of a joint's top speed below which it counts as reversing
GUARD = 0.06  # s on either side that are left out
PERIODS = 0.3  # of the motion's bandwidth, where that is less
ENOUGH = 0.5  # share of a coordinate's rows that must stay


def quiet(table: Table) -> np.ndarray:
    """(N, d) whether a row is away from the reversals that it feels, and informs."""
    guard = min(GUARD, PERIODS / max(table.motion.band.motion, 1e-9))
    while True:
        found = np.concatenate([_of(table, i, guard) for i in range(len(table.scenes))])
        if guard < 1e-3 or found.mean(axis=0).min() >= ENOUGH:
            return found & table.informed if (found & table.informed).any() else table.informed
        guard *= 0.5


def _of(table: Table, number: int, guard: float) -> np.ndarray:
    e, mechanism = table.scenes[number].e, table.mechanism
    at = table.sample[table.experiment == number]
    top = np.quantile(np.abs(e.yd[e.usable]), 0.98, axis=0)
    slow = np.abs(e.yd) < np.maximum(SLOW * top, e.still)
    slow &= top > e.still  # a joint that never moves has no reversals
    wide = 2 * int(guard * e.rate) + 1
    near = maximum_filter1d(slow.astype(np.uint8), wide, axis=0)[at].astype(bool)
    d = table.b.shape[1]
    found = np.ones((len(at), d), dtype=bool)
    farthest = reach(e)
    for joint in mechanism.joints:
        j = mechanism.joint_index[joint.name]
        if farthest is None:
            if joint.index < d:
                found[:, joint.index] &= ~near[:, j]
            continue
        assert e.leverage is not None
        most = farthest[j]
        feels = (most > ROUNDING * most.max()) & (np.abs(e.leverage[at, j]) > LEVER * most)
        found &= ~(near[:, j][:, None] & feels)
    return found
