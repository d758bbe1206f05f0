"""Shapes, and what depends on the model's own prediction, refined by passes over all portions.

    s ← s + δs,  [Γ E S] [p; c; s] = b + S s₀

as in `fit.descend`, one pass a step: the factors of a pass give the least error at its point, which
tells whether the step before was good, and the next step. Source: Golub, Pereyra, SIAM J. Numer.
Anal. 10(2), 1973.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.equations.point import Point
from ident.fit.descend import shape_bounds, stepped
from ident.fit.estimate import Estimate, estimate
from ident.fit.regression import Regression

PASSES = 8
RESTING = 0.01  # standard errors by which a step may still move predictions
ROUNDING = 1e-9  # of the sum of squares, within which two errors are the same


@dataclass(frozen=True, eq=False)
class Step:
    """How far a search has come.

    Attributes:
        point: of the next pass.
        best: the best point so far, from which it is a step; None before the first pass.
        loss: sum of squares there, weighted by `sigma` (d,) [N m | N], those of the first pass.
        moves: standard errors by which predictions move with the step.
    """

    point: Point
    best: Point | None = None
    loss: float = np.inf
    sigma: np.ndarray | None = None
    moves: float = np.inf

    @property
    def rests(self) -> bool:
        """Whether no further pass is needed."""
        return self.moves <= RESTING


def after(r: Regression, found: Estimate, step: Step) -> Step:
    """The step that follows from the pass at `step.point`.

    Args:
        r: the equations at that point.
        found: what they give.
        step: that led to it.
    """
    columns = r.columns
    shapes = np.zeros(len(columns), dtype=bool)
    shapes[columns.shapes] = True
    sigma = found.sigma if step.sigma is None else step.sigma
    zeros = np.zeros(len(r.factors))
    at = estimate(r.factors, r.prior, zeros, sigma=sigma, held=found.held | shapes)
    loss = at.factor.residual_norm(at.solution.x) ** 2
    if step.best is not None and loss > step.loss * (1 + ROUNDING):
        values = {
            name: 0.5 * (step.best.values.get(name, value) + value)
            for name, value in r.point.values.items()
        }
        return replace(step, point=Point(r.point.pi, values))
    x = found.solution.x
    if shapes.any():
        bounds = shape_bounds(r.mechanism, columns, r.motion, r.point)
        x = stepped(columns, r.point, x, bounds, 1.0)
    implicit = any(effect.implicit for effect in r.mechanism.effects)
    moved = np.where(shapes | implicit, x - _here(r), 0.0)
    moves = float(np.linalg.norm(found.factor.R @ moved))
    return Step(r.point.at(r.mechanism, columns, x), r.point, loss, sigma, moves)


def _here(r: Regression) -> np.ndarray:
    """x (k,) of the regression's point."""
    names = r.columns.names[len(r.columns.rigid) :]
    others = [r.point.values.get(name, 0.0) for name in names]
    return np.concatenate([r.point.pi[r.columns.rigid], others])
