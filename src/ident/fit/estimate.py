"""From cells to parameters: joints weighted by their residual, rank revealed, base solved.

x = argmin Σ_u ‖A_u x − b_u‖² / σ_u²,     σ_u² = ‖A_u x − b_u‖² / rows_u        (iterated)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.errors import FitError
from ident.fit.accumulate import Cell
from ident.solve.factor import Factor
from ident.solve.rank import Base, Solution, reveal, solve

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
        factor: of all rows, each divided by its sigma.
        held: (k,) unknowns that the data know worse than is plausible, held at their prior.
    """

    solution: Solution
    base: Base
    sigma: np.ndarray
    factor: Factor
    held: np.ndarray

    def at(self, x: np.ndarray) -> Estimate:
        """The same equations and base, with the unknowns at another x (k,)."""
        beta = x[self.base.independent] + self.base.K @ x[self.base.dependent]
        return replace(self, solution=replace(self.solution, x=x, beta=beta))


def totals(cells: Iterable[Cell], k: int, d: int) -> list[Factor]:
    """One factor a coordinate over all given cells, on all k columns."""
    found = []
    cells = list(cells)
    for u in range(d):
        mine = [cell for cell in cells if cell.coordinate == u]
        if not mine:
            found.append(Factor.empty(k))
            continue
        merged = Factor.merge([cell.factor for cell in mine])
        found.append(merged.embedded(mine[0].support, k))
    return found


def sizes(factors: Sequence[Factor], x: np.ndarray) -> np.ndarray:
    """(d,) root of the sum of squares of all terms in each coordinate's rows at x [N m | N]."""
    return np.array(
        [np.linalg.norm(f.column_norms() * x) / np.sqrt(max(f.rows, 1)) for f in factors]
    )


def estimate(
    factors: Sequence[Factor],
    prior: np.ndarray,
    torque: np.ndarray,
    plausible: np.ndarray | None = None,
    sigma: np.ndarray | None = None,
    held: np.ndarray | None = None,
) -> Estimate:
    """Weighted least squares over coordinates.

    The first solve weighs all coordinates alike. It tells how large the terms are that add up in
    each, and no coordinate is later trusted better than FLOOR of that: a joint that swings freely
    has next to no torque but large terms that cancel, and weighed by its small residual it would
    ask for no inertia at all.

    Args:
        factors: one a coordinate, on all k columns.
        prior: (k,) values of unknowns that the data do not determine.
        torque: (d,) rms of the measured torque [N m | N].
        plausible: (k,) how far an unknown can be from its prior; what the data know worse than that
            is held at the prior. None: everything with columns of its own is estimated.
        sigma: (d,) weights to be kept; else iterated.
        held: (k,) unknowns to be held at their prior from the start.

    Raises:
        FitError: if there are no rows.
    """
    rows = sum(factor.rows for factor in factors)
    if rows == 0:
        raise FitError("no equations: every sample is at standstill, singular or missing")
    held = np.zeros(len(prior), dtype=bool) if held is None else held
    fixed = sigma is not None
    largest = float(torque.max(initial=0.0)) or 1.0
    weights = np.full(len(factors), largest) if sigma is None else sigma
    floor = np.zeros(len(factors))
    for step in range(1 if fixed else ITERATIONS):
        total = Factor.merge([f.scaled(1 / s) for f, s in zip(factors, weights, strict=True)])
        base, solution = _solve(total, prior, held)
        if fixed:
            break
        if plausible is not None:
            noise = float((_residuals(factors, solution) / weights).max())
            base, solution, held = _excited(total, base, solution, prior, plausible, noise, held)
        if step == 0:
            held = np.zeros(len(prior), dtype=bool)  # decided anew with weights that are right
            before = np.minimum(sizes(factors, prior), 10 * largest)
            floor = FLOOR * np.maximum(np.maximum(sizes(factors, solution.x), before), torque)
        new = np.maximum(_residuals(factors, solution), floor)
        new = np.where(new > 0, new, largest)
        settled = step > 0 and np.abs(np.log(new / weights)).max() < 1e-3
        if settled or step == ITERATIONS - 1:
            break
        weights = new
    return Estimate(solution, base, weights, total, held)


def _residuals(factors: Sequence[Factor], solution: Solution) -> np.ndarray:
    return np.array([f.residual_norm(solution.x) / np.sqrt(max(f.rows, 1)) for f in factors])


def _solve(total: Factor, prior: np.ndarray, held: np.ndarray) -> tuple[Base, Solution]:
    """Base and solution on all columns; held ones are at their prior and in no combination."""
    free, out = np.flatnonzero(~held), np.flatnonzero(held)
    own = total.restricted(free, prior) if len(out) else total
    base = _cleaned(reveal(own, TOLERANCE), own)
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
    total: Factor,
    base: Base,
    solution: Solution,
    prior: np.ndarray,
    plausible: np.ndarray,
    noise: float,
    held: np.ndarray,
) -> tuple[Base, Solution, np.ndarray]:
    """Holds, one by one, what the data know worse than is plausible.

    `noise` is the residual of the rows divided by their weights: the factor's own unit.
    """
    while base.rank:
        reach = plausible[base.independent] + np.abs(base.K) @ plausible[base.dependent]
        stderr = noise * np.sqrt(np.diag(solution.C))
        before = prior[base.independent] + base.K @ prior[base.dependent]
        # what stands out of its own error is real, whatever the prior calls plausible
        clear = np.abs(solution.beta - before) > CLEAR * stderr
        doubtful = base.independent[~clear & (stderr > reach)]
        if not len(doubtful):
            break
        # of several that are known only together, the one that is newest only by noise
        held = held.copy()
        held[doubtful[base.distance[doubtful].argmin()]] = True
        base, solution = _solve(total, prior, held)
    return base, solution, held


def _cleaned(base: Base, factor: Factor) -> Base:
    """Without regroupings below the tolerance, as a URDF's rounded angles (1.5708) leave them."""
    norm = factor.column_norms()
    share = np.abs(base.K) * norm[base.independent][:, None]
    return replace(base, K=np.where(share < TOLERANCE * norm[base.dependent], 0.0, base.K))
