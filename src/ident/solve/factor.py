"""`Factor`: all that least squares needs to know of a stack of equations A x = b, in a triangle.

    Q^T [A | b] = [R  d; 0  rho]    so that    |A x - b|² = |R x - d|² + rho²   for every x

Rows arrive in any order and in any pieces, and the factors of pieces merge: batch, recursive and
distributed identification are the same few lines. Source: sequential orthogonal reduction, Å.
Björck, Numerical Methods for Least Squares Problems (SIAM 1996), sect. 3.2.4 and 6.2; Q is never
formed and A^T A never multiplied out (it would square the condition number).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from ident.errors import FitError

Array = NDArray[np.float64]

_PIECE = 512  # rows reduced at a time: the piece and the triangle stay in the cache
_PANEL = 16  # columns LAPACK handles as one block


@dataclass(frozen=True, eq=False)
class Factor:
    """An immutable triangular factor of the stacked block [A | b], A (rows, k), b (rows,).

    R: (k, k), upper triangular with a diagonal >= 0, so that equal data give an equal R.
    d: (k,), the right-hand side that some x can reach.
    rho: >= 0, the norm of what no x can reach.
    rows: number of equations absorbed (it feeds the degrees of freedom, rows - rank).

    Where columns depend on each other rounding decides which part of the residual is held by d and
    which by rho; `residual_norm` does not mind, and `restricted` to independent columns settles it.
    """

    R: Array
    d: Array
    rho: float
    rows: int

    @classmethod
    def empty(cls, k: int) -> Factor:
        """The factor of no equations in `k` unknowns."""
        return cls._of_triangle(np.zeros((k + 1, k + 1), order="F"), 0)

    @classmethod
    def of(cls, A: ArrayLike, b: ArrayLike) -> Factor:
        """The factor of A (rows, k), b (rows,).

        Raises `FitError` where the shapes do not fit or a number is not finite.
        """
        A = np.asarray(A, dtype=float)
        if A.ndim != 2:
            raise FitError(f"A has shape {A.shape}; valid: two dimensions, (rows, unknowns)")
        return cls._absorbed(np.zeros((A.shape[1] + 1,) * 2, order="F"), 0, A, b)

    @classmethod
    def merge(cls, factors: Iterable[Factor]) -> Factor:
        """The factor of all the factors' equations together; they must have the same unknowns."""
        factors = list(factors)
        if not factors:
            raise FitError("nothing to merge; valid: one factor or more")
        if len({factor.k for factor in factors}) > 1:
            raise FitError(f"factors of {[f.k for f in factors]} unknowns; valid: all the same")
        if len(factors) == 1:
            return factors[0]
        first, *others = (factor._triangle() for factor in factors)
        stack = np.concatenate([rows[rows.any(axis=1)] for rows in others])  # zeros say nothing
        merged = cls._absorbed(np.asfortranarray(first), 0, stack[:, :-1], stack[:, -1])
        return replace(merged, rows=sum(factor.rows for factor in factors))

    @property
    def k(self) -> int:
        """Number of unknowns."""
        return len(self.d)

    def updated(self, A: ArrayLike, b: ArrayLike) -> Factor:
        """The factor with the further equations A (rows, k), b (rows,); this one stays as it is.

        Time is 2 rows (k+1)² flops, memory beyond A and b a few hundred rows. Raises `FitError`
        where the shapes do not fit or a number is not finite.
        """
        return self._absorbed(np.asfortranarray(self._triangle()), self.rows, A, b)

    @classmethod
    def _absorbed(cls, triangle: Array, rows: int, A: ArrayLike, b: ArrayLike) -> Factor:
        """The factor of a triangle, which is overwritten, with further equations."""
        A, b, k = np.asarray(A, dtype=float), np.asarray(b, dtype=float), len(triangle) - 1
        if A.ndim != 2 or A.shape[1] != k or b.shape != A.shape[:1]:
            raise FitError(f"A {A.shape} and b {b.shape}; valid: (rows, {k}) and (rows,)")
        for start in range(0, len(b), _PIECE):
            part = slice(start, start + _PIECE)
            piece = np.empty((len(b[part]), k + 1), order="F")
            piece[:, :-1], piece[:, -1] = A[part], b[part]
            triangle, *_ = lapack.dtpqrt(
                0, min(_PANEL, k + 1), triangle, piece, overwrite_a=1, overwrite_b=1
            )
        return cls._of_triangle(triangle, rows + len(b))

    def __add__(self, other: Factor) -> Factor:
        """The factor of both blocks of equations."""
        return Factor.merge((self, other))

    def scaled(self, w: float) -> Factor:
        """Every equation times the weight `w` >= 0; a weight of 1/sigma gives unit noise."""
        if not (np.isfinite(w) and w >= 0):
            raise FitError(f"weight {w}; valid: finite and not negative")
        return Factor(_frozen(w * self.R), _frozen(w * self.d), float(w * self.rho), self.rows)

    def embedded(self, columns: ArrayLike, k: int) -> Factor:
        """The same equations among `k` unknowns: mine are those at `columns`, the rest is zeros."""
        place = _indices(columns, k)
        if len(place) != self.k:
            raise FitError(f"{len(place)} columns for {self.k} unknowns; valid: one for each")
        place = np.append(place, k)
        if (np.diff(place) > 0).all():  # in the same order a triangle stays one
            triangle = np.zeros((k + 1, k + 1))
            triangle[np.ix_(place, place)] = self._triangle()
            return Factor._of_triangle(triangle, self.rows)
        wide = np.zeros((self.k + 1, k + 1))
        wide[:, place] = self._triangle()
        return Factor._of_rows(wide, self.rows)

    def restricted(self, columns: ArrayLike, x_known: ArrayLike | None = None) -> Factor:
        """The equations in the unknowns `columns` alone, in that order.

        The other unknowns are zero or, where `x_known` (k,) is given, have their values in it and
        move to the right-hand side, d - R_known x_known; its entries at `columns` are ignored.
        """
        keep = _indices(columns, self.k)
        triangle = self._triangle()
        if x_known is not None:
            known = np.array(x_known, dtype=float)
            if known.shape != self.d.shape:
                raise FitError(f"x_known has shape {known.shape}; valid: {self.d.shape}")
            known[keep] = 0.0
            triangle[:-1, -1] -= self.R @ known
        return Factor._of_rows(triangle[:, np.append(keep, self.k)], self.rows)

    def residual_norm(self, x: ArrayLike) -> float:
        """|A x - b| = sqrt(|R x - d|² + rho²) at x (k,)."""
        return float(np.hypot(np.linalg.norm(self.R @ np.asarray(x) - self.d), self.rho))

    def gradient(self, x: ArrayLike) -> Array:
        """A^T (b - A x) = R^T (d - R x), (k,): the slope of -|A x - b|²/2 at x (k,)."""
        return self.R.T @ (self.d - self.R @ np.asarray(x))

    def rhs_norm(self) -> float:
        """|b|."""
        return float(np.hypot(np.linalg.norm(self.d), self.rho))

    def column_norms(self) -> Array:
        """|A_j| of every column, (k,)."""
        return np.linalg.norm(self.R, axis=0)

    def __repr__(self) -> str:
        return f"Factor({self.rows} equations, {self.k} unknowns, rho={self.rho:.6g})"

    def _triangle(self) -> Array:
        k = self.k
        triangle = np.zeros((k + 1, k + 1))
        triangle[:k, :k], triangle[:k, k], triangle[k, k] = self.R, self.d, self.rho
        return triangle

    @classmethod
    def _of_rows(cls, stack: Array, rows: int) -> Factor:
        """The factor of ready rows [A | b], counted as `rows`."""
        factor = cls.empty(stack.shape[1] - 1).updated(stack[:, :-1], stack[:, -1])
        return replace(factor, rows=rows)

    @classmethod
    def _of_triangle(cls, triangle: Array, rows: int) -> Factor:
        if not np.isfinite(triangle).all():
            raise FitError("an equation has a number that is not finite; valid: finite ones only")
        signed = triangle * np.where(triangle.diagonal() < 0, -1.0, 1.0)[:, None]
        signed += 0.0  # no -0.0
        signed.flags.writeable = False
        return cls(signed[:-1, :-1], signed[:-1, -1], float(signed[-1, -1]), rows)


def _frozen(array: Array) -> Array:
    array = np.array(array)  # a copy: nobody else holds it
    array.flags.writeable = False
    return array


def _indices(columns: ArrayLike, k: int) -> NDArray[np.intp]:
    """Distinct column numbers among k, from numbers or a mask."""
    given = np.asarray(columns)
    try:
        index = np.arange(k)[given if given.size else []]
    except IndexError:
        raise FitError(f"columns {given} of {k}; valid: 0 to {k - 1}") from None
    if len(np.unique(index)) < len(index):
        raise FitError(f"columns {given} are not distinct; valid: each at most once")
    return index
