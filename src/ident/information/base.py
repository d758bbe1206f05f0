"""Which unknowns the equations determine, in an order that means something.

Columns are scanned left to right (base body to tip): one joins the base if it is independent of it;
otherwise it is a combination of the base's columns, A_D = A_I K, and its unknown is regrouped onto
theirs: A x = A_I (x_I + K x_D) = A_I beta. The base parameters beta are what the data determine
(M. Gautier and W. Khalil, IEEE Trans. Robot. Autom. 6(3), 1990). A pivoted QR would give the same
rank but an arbitrary choice of unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from ident.errors import FitError
from ident.information import linear
from ident.information.triangle import Array, Triangle

_EPS = float(np.finfo(float).eps)
_NULL = 1e-12  # of its reference magnitude: a column, or what is left of one, is null below this


@dataclass(frozen=True, eq=False)
class Base:
    """The unknowns that a triangle determines."""

    independent: NDArray[np.intp]  # (n_ind,) columns of the base, ascending
    dependent: NDArray[np.intp]  # (n_dep,) the others, ascending: A_D = A_I K
    K: Array  # (n_ind, n_dep); entries that rounding cannot tell from zero are exactly zero
    zero: NDArray[np.intp]  # columns that are null, part of `dependent`; their K is zero
    condition_number: float  # of the independent columns, each of unit norm; 1 for none
    singular_values: Array  # (n_ind,) of the same, descending
    # (k,) part of each unit column that the base's before it cannot make, in [0, 1]
    distance: Array

    @property
    def rank(self) -> int:
        """How many base parameters there are."""
        return len(self.independent)

    def __repr__(self) -> str:
        return (
            f"Base({self.rank} of {len(self.distance)} unknowns independent, {len(self.zero)} "
            f"columns null, condition number {self.condition_number:.3g})"
        )


@dataclass(frozen=True, eq=False)
class Solution:
    """A least-squares solution."""

    x: Array  # (k,) all unknowns; those without an own column of information keep their prior
    beta: Array  # (n_ind,) base parameters, x_I + K x_D
    C: Array  # (n_ind, n_ind) (R_Iᵀ R_I)⁻¹: the covariance of beta for equations of unit noise


def rank_revealing(
    triangle: Triangle, tol: ArrayLike = 1e-9, scale: ArrayLike | None = None
) -> Base:
    """Find the independent columns of a triangle in their given order, and how the others follow.

    tol: a column is dependent where the part of it that is new is below this part of its norm;
        one number, or one a column: 1 or more keeps a column out of the base.
    scale: (k,) reference magnitude of each column, in the column's unit; a column is null below
        1e-12 of it. Default: the largest column's norm, for all.

    Gram-Schmidt with reorthogonalisation on the unit columns of the small R (twice is enough:
    Giraud, Langou, Rozložník, van den Eshof, Numer. Math. 101, 2005). What is left of a column is
    also judged against the rounding error that its combination amplifies: k eps (1 + |K_j|_1).
    Raises `FitError` for a `scale` of another shape.
    """
    k, norm = triangle.k, triangle.column_norms()
    floor = _NULL * (
        np.broadcast_to(norm.max(initial=0.0), k) if scale is None else np.asarray(scale)
    )
    if floor.shape != (k,):
        raise FitError(f"scale has shape {floor.shape}; valid: ({k},)")
    null = (norm <= floor) | (norm == 0)
    tols = np.broadcast_to(np.asarray(tol, dtype=float), k)
    unit = triangle.R / np.where(null, np.inf, norm)
    rounding = 64 * k * _EPS

    Q = np.empty((k, k), order="F")  # orthonormal columns, the first `rank` of them in use
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
        if distance[j] > max(tols[j], noise, floor[j] / norm[j]):
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
        zero=np.flatnonzero(null),
        condition_number=float(s[0] / s[-1]) if rank else 1.0,
        singular_values=s,
        distance=distance,
    )


def solve(triangle: Triangle, base: Base, prior: ArrayLike | None = None) -> Solution:
    """Least squares on the base: beta = argmin |A_I beta - b|, x_I = beta - K x_D, x_D = prior_D.

    prior: (k,) with the values of the dependent columns; default zeros.
    Raises `FitError` for a prior of another shape, or a base of another triangle.
    """
    ind, dep = base.independent, base.dependent
    x = np.zeros(triangle.k) if prior is None else np.array(prior, dtype=float)
    if x.shape != (triangle.k,) or len(ind) + len(dep) != triangle.k:
        raise FitError(
            f"prior {x.shape}, base of {len(ind) + len(dep)} columns; valid: {triangle.k} of each"
        )
    own = triangle.restricted(ind)
    if not len(ind):
        return Solution(x=x, beta=np.zeros(0), C=np.zeros((0, 0)))
    if not own.R.diagonal().all():
        raise FitError(
            "the base does not belong to this triangle: one of its columns depends on others"
        )
    beta, _ = lapack.dtrtrs(own.R, own.d)
    inverse, _ = lapack.dtrtri(own.R)
    x[ind] = beta - base.K @ x[dep]
    return Solution(x=x, beta=beta, C=inverse @ inverse.T)
