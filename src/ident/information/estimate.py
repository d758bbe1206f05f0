"""From triangles to parameters: coordinates weighted by their residual, rank found, base solved.

x = argmin Σ_u ‖A_u x − b_u‖² / σ_u²,     σ_u² = ‖A_u x − b_u‖² / rows_u        (iterated)

Rank: columns are scanned left to right (base body to tip): one joins the base if it is independent
of it; otherwise it is a combination of the base's columns, A_D = A_I K, and its unknown is
regrouped onto theirs: A x = A_I (x_I + K x_D) = A_I beta. The base parameters beta are what the
data determine (M. Gautier and W. Khalil, IEEE Trans. Robot. Autom. 6(3), 1990). A pivoted QR would
give the same rank but an arbitrary choice of unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ident.errors import FitError
from ident.information import linear
from ident.information.lapack import lapack
from ident.information.linear import Array, Index, Triangle, merged_by_support, weighted_total

_EPS = float(np.finfo(float).eps)
ROUNDING = 1e-13  # numerics: of the largest torque: what is smaller is rounding
_NULL = 1e-12  # numerics: of its reference: what is left of a column is null below this


@dataclass(frozen=True, eq=False)
class Base:
    """The unknowns that a triangle determines."""

    independent: NDArray[np.intp]  # (n_ind,) columns of the base, ascending
    dependent: NDArray[np.intp]  # (n_dep,) the others, ascending: A_D = A_I K; K of null ones is 0
    K: Array  # (n_ind, n_dep); entries that rounding cannot tell from zero are exactly zero
    condition_number: float  # of the independent columns, each of unit norm; 1 for none
    # (k,) part of each unit column that the base's before it cannot make, in [0, 1]
    distance: Array

    @property
    def rank(self) -> int:
        """How many base parameters there are."""
        return len(self.independent)

    def combined(self, x: Array) -> Array:
        """Return the base parameters (rank,) of all unknowns (k,): x_I + K x_D."""
        return np.asarray(x[self.independent] + self.K @ x[self.dependent])


@dataclass(frozen=True, eq=False)
class Solution:
    """A least-squares solution."""

    x: Array  # (k,) all unknowns; those without an own column of information keep their prior
    beta: Array  # (n_ind,) base parameters, x_I + K x_D
    C: Array  # (n_ind, n_ind) (R_Iᵀ R_I)⁻¹: the covariance of beta for equations of unit noise


def rank_revealing(triangle: Triangle, tol: float = 1e-9) -> Base:
    """Find the independent columns of a triangle in their given order, and how the others follow.

    A column is dependent where the part of it that is new is below `tol` times its norm.
    Gram-Schmidt with reorthogonalisation on the unit columns of the small R (twice is enough:
    Giraud, Langou, Rozložník, van den Eshof, Numer. Math. 101, 2005). What is left of a column is
    also judged against the rounding error that its combination amplifies: k eps (1 + |K_j|_1).
    A column is null below 1e-12 of the largest.
    """
    k, norm = triangle.k, triangle.column_norms()
    floor = _NULL * norm.max(initial=0.0)
    null = (norm <= floor) | (norm == 0)
    unit = triangle.R / np.where(null, np.inf, norm)
    rounding = 64 * k * _EPS

    Q = np.empty((len(unit), k), order="F")  # orthonormal columns, the first `rank` of them in use
    T = np.zeros((k, k))  # inverse of the triangle Q^T unit_I, grown with it
    rank, chosen, distance, regroup = 0, np.zeros(k, bool), np.zeros(k), np.zeros((k, k))
    for j in np.flatnonzero(~null):
        rest, c = unit[:, j].copy(), np.zeros(rank)
        for _ in range(2):
            step = Q[:, :rank].T @ rest
            rest -= Q[:, :rank] @ step
            c += step
        distance[j] = np.linalg.norm(rest)
        combination = T[:rank, :rank] @ c  # of the base's unit columns so far
        noise = rounding * (1 + np.abs(combination).sum())
        if distance[j] > max(tol, noise, floor / norm[j]):
            T[:rank, rank], T[rank, rank] = -combination / distance[j], 1 / distance[j]
            Q[:, rank] = rest / distance[j]
            rank, chosen[j] = rank + 1, True
        else:
            # an error e in the column moves its combination by at most |row of T| e
            error = max(noise, distance[j]) * np.linalg.norm(T[:rank, :rank], axis=1)
            combination[np.abs(combination) <= error] = 0.0
            regroup[:rank, j] = combination

    ind, dep = np.flatnonzero(chosen), np.flatnonzero(~chosen)
    s = linear.svd(unit[:, ind], full_matrices=False)[1][:rank]
    return Base(
        independent=ind,
        dependent=dep,
        K=regroup[:rank][:, dep] * np.where(null, 0.0, norm)[dep] / norm[ind][:, None],
        condition_number=float(s[0] / s[-1]) if rank else 1.0,
        distance=distance,
    )


def solve(triangle: Triangle, base: Base, prior: ArrayLike | None = None) -> Solution:
    """Least squares on the base: beta = argmin |A_I beta - b|, x_I = beta - K x_D, x_D = prior_D.

    `prior` (k,) has the values of the dependent columns; default zeros.
    """
    ind, dep = base.independent, base.dependent
    x = np.zeros(triangle.k) if prior is None else np.array(prior, dtype=float)
    if not len(ind):
        return Solution(x=x, beta=np.zeros(0), C=np.zeros((0, 0)))
    base_triangle = triangle.restricted(ind)
    beta, _ = lapack.dtrtrs(base_triangle.R, base_triangle.d)
    inverse, _ = lapack.dtrtri(base_triangle.R)
    x[ind] = beta - base.K @ x[dep]
    return Solution(x=x, beta=beta, C=inverse @ inverse.T)


# tuned: share of a torque (rms) or a multiplier, below which nothing matters: neither an effect nor
# a residual; a joint that is trusted better would ask for no inertia
MATERIAL = 0.003
TOLERANCE = 1e-8  # numerics: share of a column that must be new for its unknown to count
CLEAR = 6.0  # level: standard errors from its prior at which an unknown is no work of noise
ITERATIONS = 12  # work


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters with what they rest on."""

    solution: Solution  # for rows divided by sigma
    base: Base
    sigma: Array  # (d,) residual of each coordinate [N m | N]
    triangle: Triangle  # of all rows, each divided by its sigma
    fixed: np.ndarray  # (k,) unknowns that the data know too badly, held at their prior
    # places of unknowns that chance alone puts beyond a limit and that are at it: they have the
    # standard errors that the data give them, and no later estimate takes them off
    at_limit: Index = field(default_factory=lambda: np.zeros(0, dtype=int))

    @property
    def x(self) -> Array:
        """All unknowns (k,)."""
        return self.solution.x

    def limited(self, places: Index, limit: ArrayLike = 0.0) -> Estimate:
        """Return least squares with unknowns (n,) at their limit beside those that are at theirs,
        with the covariance that they have without it; of those not in the base nothing changes.
        """
        inside = np.isin(places, self.base.independent)
        limits = np.broadcast_to(limit, np.shape(places))[inside]
        places = np.asarray(places, dtype=int)[inside]
        if not len(places):
            return self
        before = np.setdiff1d(self.at_limit, places)
        places, limits = np.append(places, before), np.append(limits, self.x[before])
        x, at = self.x.copy(), np.searchsorted(self.base.independent, places)
        C = self.solution.C
        x[self.base.independent] -= C[:, at] @ np.linalg.solve(
            C[np.ix_(at, at)], x[places] - limits
        )
        x[places] = limits
        return replace(self.at(x), at_limit=np.sort(places))

    def nonnegative(self, places: Index) -> Estimate:
        """Return least squares with unknowns (n,) that come out negative at zero, the farthest in
        standard errors first, as others may follow it, until none is.
        """
        estimate = self
        while len(below := estimate.negative(places)):
            estimate = estimate.limited(below[:1])
        return estimate

    def negative(self, places: Index) -> Index:
        """Return those of unknowns (n,) in the base that are negative, the farthest in standard
        errors first.
        """
        base = self.base.independent
        below = np.array([p for p in places if self.x[p] < 0 and p in base], dtype=int)
        error = np.sqrt(self.solution.C.diagonal())[np.searchsorted(base, below)]
        return below[np.argsort(self.x[below] / error)]

    def at(self, x: Array) -> Estimate:
        """Return the same equations and base, with the unknowns at another x (k,)."""
        return replace(self, solution=replace(self.solution, x=x, beta=self.base.combined(x)))


