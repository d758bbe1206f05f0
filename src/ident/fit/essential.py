"""Essential base parameters of a model: backward elimination on the triangles.

Base parameters are set to zero one after the other, the one with the largest relative standard
error first (M. T. Pham, M. Gautier, Essential parameters of robots, IEEE CDC 1991), the others
estimated anew, as long as no joint's held-out error rises by more than LOSS. What is left are the
essential parameters: a shorter model, that often predicts better.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from ident.display import Displayed, render
from ident.fit.problem import Problem
from ident.information.blocks import Error, Squares
from ident.information.estimate import Estimate
from ident.information.held_out import fold_count, folds, rises, without_each
from ident.information.triangle import Triangle

LOSS = 0.01  # share by which any joint's held-out error may rise in all
REGULAR = 1e-12  # of a column's norm: a smaller pivot is rounding


@dataclass(frozen=True)
class Dropped:
    """A base parameter that is not needed.

    Attributes:
        name: its leading unknown; relative: its standard error over its size when it was dropped.
        rise: of the held-out error with it and all before it at zero, over that of the full model,
            in the joint where it rises most; below zero where it falls in all.
    """

    name: str
    relative: float
    rise: float


@dataclass(frozen=True, repr=False)
class Essential(Displayed):
    """The essential base parameters of a fit.

    Attributes:
        names: leading unknowns of those that stay.
        values, stderr: estimated without the others, by name.
        dropped: in the order in which they were set to zero.
        full, reduced: held-out errors of both models, by joint.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    stderr: Mapping[str, float]
    dropped: tuple[Dropped, ...]
    full: Mapping[str, Error]
    reduced: Mapping[str, Error]

    @property
    def line(self) -> str:
        """Number of essential parameters, and what the others would change, in one line."""
        return str(render(self, "line"))

    def json(self) -> dict[str, object]:
        """Return the entry of fit.json."""
        return {
            "parameters": [
                {"name": n, "value": self.values[n], "stderr": self.stderr[n]} for n in self.names
            ],
            "dropped": [
                {"name": d.name, "relative_stderr": min(d.relative, 1e30), "rise": d.rise}
                for d in self.dropped
            ],
            "held_out": {
                joint: {"full": self.full[joint].rms, "reduced": self.reduced[joint].rms}
                for joint in self.full
            },
        }


def essential(
    problem: Problem, estimate: Estimate, covariance: np.ndarray, loss: float = LOSS
) -> Essential | None:
    """Return the essential parameters; None for data that cannot be parted into stretches of time.

    Args:
        problem: the equations; estimate: the full model.
        covariance: of its base parameters.
        loss: share by which a joint's held-out error may rise in all.
    """
    columns, own = problem.columns, estimate.base.independent
    trial = _HeldOutTrial.of(problem, estimate)
    if trial is None or not len(own):
        return None
    alone = np.linalg.norm(lapack.dtrtri(trial.total.R)[0], axis=1)  # errors for unit noise
    stderr = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    wider = np.where(np.isfinite(stderr) & (alone > 0), stderr / np.maximum(alone, 1e-300), 1.0)
    may_go = ~np.isin(own, columns.shapes)  # a shape's column is a slope, no size
    needed, dropped = np.ones(len(own), dtype=bool), []
    full = best = trial.held_out(needed)
    while (needed & may_go).any():
        beta, stderr = _solved(trial.total, needed, wider)
        relative = np.where(needed & may_go, stderr / np.maximum(np.abs(beta), 1e-300), -np.inf)
        weakest = int(relative.argmax())
        fewer = needed.copy()
        fewer[weakest] = False
        after = trial.held_out(fewer)
        change = float(rises(after, full).max(initial=-1.0))
        if change > loss:
            break
        needed, best = fewer, after
        dropped.append(Dropped(columns.names[own[weakest]], float(relative[weakest]), change))
    beta, stderr = _solved(trial.total, needed, wider)
    names = tuple(columns.names[i] for i in own[needed])
    joints = problem.motion.independent
    return Essential(
        names,
        dict(zip(names, map(float, beta[needed]), strict=True)),
        dict(zip(names, map(float, stderr[needed]), strict=True)),
        tuple(dropped),
        full.errors(joints, problem.units),
        best.errors(joints, problem.units),
    )


@dataclass(frozen=True, eq=False)
class _HeldOutTrial:
    """Triangles in the base parameters alone, weighted: of all rows, by stretch, and to score."""

    total: Triangle
    others: tuple[Triangle, ...]
    scored: tuple[tuple[Triangle, ...], ...]
    torque: np.ndarray

    @classmethod
    def of(cls, problem: Problem, estimate: Estimate) -> _HeldOutTrial | None:
        information = problem.information
        parted = folds(information, fold_count(information))
        if len(parted) < 2:
            return None
        own, sigma = estimate.base.independent, problem.row_scale(estimate)
        known = np.where(estimate.held, estimate.x, 0.0)  # x_D = 0: then x_I = β
        fitting, scored = [], []
        for part in parted.values():
            small = [t.restricted(own, known) for t in part.totals]
            rest = [t.restricted(own, known) for t in part.at_rest]
            fitting.append(
                Triangle.merge([t.scaled(1 / s) for t, s in zip(small, sigma, strict=True)])
            )
            scored.append(tuple(Triangle.merge(pair) for pair in zip(small, rest, strict=True)))
        others = tuple(without_each(fitting))
        return cls(Triangle.merge(fitting), others, tuple(scored), information.measured[0])

    def held_out(self, needed: np.ndarray) -> Squares:
        """Return errors in each stretch of the model fitted to the others, some β being zero."""
        found = Squares.zero(len(self.torque))
        for triangle, both in zip(self.others, self.scored, strict=True):
            beta, _ = _solved(triangle, needed, None)
            error = np.array([t.residual_norm(beta) ** 2 for t in both])
            found = found + Squares(error, 0 * error, np.array([t.rows for t in both]))
        return Squares(found.error, self.torque, found.rows)


def _solved(
    triangle: Triangle, needed: np.ndarray, wider: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return β (n,), zero where not needed, and standard errors (n,)."""
    own = triangle.restricted(np.flatnonzero(needed))
    beta, stderr = np.zeros(len(needed)), np.zeros(len(needed))
    if own.k == 0:
        return beta, stderr
    if (np.abs(own.R.diagonal()) > REGULAR * np.linalg.norm(own.R, axis=0)).all():
        beta[needed] = lapack.dtrtrs(own.R, own.d)[0]
    else:  # a stretch alone determined something
        beta[needed] = np.linalg.lstsq(own.R, own.d, rcond=REGULAR)[0]
    if wider is not None:
        inverse, _ = lapack.dtrtri(own.R)
        stderr[needed] = np.linalg.norm(inverse, axis=1) * wider[needed]
    return beta, stderr
