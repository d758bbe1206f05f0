"""How the torque that a model lacks changes with the motion.

    G_uir = ∂r_u/∂u_i^(r),    r = b − A x,    r = 0, 1, 2 for position, velocity, acceleration

by differences: everything that a motion enters is in them, closures, effects and corrections too.
At standstill dry friction is open, and no motion is asked to make it otherwise: G = 0.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ident.equations.correct import Seen, corrected
from ident.equations.point import Point
from ident.equations.rows import informing, reach
from ident.equations.samples import reduced
from ident.equations.terms import told_by, unbalanced
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment
from ident.motion.place import at_coordinates, at_rates
from ident.motion.place import reduced as with_leverage

STEP = 1e-6  # of the spread of a coordinate or its derivative
CHUNK = 4096


def gain(
    mechanism: Mechanism,
    e: Experiment,
    names: tuple[str, ...],
    point: Point,
    cutoff: float | None,
) -> np.ndarray:
    """G (n, d, coordinates, 3) of all samples of an experiment, for the joints `names`.

    Args:
        mechanism, e: what is moved; e may be thinned.
        names: coordinates that are moved; others of `e.logged` stay.
        point: at which r is taken.
        cutoff: of the rows' filter [Hz].
    """
    base = _lacking(mechanism, e, point, cutoff)
    G = np.empty((*base.shape, len(names), 3))
    for i, order, step, beside in _beside(mechanism, e, names):
        G[:, :, i, order] = (_lacking(mechanism, beside, point, cutoff) - base) / step
    whole = reduced(mechanism, e, slice(None), point)
    told = [each for effect in mechanism.effects for each in told_by(whole, effect)]
    G[~informing(whole, told, reach(e))] = 0.0
    return G


def _beside(
    mechanism: Mechanism, e: Experiment, names: tuple[str, ...]
) -> Iterator[tuple[int, int, float, Experiment]]:
    """(coordinate, order, step, experiment) with one derivative of one coordinate displaced."""
    surplus = len(e.logged) > mechanism.degrees_of_freedom
    given = names if surplus else e.logged
    index = [mechanism.joint_index[name] for name in given]
    known = np.stack([y[:, index] for y in (e.y, e.yd, e.ydd)])
    for i, name in enumerate(names):
        for order in range(3):
            moved = known.copy()
            series = moved[order][:, given.index(name)]
            step = STEP * (float(np.std(series)) or 1.0)
            series += step
            if order or not mechanism.closures:
                yield i, order, step, at_rates(mechanism, e, given, moved)
                continue
            there = at_coordinates(mechanism, e, given, moved)
            yield i, order, step, with_leverage(mechanism, there, e.independent)[0]


def _lacking(mechanism: Mechanism, e: Experiment, point: Point, cutoff: float | None) -> np.ndarray:
    """r = b − A x (n, d) at full rate."""
    seen = corrected(Seen(mechanism, e), point, cutoff)
    parts = [
        unbalanced(
            reduced(seen.mechanism, seen.e, slice(start, start + CHUNK), point, seen.memo), point
        )
        for start in range(0, len(e), CHUNK)
    ]
    return np.concatenate(parts)
