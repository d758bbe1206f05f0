"""Least squares within limits: a projection onto a convex cone's section, by Clarabel.

x = argmin ‖R x − d‖²   such that   G x + h ∈ K,      K: {0}, half-lines, semidefinite matrices

With y = R x − d the cost is ‖y‖²: every direction counts in the data's own unit, however unevenly
x is scaled, and the solver sees a problem whose Hessian is the identity. Source: P. Goulart, Y.
Chen, Clarabel: an interior-point solver for conic programs with quadratic objectives, 2024.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import clarabel
import numpy as np
from numpy.typing import NDArray

from ident.errors import FitError
from ident.information.lapack import extension, lapack
from ident.information.linear import Array, Triangle

TOLERANCE = 1e-9  # numerics
PASSES, ABOUT, HEAVIEST = 4, 1e-2, 1e24  # numerics: of the cost's weight
POSSIBLE = 1e-7  # numerics: of a limit's scale: a smaller shortfall is the solver's
SLACK = {"psd": 5e-7, "nonnegative": 1e-7, "zero": 1e-7}  # of a limit's scale: a smaller breach is
# rounding; half of the margin by which matrices are asked to be definite (`fit.consistency`)
ROOT2 = float(np.sqrt(2.0))


@dataclass(frozen=True, eq=False)
class Limit:
    """One thing that must hold: G x + h is zero, not negative, or positive semidefinite."""

    name: str  # as a person reads it, `rod.m ≥ 0.4`
    kind: Literal["zero", "nonnegative", "psd"]  # of `psd` G x + h is the `svec` of a matrix
    G: Array  # (rows, k), scaled so that 1 is a large violation
    h: Array  # (rows,)
    of: str = ""  # the parameter or the body that it speaks of, if it is one

    def value(self, x: Array) -> Array:
        """G x + h (rows,)."""
        return np.asarray(self.G @ x + self.h)

    def room(self, x: Array) -> float:
        """How far x is inside, without the solver: the least entry or eigenvalue, −|entry| of what
        must be zero, and SLACK; below zero where x breaks the limit.
        """
        value = self.value(x)
        if self.kind == "psd":
            value = np.asarray(np.linalg.eigvalsh(smat(value)))
        least = (-np.abs(value) if self.kind == "zero" else value).min(initial=np.inf)
        return float(least) + SLACK[self.kind]


@dataclass(frozen=True, eq=False)
class NearestPoint:
    """A solution x (k,), and by how much each limit pushed it, in units of y, (limits,)."""

    x: Array
    push: Array


def svec(M: Array) -> Array:
    """Upper triangle of a symmetric matrix by columns, off the diagonal √2-fold: M·N = svec·svec.

    >>> svec(np.array([[1.0, 2.0], [2.0, 3.0]])).round(3).tolist()
    [1.0, 2.828, 3.0]
    """
    j, i = np.tril_indices(len(M))  # rows of the lower triangle are columns of the upper
    return np.asarray(M[i, j] * np.where(i == j, 1.0, ROOT2))


def smat(v: Array) -> Array:
    """The symmetric matrix of which v is the `svec`."""
    n = int(np.sqrt(2 * len(v)))
    j, i = np.tril_indices(n)
    M = np.empty((n, n))
    M[i, j] = M[j, i] = v * np.where(i == j, 1.0, 1 / ROOT2)
    return M


def nearest(R: Array, d: Array, limits: Sequence[Limit]) -> NearestPoint:
    """The x within all limits that minimises ‖R x − d‖²; R (k, k) upper triangular.

    Raises:
        FitError: if the solver finds none; `shortfall` tells whether there is one.
    """
    if not R.diagonal().all():
        raise FitError("a direction is neither in the data nor in the prior")
    T, _ = lapack.dtrtri(R)
    centre = T @ d
    C = np.vstack([np.zeros((0, len(d))), *(limit.G @ T for limit in limits)])
    c = np.concatenate([np.zeros(0), *(limit.value(centre) for limit in limits)])
    size = max(float(np.abs(c).max(initial=0.0)), 1e-300)  # cones have no scale: count in this one
    weight = 1.0
    for _ in range(PASSES):  # the solver counts gaps in units of 1, so the cost must be about that
        y, z = _solved(np.full(len(d), weight), np.zeros(len(d)), C, c / size, limits)
        cost = weight * float(y @ y)
        if not 0 < cost < ABOUT:
            break
        weight = min(weight / cost, HEAVIEST)
    ends = np.cumsum([0, *(len(limit.h) for limit in limits)])
    push = [size / weight * float(np.linalg.norm(C[a:b].T @ z[a:b])) for a, b in pairwise(ends)]
    return NearestPoint(centre + T @ (size * y), np.array(push))


def shortfall(limits: Sequence[Limit], scale: Array) -> float:
    """The least t ≥ 0 by which all limits must give way, in their scale; 0 if all can hold.

    `scale` (k,) of the unknowns only keeps unlimited ones where they can be counted.
    """
    k = len(scale)
    elastic = [_elastic(limit, scale) for limit in limits]
    elastic.append(Limit("t ≥ 0", "nonnegative", np.eye(k + 1)[-1:], np.zeros(1)))
    P = np.append(np.full(k, 1e-10), 0.0)
    q = np.append(np.zeros(k), 1.0)
    C = np.vstack([limit.G for limit in elastic])
    c = np.concatenate([limit.h for limit in elastic])
    solution, _ = _solved(P, q, C, c, elastic)
    return max(float(solution[-1]), 0.0)


def conflict(limits: Sequence[Limit], scale: Array) -> list[Limit]:
    """A set of limits that cannot hold together, though without any one of them the rest can.

    Empty if all can hold. Of several such sets the one whose limits come first. Source: the
    deletion filter, J. W. Chinneck, E. W. Dravnieks, ORSA J. Comput. 3(2), 1991.
    """
    if shortfall(limits, scale) <= POSSIBLE:
        return []
    contradicting = list(limits)
    for limit in reversed(limits):
        rest = [other for other in contradicting if other is not limit]
        if shortfall(rest, scale) > POSSIBLE:
            contradicting = rest
    return contradicting


def _elastic(limit: Limit, scale: Array) -> Limit:
    """The limit on (x / scale, t) that t loosens."""
    G, h = limit.G * scale, limit.h
    if limit.kind == "psd":
        n = int(np.sqrt(2 * len(h)))
        return Limit(limit.name, "psd", np.hstack([G, svec(np.eye(n))[:, None]]), h)
    if limit.kind == "zero":  # −t ≤ G x + h ≤ t
        G, h = np.vstack([G, -G]), np.concatenate([h, -h])
    return Limit(limit.name, "nonnegative", np.hstack([G, np.ones((len(h), 1))]), h)


@dataclass(frozen=True, eq=False)
class SparseColumns:
    """A sparse matrix by columns, as Clarabel reads SciPy.s, which takes 0.15 s to import."""

    data: Array
    indices: NDArray[np.intp]  #: row of each entry
    indptr: NDArray[np.intp]  #: of each column, where its entries begin; their number
    shape: tuple[int, ...]
    has_canonical_format: bool = True  #: entries of a column in the order of their rows

    @classmethod
    def of(cls, matrix: Array) -> SparseColumns:
        """Return a dense matrix without its zeros."""
        columns, rows = np.nonzero(matrix.T)
        starts = np.searchsorted(columns, np.arange(matrix.shape[1] + 1))
        return cls(matrix[rows, columns], rows, starts, matrix.shape)


def _solved(P: Array, q: Array, C: Array, c: Array, limits: Sequence[Limit]) -> tuple[Array, Array]:
    """argmin yᵀP y/2 + qᵀy such that C y + c ∈ K, and the multipliers z of the rows; P (k,) is the
    diagonal of the matrix.
    """
    if not limits:
        return np.zeros(len(q)), np.zeros(0)
    cones = {
        "zero": clarabel.ZeroConeT,
        "nonnegative": clarabel.NonnegativeConeT,
        "psd": lambda rows: clarabel.PSDTriangleConeT(int(np.sqrt(2 * rows))),
    }
    kinds = [cones[limit.kind](len(limit.h)) for limit in limits]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = TOLERANCE
    for name in ("cython_blas", "cython_lapack"):  # where Clarabel looks for eigenvalues
        extension(name)
    solver = clarabel.DefaultSolver(
        SparseColumns.of(np.diag(P)), q, SparseColumns.of(-C), c, kinds, settings
    )
    solution = solver.solve()
    status = clarabel.SolverStatus
    usable = (status.Solved, status.AlmostSolved, status.InsufficientProgress)
    y, z = np.asarray(solution.x), np.asarray(solution.z)
    if solution.status not in usable or not np.isfinite(y).all():
        raise FitError(f"the conic solver found no solution ({solution.status})")
    return y, z


def nearest_within(
    A: Array, b: Array, limits: Sequence[Limit], W: Array, inner: Array | None
) -> NearestPoint:
    """Return argmin ‖A x − b‖² within the limits, counted in units of the metric W, and verified.

    Where the solver's x misses a limit by its own tolerance, it is moved towards a point within,
    `inner`, where it ends at worst: limits are convex.

    Raises:
        FitError: if there is no such point, naming the limits that x breaks.
    """
    unit = 1 / np.linalg.norm(W, axis=0)
    triangle = Triangle.of(A * unit, b)
    point = nearest(triangle.R, triangle.d, [replace(limit, G=limit.G * unit) for limit in limits])
    x = _touching(limits, point.x * unit)
    for share in (0.0, *(2.0 ** np.arange(-20, 1) if inner is not None else ())):
        candidate = x if inner is None else x + share * (inner - x)
        if holds(limits, candidate):
            return replace(point, x=candidate)
    broken = [limit.name for limit in limits if limit.room(x) < 0]
    raise FitError(f"no consistent fit was found: the solver's result breaks {', '.join(broken)}")


def holds(limits: Sequence[Limit], x: Array) -> bool:
    """Return whether x (k,) keeps to all limits."""
    return all(limit.room(x) >= 0 for limit in limits)


def _touching(limits: Sequence[Limit], x: Array) -> Array:
    """Return x, exactly at the bounds that it touches."""
    x = x.copy()
    for limit in limits:
        at = np.flatnonzero(limit.G[0])
        if limit.kind != "psd" and len(at) == 1 and abs(limit.value(x)[0]) < SLACK["nonnegative"]:
            x[at] = -limit.h[0] / limit.G[0, at] + 0.0  # no -0.0
    return x


def restricted(limits: Sequence[Limit], fixed: Array, free: NDArray[np.bool_]) -> list[Limit]:
    """Return the limits on some unknowns, with the others at their value in `fixed` (k,)."""
    return [replace(limit, G=limit.G[:, free], h=limit.value(fixed)) for limit in limits]
