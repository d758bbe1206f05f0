"""From triangles to parameters: coordinates weighted by their residual, rank found, base solved.

x = argmin Σ_u ‖A_u x − b_u‖² / σ_u²,     σ_u² = ‖A_u x − b_u‖² / rows_u        (iterated)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.errors import FitError
from ident.information.base import Base, Solution, rank_revealing, solve
from ident.information.triangle import Array, Triangle

FLOOR = 0.003  # of a joint's terms: a smaller residual weighs no more, lest rows ask for no inertia
TOLERANCE = 1e-8  # share of a column that must be new for its unknown to count as identifiable
CLEAR = 6.0  # standard errors from its prior at which an unknown is no work of noise
ITERATIONS = 12


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters with what they rest on.

    Attributes:
        solution: x, base parameters, unscaled covariance, for rows divided by sigma.
        base: which unknowns are independent.
        sigma: (d,) residual of each coordinate [N m | N].
        triangle: of all rows, each divided by its sigma.
        held: (k,) unknowns that the data know worse than is plausible, held at their prior.
    """

    solution: Solution
    base: Base
    sigma: Array
    triangle: Triangle
    held: np.ndarray

    @property
    def x(self) -> Array:
        """All unknowns (k,)."""
        return self.solution.x

    def at(self, x: Array) -> Estimate:
        """Return the same equations and base, with the unknowns at another x (k,)."""
        beta = x[self.base.independent] + self.base.K @ x[self.base.dependent]
        return replace(self, solution=replace(self.solution, x=x, beta=beta))


def term_sizes(totals: Sequence[Triangle], x: Array) -> Array:
    """Return the root of the sum of squares of all terms in each coordinate's rows (d,), at x."""
    return np.array(
        [np.linalg.norm(t.column_norms() * x) / np.sqrt(max(t.rows, 1)) for t in totals]
    )


def estimate(
    totals: Sequence[Triangle],
    prior: Array,
    torque: Array,
    plausible: Array | None = None,
    sigma: Array | None = None,
    held: np.ndarray | None = None,
) -> Estimate:
    """Solve weighted least squares over coordinates.

    The first solve weighs all coordinates alike. It shows how large the terms are that add up in
    each, and no coordinate is later trusted better than FLOOR of that: a joint that swings freely
    has next to no torque but large terms that cancel, and weighed by its small residual it would
    ask for no inertia at all.

    Args:
        totals: one triangle a coordinate, on all k columns.
        prior: (k,) values of unknowns that the data do not determine.
        torque: (d,) rms of the measured torque [N m | N].
        plausible: (k,) how far an unknown can be from its prior; what the data know worse than that
            is held at the prior. None: everything with columns of its own is estimated.
        sigma: (d,) fixed weights; else they are iterated.
        held: (k,) unknowns to be held at their prior from the start.

    Raises:
        FitError: if there are no rows.
    """
    if not sum(t.rows for t in totals):
        raise FitError("no equations: every sample is at standstill, singular or missing")
    held = np.zeros(len(prior), dtype=bool) if held is None else held
    largest = float(torque.max(initial=0.0)) or 1.0
    weights = np.full(len(totals), largest) if sigma is None else sigma
    floor = np.zeros(len(totals))
    for step in range(1 if sigma is not None else ITERATIONS):
        total = Triangle.merge([t.scaled(1 / s) for t, s in zip(totals, weights, strict=True)])
        base, solution = _solve(total, prior, held)
        if sigma is not None:
            break
        if plausible is not None:
            noise = float((_residuals(totals, solution) / weights).max())
            base, solution, held = _excited(total, base, solution, prior, plausible, noise, held)
        if step == 0:
            held = np.zeros(len(prior), dtype=bool)  # decided anew with weights that are right
            before = np.minimum(term_sizes(totals, prior), 10 * largest)
            after = term_sizes(totals, solution.x)
            floor = FLOOR * np.maximum(np.maximum(after, before), torque)
        new = np.maximum(_residuals(totals, solution), floor)
        new = np.where(new > 0, new, largest)
        converged = step > 0 and np.abs(np.log(new / weights)).max() < 1e-3
        if converged or step == ITERATIONS - 1:
            break
        weights = new
    return Estimate(solution, base, weights, total, held)


def _residuals(totals: Sequence[Triangle], solution: Solution) -> Array:
    return np.array([t.residual_norm(solution.x) / np.sqrt(max(t.rows, 1)) for t in totals])


def _solve(total: Triangle, prior: Array, held: np.ndarray) -> tuple[Base, Solution]:
    """Solve on all columns; held unknowns are at their prior and in no combination."""
    free, out = np.flatnonzero(~held), np.flatnonzero(held)
    own = total.restricted(free, prior) if len(out) else total
    base = _cleaned(rank_revealing(own, TOLERANCE), own)
    solution = solve(own, base, prior[free])
    if not len(out):
        return base, solution
    x, distance = prior.copy(), np.zeros(len(prior))
    x[free], distance[free] = solution.x, base.distance
    whole = replace(
        base,
        independent=free[base.independent],
        dependent=np.concatenate([free[base.dependent], out]),
        K=np.hstack([base.K, np.zeros((base.rank, len(out)))]),
        zero=free[base.zero],
        distance=distance,
    )
    return whole, replace(solution, x=x)


def _excited(
    total: Triangle,
    base: Base,
    solution: Solution,
    prior: Array,
    plausible: Array,
    noise: float,
    held: np.ndarray,
) -> tuple[Base, Solution, np.ndarray]:
    """Hold, one by one, what the data know worse than is plausible.

    `noise` is the residual of the rows divided by their weights: the triangle's own unit.
    """
    while base.rank:
        possible = plausible[base.independent] + np.abs(base.K) @ plausible[base.dependent]
        stderr = noise * np.sqrt(np.diag(solution.C))
        before = prior[base.independent] + base.K @ prior[base.dependent]
        # what stands out of its own error is real, whatever the prior calls plausible
        clear = np.abs(solution.beta - before) > CLEAR * stderr
        doubtful = base.independent[~clear & (stderr > possible)]
        if not len(doubtful):
            break
        # of several that are known only together, the one that is newest only by noise
        held = held.copy()
        held[doubtful[base.distance[doubtful].argmin()]] = True
        base, solution = _solve(total, prior, held)
    return base, solution, held


def _cleaned(base: Base, total: Triangle) -> Base:
    """Drop regroupings below the tolerance, as a URDF's rounded angles (1.5708) leave them."""
    norm = total.column_norms()
    share = np.abs(base.K) * norm[base.independent][:, None]
    return replace(base, K=np.where(share < TOLERANCE * norm[base.dependent], 0.0, base.K))
