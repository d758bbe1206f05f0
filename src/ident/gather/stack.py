"""Multipliers in a time basis, in portions: each a stretch of one stack, merged without a seam.

The knots are those of the whole log, so that portions meet inside one interval of them, and their
sum is the batch's elimination, block of time by block of time.
"""

from __future__ import annotations

import numpy as np

from ident.equations.scene import Scene
from ident.equations.stack import stack
from ident.fit.accumulate import Cell
from ident.fit.banded import cells_of_blocks, time_blocks
from ident.gather.plan import Plan, Portion
from ident.solve.basis import Basis
from ident.solve.eliminate import eliminate
from ident.solve.stretch import Stretch


def stacked(plan: Plan, portion: Portion, scene: Scene) -> Stretch | None:
    """What a portion adds to the stack of its log; None where no row informs.

    Args:
        plan: of all portions.
        portion: which one.
        scene: of its experiment.
    """
    basis = _basis(plan, portion.log)
    begins, total = np.arange(1, time_blocks(basis)) * basis.count // time_blocks(basis), None
    for segment in scene.e.segments():
        for chunk in stack(scene, plan.band.cutoff, segment, basis, portion.since, portion.until):
            if len(chunk.b):
                stretch = Stretch.of(chunk, begins)
                total = stretch if total is None else total + stretch
    return total


def finished(plan: Plan, log: int, stretch: Stretch) -> list[Cell]:
    """The cells of a log's stack, of coordinate 0, when all is known.

    Args:
        plan: of all portions.
        log: its number.
        stretch: the sum of its portions'.
    """
    basis = _basis(plan, log)
    return cells_of_blocks(log, 0, stretch.closed(), basis.t0, basis.t_end)


def multipliers_in(plan: Plan, log: int, scene: Scene, x: np.ndarray) -> np.ndarray:
    """λ(t) = B(t) a (n, m) [N | N m] of a log's portion with margins, at parameters x (k,).

    Beyond its margins nothing is known here, which the innermost samples do not feel.
    """
    e, whole = scene.e, _basis(plan, log)
    values = np.full((len(e), len(plan.mechanism.kinematics.multipliers)), np.nan)
    for segment in e.segments():
        t = e.t[segment]
        if len(t) < 3:
            continue
        before = np.floor((t[0] - whole.t0) / whole.spacing + 1e-9)
        begin = float(whole.t0 + before * whole.spacing)  # on the knots of the whole log
        basis = Basis.spanning(begin, float(t[-1]), whole.spacing, whole.degree)
        chunks = [c for c in stack(scene, plan.band.cutoff, segment, basis) if len(c.b)]
        if chunks:
            a = eliminate(chunks, basis.count).back_substitute(x)
            values[segment] = basis.evaluate(a, t)
    return values


def _basis(plan: Plan, log: int) -> Basis:
    """Of λ(t) over a whole log."""
    clock, settings = plan.parts[log].survey.clock, plan.mechanism.multipliers
    return Basis.spanning(clock.t0, clock.t_end, settings.spacing, settings.degree)