def term_sizes(totals: Sequence[Triangle], x: Array) -> Array:
    """Return the root of the sum of squares of all terms in each coordinate's rows (d,): of each
    unknown of x (k,), or of each column of x (k, terms).
    """
    sizes = (np.linalg.norm(t.column_norms() * x if x.ndim == 1 else t.R @ x) for t in totals)
    return np.array([s / np.sqrt(max(t.rows, 1)) for s, t in zip(sizes, totals, strict=True)])


def least_noise(terms: Array, torque: Array) -> Array:
    """Return the least noise (d,) by which coordinates' rows are divided, from the sizes (d,) of
    the terms that add up in each and of its torque; of one that bears nothing all is rounding.
    """
    floor = MATERIAL * np.maximum(terms, torque)
    return np.asarray(np.maximum(floor, ROUNDING * torque.max(initial=0.0)))


def estimate(
    totals: Sequence[Triangle],
    prior: Array,
    torque: Array,
    plausible: Array | None = None,
    sigma: Array | None = None,
    fixed: np.ndarray | None = None,
    weights: Array | None = None,
    known: Index | None = None,
) -> Estimate:
    """Solve weighted least squares over coordinates.

    The first solve weighs all coordinates alike. It shows how large the terms are that add up in
    each, and no coordinate is later trusted better than MATERIAL of that: a joint that swings
    freely has next to no torque but large terms that cancel, and weighed by its small residual it
    would ask for no inertia at all.

    Args:
        totals: one triangle a coordinate, on all k columns.
        prior: (k,) values of unknowns that the data do not determine.
        torque: (d,) rms of the measured torque [N m | N].
        plausible: (k,) how far an unknown can be from its prior; what the data know worse than that
            is held at the prior. None: everything with columns of its own is estimated.
        sigma: (d,) fixed weights; else they are iterated.
        fixed: (k,) unknowns to be held at their prior from the start.
        weights: (d,) as `sigma`, where what the data know too badly is still to be held.
        known: with `sigma`, the independent columns of an estimate before; of others what the data
            know worse than is plausible is held. None: nothing more is held.

    Raises:
        FitError: if there are no rows.
    """
    if not sum(t.rows for t in totals):
        raise FitError("no equations: every sample is at standstill, singular or missing")
    start = np.zeros(len(prior), dtype=bool) if fixed is None else fixed
    if sigma is not None:
        total = weighted_total(totals, sigma)
        if known is None:
            plausible, known = None, np.zeros(0, dtype=int)
        return _held_anew(total, sigma, prior, start, plausible, 1.0, known)
    largest = float(torque.max(initial=0.0)) or 1.0
    given, floor = weights, np.zeros(len(totals))
    weights = np.full(len(totals), largest) if given is None else given
    # the columns that depend on others do not depend on the weights: they are sought once
    first = _solve(weighted_total(totals, weights), prior, np.zeros(len(prior), dtype=bool))[0]
    fixed, rows = start, RowsOnBase.of(totals, first, prior)
    for step in range(ITERATIONS):
        trial = rows.solved(weights, fixed)
        noise = float((_residuals(totals, trial.x) / weights).max())
        noise = noise if given is None else max(noise, 1.0)
        while plausible is not None and len(trial.independent):
            # hold, one by one, what the data know worse than is plausible
            newest = _doubtful(trial, noise * trial.spread, prior, plausible)
            if newest is None:
                break
            fixed = fixed.copy()
            fixed[newest] = True
            trial = rows.solved(weights, fixed, trial)
        if given is not None:
            break
        if step == 0:
            fixed = np.zeros(len(prior), dtype=bool)  # decided anew with weights that are right
            before = np.minimum(term_sizes(totals, prior), 10 * largest)
            after = term_sizes(totals, trial.x)
            floor = least_noise(np.maximum(after, before), torque)
        new = np.maximum(_residuals(totals, trial.x), floor)
        new = np.where(new > 0, new, largest)
        converged = step > 0 and np.abs(np.log(new / weights)).max() < 1e-3
        if converged or step == ITERATIONS - 1:
            break
        weights = new
    total = weighted_total(totals, weights)
    return _held_anew(total, weights, prior, fixed, plausible, noise, trial.independent)


