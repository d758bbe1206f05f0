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
OUT = 2.0  # a tolerance that no column meets
ITERATIONS = 12


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters with what they rest on.

    Attributes:
        solution: x, base parameters, unscaled covariance, for rows divided by sigma.
        base: which unknowns are independent.
        sigma: (d,) residual of each coordinate [N m | N].
        factor: of all rows, each divided by its sigma.
        tolerance: (k,) share of a column that had to be new; OUT keeps it out of the base.
        unexcited: unknowns that only noise could have told apart from others.
    """

    solution: Solution
    base: Base
    sigma: np.ndarray
    factor: Factor
    tolerance: np.ndarray
    unexcited: tuple[int, ...]


def totals(cells: Iterable[Cell], k: int, d: int, rest: bool = False) -> list[Factor]:
    """One factor a coordinate over all given cells, on all k columns."""
    found = []
    cells = list(cells)
    for u in range(d):
        mine = [cell for cell in cells if cell.coordinate == u]
        if not mine:
            found.append(Factor.empty(k))
            continue
        merged = Factor.merge([cell.rest if rest else cell.factor for cell in mine])
        found.append(merged.embedded(mine[0].support, k))
    return found


def loads(factors: Sequence[Factor], prior: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """(d,) size of the terms that add up in each coordinate's rows [N m | N].

    The root of the sum of squares of every unknown's contribution at its prior, or the measured
    torque where that is more. A joint that swings freely has next to no torque but large terms that
    cancel: to weigh its rows by that torque would let them ask for no inertia at all.
    """
    found = []
    for factor, tau in zip(factors, torque, strict=True):
        terms = np.linalg.norm(factor.column_norms() * prior) / np.sqrt(max(factor.rows, 1))
        found.append(max(float(terms), float(tau)))
    return np.array(found)


def estimate(
    factors: Sequence[Factor],
    prior: np.ndarray,
    scale: np.ndarray,
    plausible: np.ndarray | None = None,
    sigma: np.ndarray | None = None,
    tolerance: float | np.ndarray = TOLERANCE,
) -> Estimate:
    """Weighted least squares over coordinates.

    Args:
        factors: one a coordinate, on all k columns.
        prior: (k,) values of unknowns that the data do not determine.
        scale: (d,) size of each coordinate's terms, from `loads`: where weights begin [N m | N].
        plausible: (k,) how far an unknown can be from its prior; what the data know worse than that
            is left at the prior. None: everything with columns of its own is estimated.
        sigma: (d,) weights to be kept; else iterated.
        tolerance: share of a column that must be new, one number or (k,).

    Raises:
        FitError: if there are no rows.
    """
    rows = sum(factor.rows for factor in factors)
    if rows == 0:
        raise FitError("no equations: every sample is at standstill, singular or missing")
    fixed = sigma is not None
    sigma = np.where(scale > 0, scale, 1.0) if sigma is None else sigma
    tolerances = np.broadcast_to(np.asarray(tolerance, dtype=float), len(prior))
    for _ in range(1 if fixed else ITERATIONS):
        total = Factor.merge([f.scaled(1 / s) for f, s in zip(factors, sigma, strict=True)])
        found = _cleaned(reveal(total, tolerances), total)
        solution = solve(total, found, prior)
        if fixed:
            break
        left = _residuals(factors, solution)
        if plausible is not None:
            noise = float((left / sigma).max())
            noise = max(noise, 1e-300)
            found, solution, tolerances = _excited(
                total, found, solution, prior, plausible / noise, noise, tolerances
            )
            left = _residuals(factors, solution)
        new = np.maximum(left, FLOOR * np.where(scale > 0, scale, left.max() + 1e-300))
        new = np.where(new > 0, new, 1.0)
        if np.abs(np.log(new / sigma)).max() < 1e-3:
            break
        sigma = new
    out = tuple(int(i) for i in np.flatnonzero(tolerances >= OUT))
    return Estimate(solution, found, sigma, total, tolerances, out)


def _residuals(factors: Sequence[Factor], solution: Solution) -> np.ndarray:
    return np.array([f.residual_norm(solution.x) / np.sqrt(max(f.rows, 1)) for f in factors])


def _excited(
    total: Factor,
    base: Base,
    solution: Solution,
    prior: np.ndarray,
    plausible: np.ndarray,
    noise: float,
    tolerance: np.ndarray,
) -> tuple[Base, Solution, np.ndarray]:
    """Keeps out of the base, one by one, what the data know worst beside what is plausible.

    `plausible` is given in units of `noise`, the residual of rows divided by their sigma.
    """
    while base.rank:
        reach = plausible[base.independent] + np.abs(base.K) @ plausible[base.dependent]
        stderr = np.sqrt(np.diag(solution.C))
        before = prior[base.independent] + base.K @ prior[base.dependent]
        # what stands out of its own error is real, whatever the prior calls plausible
        clear = np.abs(solution.beta - before) > CLEAR * noise * stderr
        doubt = np.where(clear, 0.0, stderr / reach)
        if doubt.max() <= 1:
            break
        tolerance = tolerance.copy()
        tolerance[base.independent[doubt.argmax()]] = OUT
        base = _cleaned(reveal(total, tolerance), total)
        solution = solve(total, base, prior)
    return base, solution, tolerance


def _cleaned(base: Base, factor: Factor) -> Base:
    """Without regroupings below the tolerance, as a URDF's rounded angles (1.5708) leave them."""
    norm = factor.column_norms()
    share = np.abs(base.K) * norm[base.independent][:, None]
    return replace(base, K=np.where(share < TOLERANCE * norm[base.dependent], 0.0, base.K))
