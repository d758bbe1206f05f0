"""Rows around velocity reversals, at which dry friction is least exact.

Dry friction is taken as Fc sign(v). In a machine it builds up over some speed or distance, and in
rows at reversals that is a systematic error: it moves Fc and Fv by more than the scatter of the
residual shows. By how much is known from the fit without these rows:

    x_away − x        x_away: weighted least squares without rows at reversals, where they fit worse
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.equations.rows import LEVER, ROUNDING, largest_transmission
from ident.fit.channel_fits import ChannelEquations
from ident.fit.problem import Table
from ident.information.estimate import Estimate

SLOW = 0.03  # share of a joint's top speed below which it counts as reversing
GUARD = 0.06  # s on either side that are left out; 0.3 periods of the motion, where that is less
ENOUGH = 0.5  # share of a coordinate's rows that must stay
FEWEST = 30  # rows at reversals that tell how well they fit
WORSE = 4.0  # squared residual of a row there over that of the others, from which they fit worse
MATTERS = 0.003  # rms of the residual there over that of the torque, as `material` of a diagnosis


def away_from_reversals(table: Table) -> np.ndarray:
    """(N, d) whether a row is in motion and away from the reversals that it feels; of a coordinate
    with few such rows, whether it informs and is away from them.

    Around a reversal the sign of a filtered speed, stick phases and the torque's jump are out of
    step by a little, and every such little looks like some effect.
    """
    guard = min(GUARD, 0.3 / max(table.motion.band.motion, 1e-9))
    while True:
        found = np.concatenate([_away(table, i, guard) for i in range(len(table.scenes))])
        if guard < 1e-3 or found.mean(axis=0).min() >= ENOUGH:
            moving = found & table.moving
            few = moving.mean(axis=0) < ENOUGH  # slow filters have standstill in most rows
            use = np.where(few, found & table.informed, moving)
            return use if use.any() else table.informed
        guard *= 0.5


def _away(table: Table, number: int, guard: float) -> np.ndarray:
    e, mechanism = table.scenes[number].e, table.mechanism
    at = table.sample[table.experiment == number]
    top = np.quantile(np.abs(e.yd[e.usable]), 0.98, axis=0)
    slow = np.abs(e.yd) < np.maximum(SLOW * top, e.still)
    slow &= top > e.still  # a joint that never moves has no reversals
    from scipy.ndimage import maximum_filter1d  # takes 0.1 s to import

    near = maximum_filter1d(slow.astype(np.uint8), 2 * int(guard * e.rate) + 1, axis=0)
    near = near[at].astype(bool)
    d = table.b.shape[1]
    found = np.ones((len(at), d), dtype=bool)
    farthest = largest_transmission(e)
    for joint in mechanism.joints:
        j = mechanism.joint_index[joint.name]
        if farthest is None:
            if joint.index < d:
                found[:, joint.index] &= ~near[:, j]
            continue
        most = farthest[j]
        feels = (most > ROUNDING * most.max()) & (np.abs(e.leverage[at, j]) > LEVER * most)
        found &= ~(near[:, j][:, None] & feels)
    return found


def misfit_at_reversals(table: Table, away: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(d,) squared residual of a row at reversals over that of a row `away` (N, d) from them, of
    unknowns x (k,); 0 where such rows are few, or do not matter.
    """
    found = np.zeros(table.b.shape[1])
    squares = (table.b - table.A @ x) ** 2
    for u, (calm, informed) in enumerate(zip(away.T, table.informed.T, strict=True)):
        near = informed & ~calm
        if near.sum() < FEWEST or not calm.any():
            continue
        there, elsewhere = (float(squares[rows, u].mean()) for rows in (near, calm))
        if there > MATTERS**2 * float((table.tau[informed, u] ** 2).mean()):
            found[u] = there / max(elsewhere, 1e-300)
    return found


def moved_by_reversals(
    table: Table, away: np.ndarray, estimate: Estimate, misfit: np.ndarray
) -> np.ndarray:
    """(k,) x_away − x: what rows at reversals do to the unknowns, where they fit worse."""
    moved, worse, free = np.zeros(len(estimate.x)), misfit > WORSE, ~estimate.held
    if worse.any() and free.any():
        use = table.informed & (away | ~worse)
        equations = ChannelEquations.of(estimate, table, use, [])
        none = np.zeros((0, equations.k)), np.zeros(0)  # the fit has no limits either
        equations = replace(equations, limits=none)
        logged = equations.as_logged
        moved[free] = equations.solution(logged, equations.noise(logged)) - estimate.x[free]
    return moved