def _held_anew(
    total: Triangle,
    sigma: Array,
    prior: Array,
    fixed: np.ndarray,
    plausible: Array | None,
    noise: float,
    known: Index,
) -> Estimate:
    """Return the estimate of weighted rows, whose base is sought anew: a column of rounding may be
    independent in it that was not among those `known` before; it is held as others are.
    """
    base, solution = _solve(total, prior, fixed)
    while plausible is not None and base.rank:
        spread = noise * np.sqrt(solution.C.diagonal())
        again = Trial(
            base.independent, base.dependent, base.K, fixed, solution.beta, spread,
            base.distance[base.independent], solution.x, total.R,
        )  # fmt: skip
        new_columns = np.flatnonzero(~np.isin(base.independent, known))
        newest = _doubtful(again, spread, prior, plausible, new_columns)
        if newest is None:
            break
        fixed = fixed.copy()
        fixed[newest] = True
        base, solution = _solve(total, prior, fixed)
    return Estimate(solution, base, sigma, total, fixed)


@dataclass(frozen=True, eq=False)
class Trial:
    """A weighted solution while unknowns are held: its base, without another search for a rank."""

    independent: Index  # (n,) columns of the base, ascending
    dependent: Index  # (n_dep,) those that are neither in it nor held, ascending
    K: Array  # (n, n_dep)
    fixed: np.ndarray  # (k,)
    beta: Array  # (n,) base parameters
    spread: Array  # (n,) √ of the diagonal of (RᵀR)⁻¹
    distance: Array  # (n,) part of each unit column that the ones before it cannot make
    x: Array  # (k,) all unknowns
    triangle: Array  # (n₀ + 1, n₀ + 1) [R d; 0 ρ] in the first base


@dataclass(frozen=True, eq=False)
class RowsOnBase:
    """Rows of all coordinates in the columns of a base, which make all other columns too.

        A = A_I M,  M = [1 K] in the order of all columns         (A_I x_I + A_D x_D = A_I M x)

    Other weights and held unknowns are other triangles of A_I and other columns of M: which columns
    depend on each other stays. A held column leaves the base; of those that were made of it the
    first one takes its place (a pivot of K), if there is any.
    """

    rows: Sequence[Array]  # (m, n₀ + 1) [A_I | b], one block a coordinate
    base: Base
    M: Array  # (n₀, k)
    norm: Array  # (k,) of each column in the rows of equal weights
    prior: Array  # (k,)

    @classmethod
    def of(cls, totals: Sequence[Triangle], base: Base, prior: Array) -> RowsOnBase:
        """Take the rows of totals on a base that was found among all of their columns."""
        at = np.append(base.independent, len(prior))
        M = np.zeros((base.rank, len(prior)))
        M[:, base.independent], M[:, base.dependent] = np.eye(base.rank), base.K
        norm = np.sqrt(sum(t.column_norms() ** 2 for t in totals))
        return cls([t.stack()[:, at] for t in totals], base, M, np.asarray(norm), prior)

    def solved(self, weights: Array, fixed: np.ndarray, last: Trial | None = None) -> Trial:
        """Return the solution with weights (d,) and unknowns `held` (k,) at their prior; `last` is
        one with the same weights of which fewer are held.
        """
        if last is None:
            rows = [A / w for A, w in zip(self.rows, weights, strict=True)]
            triangle = merged_by_support(rows, self.base.rank)
            last = Trial(
                self.base.independent, self.base.dependent, self.base.K, np.zeros_like(fixed),
                np.zeros(0), np.zeros(0), self.base.distance[self.base.independent], self.prior,
                triangle,
            )  # fmt: skip
        independent, dependent, K = last.independent, last.dependent, last.K
        distance = dict(zip(independent.tolist(), last.distance, strict=True))
        for h in np.flatnonzero(fixed & ~last.fixed).tolist():
            if h in dependent:
                K, dependent = K[:, dependent != h], dependent[dependent != h]
                continue
            independent, dependent, K = self._without(h, independent, dependent, K, distance)
        return self._solution(last.triangle, independent, dependent, K, fixed)

    def _without(
        self, h: int, independent: Index, dependent: Index, K: Array, distance: dict[int, float]
    ) -> tuple[Index, Index, Array]:
        """Return the base and K without the column h: a column made of it takes its place."""
        row = int(np.searchsorted(independent, h))
        pivots = np.abs(K[row]) * self.norm[h] * distance.get(h, 1.0)
        able = np.flatnonzero(pivots > TOLERANCE * self.norm[dependent])
        if not len(able):
            return np.delete(independent, row), dependent, np.delete(K, row, axis=0)
        entering = able[0]
        share = K[row] / K[row, entering]  # of the entering column in each dependent one
        rest = np.delete(K - np.outer(K[:, entering], share), row, axis=0)
        column = int(dependent[entering])
        rest, share = np.delete(rest, entering, axis=1), np.delete(share, entering)
        size = np.delete(self.norm[dependent], entering)
        others = np.delete(independent, row)
        place = int(np.searchsorted(others, column))
        K = np.insert(rest, place, share, axis=0)
        independent, dependent = np.insert(others, place, column), np.delete(dependent, entering)
        K[np.abs(K) * self.norm[independent][:, None] < TOLERANCE * size] = 0.0
        return independent, dependent, K

    def _solution(
        self, triangle: Array, independent: Index, dependent: Index, K: Array, fixed: np.ndarray
    ) -> Trial:
        n, x = len(independent), self.prior.copy()
        R, d = (
            triangle[:-1, :-1],
            triangle[:-1, -1] - triangle[:-1, :-1] @ (self.M[:, fixed] @ x[fixed]),
        )
        same = min(n, self.base.rank)
        changed = np.flatnonzero(independent[:same] != self.base.independent[:same])
        first = int(changed[0]) if len(changed) else same
        if n < self.base.rank or first < same:  # only what follows the first change is no triangle
            columns = R @ self.M[:, independent[first:]]
            below = np.column_stack([columns[first:], d[first:]])
            if first < n:
                below = np.asarray(np.linalg.qr(below, mode="r"))
            R_new, d_new = np.zeros((n, n)), np.zeros(n)
            R_new[:first, :first], R_new[:first, first:] = R[:first, :first], columns[:first]
            R_new[first:, first:] = below[: n - first, : n - first]
            d_new[:first], d_new[first:] = d[:first], below[: n - first, n - first]
            R, d = R_new, d_new
        norm = np.linalg.norm(R, axis=0)
        beta, _ = lapack.dtrtrs(R, d) if n else (d, 0)
        inverse, _ = lapack.dtrtri(R) if n else (R, 0)
        x[independent] = beta - K @ x[dependent]
        return Trial(
            independent, dependent, K, fixed, beta, np.linalg.norm(inverse, axis=1),
            np.abs(R.diagonal()) / np.where(norm > 0, norm, 1.0), x, triangle,
        )  # fmt: skip


def _doubtful(
    trial: Trial, stderr: Array, prior: Array, plausible: Array, among: Index | slice = slice(None)
) -> int | None:
    """Return the unknown of a base that the data know worse than is plausible: of several that are
    known only together, the one that is newest only by noise; None where there is none. `among`:
    which of the base's columns may be it.
    """
    possible = plausible[trial.independent] + np.abs(trial.K) @ plausible[trial.dependent]
    # what stands out of its own error is real, whatever the prior calls plausible
    beta_prior = prior[trial.independent] + trial.K @ prior[trial.dependent]
    clear = np.abs(trial.beta - beta_prior) > CLEAR * stderr
    doubtful = np.zeros(len(possible), dtype=bool)
    doubtful[among] = (~clear & (stderr > possible))[among]
    if not doubtful.any():
        return None
    return int(trial.independent[np.where(doubtful, trial.distance, np.inf).argmin()])


def _residuals(totals: Sequence[Triangle], x: Array) -> Array:
    return np.array([t.residual_norm(x) / np.sqrt(max(t.rows, 1)) for t in totals])


def _solve(total: Triangle, prior: Array, fixed: np.ndarray) -> tuple[Base, Solution]:
    """Solve on all columns; held unknowns are at their prior and in no combination."""
    free, out = np.flatnonzero(~fixed), np.flatnonzero(fixed)
    free_triangle = total.restricted(free, prior) if len(out) else total
    base, norm = rank_revealing(free_triangle, TOLERANCE), free_triangle.column_norms()
    # regroupings below the tolerance are those of a URDF's rounded angles (1.5708)
    share = np.abs(base.K) * norm[base.independent][:, None]
    base = replace(base, K=np.where(share < TOLERANCE * norm[base.dependent], 0.0, base.K))
    solution = solve(free_triangle, base, prior[free])
    if not len(out):
        return base, solution
    x, distance = prior.copy(), np.zeros(len(prior))
    x[free], distance[free] = solution.x, base.distance
    complete = replace(
        base,
        independent=free[base.independent],
        dependent=np.concatenate([free[base.dependent], out]),
        K=np.hstack([base.K, np.zeros((base.rank, len(out)))]),
        distance=distance,
    )
    return complete, replace(solution, x=x)
