"""Linear algebra: the triangular factor of equations A x = b, and drivers that do not fail.

    Qᵀ [A | b] = [R  d; 0  ρ]    so that    |A x − b|² = |R x − d|² + ρ²   for every x

Rows arrive in any order and in any pieces, and the triangles of pieces add: batch, recursive and
distributed identification are the same few lines. Source: sequential orthogonal reduction, Å.
Björck, Numerical Methods for Least Squares Problems (SIAM 1996), sect. 3.2.4 and 6.2; Q is never
formed and AᵀA never multiplied out (it would square the condition number).

Singular values, pseudo-inverses and least squares survive LAPACK's fast driver, too: that of NumPy
(divide and conquer) does not converge for rare matrices; the slower ones of SciPy (QR iterations)
do. Arguments and results are those of `numpy.linalg`, stacks of matrices included.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from ident.errors import FitError

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Columns = Index | NDArray[np.bool_] | list[int]

_PIECE = 512  # work: rows reduced at a time: the piece and the triangle stay in the cache
_PANEL = 16  # work: columns LAPACK handles as one block


@dataclass(frozen=True, eq=False)
class Triangle:
    """An immutable triangular factor of the stacked block [A | b], A (rows, k), b (rows,).

    Where columns depend on each other, rounding decides which part of the residual is in d and
    which in rho; `residual_norm` is the same, and `restricted` to independent columns is definite.
    """

    R: Array  # (k, k), upper triangular with a diagonal ≥ 0, so that equal data give an equal R
    d: Array  # (k,), the right-hand side that some x attains
    rho: float  # ≥ 0, the norm of what no x attains
    rows: int  # equations absorbed

    @classmethod
    @lru_cache(maxsize=256)  # many blocks have no rows at standstill
    def empty(cls, k: int) -> Triangle:
        """Return the triangle of no equations in `k` unknowns."""
        return cls._of_square(np.zeros((k + 1, k + 1)), 0)

    @classmethod
    def of(cls, A: ArrayLike, b: ArrayLike) -> Triangle:
        """Return the triangle of A (rows, k), b (rows,); FitError if a number is not finite."""
        A = np.asarray(A, dtype=float)
        return cls._absorbed(np.zeros((A.shape[1] + 1,) * 2, order="F"), 0, A, b)

    @classmethod
    def merge(cls, triangles: Iterable[Triangle]) -> Triangle:
        """Return the triangle of all equations together; they must have the same unknowns."""
        first, *others = triangles = list(triangles)
        stack = np.concatenate([np.zeros((0, first.k + 1)), *(item.stack() for item in others)])
        stack = stack[stack.any(axis=1)]  # rows of zeros hold no information
        merged = first.updated(stack[:, :-1], stack[:, -1]) if len(stack) else first
        return replace(merged, rows=sum(item.rows for item in triangles))

    @property
    def k(self) -> int:
        """Number of unknowns."""
        return self.R.shape[1]

    def updated(self, A: ArrayLike, b: ArrayLike) -> Triangle:
        """Return the triangle with further equations A (rows, k), b (rows,), in 2 rows (k+1)² flops
        and a few hundred rows of memory.
        """
        return self._absorbed(np.asfortranarray(self.stack()), self.rows, A, b)

    def __add__(self, other: Triangle) -> Triangle:
        """Return the triangle of both blocks of equations."""
        return Triangle.merge((self, other))

    def scaled(self, w: float) -> Triangle:
        """Multiply every equation by `w` ≥ 0; a weight of 1/σ gives unit noise."""
        triangle = Triangle(w * self.R, w * self.d, float(w * self.rho), self.rows)
        triangle.R.flags.writeable = triangle.d.flags.writeable = False
        return triangle

    def embedded(self, columns: ArrayLike, k: int) -> Triangle:
        """Return the same equations among `k` unknowns: these are at `columns`, others zero."""
        place, stack = np.asarray(columns, dtype=int), self.stack()
        wide = np.zeros((len(stack), k + 1))
        wide[:, np.append(place, k)] = stack
        if (np.diff(place) < 0).any():
            return replace(Triangle.of(wide[:, :-1], wide[:, -1]), rows=self.rows)
        square = np.zeros((k + 1, k + 1))  # a triangle stays one
        square[np.append(place, k)] = wide
        return Triangle._of_square(square, self.rows)

    def restricted(self, columns: Columns, x_known: ArrayLike | None = None) -> Triangle:
        """Return the equations in the unknowns `columns` alone, in that order.

        The other unknowns are zero, or have their values in `x_known` (k,): d − R_known x_known.
        """
        keep, stack = np.arange(self.k)[columns], self.stack()
        if x_known is not None:
            known = np.array(x_known, dtype=float)
            known[keep] = 0.0
            stack[:-1, -1] -= self.R @ known
        return replace(Triangle.of(stack[:, keep], stack[:, -1]), rows=self.rows)

    def stack(self) -> Array:
        """Return rows [A | b] (k + 1, k + 1) that say the same as all equations: [R d; 0 ρ]."""
        k = self.k
        stack = np.zeros((k + 1, k + 1))
        stack[:k, :k], stack[:k, k], stack[k, k] = self.R, self.d, self.rho
        return stack

    def residual_norm(self, x: ArrayLike) -> float:
        """Return |A x − b| = √(|R x − d|² + ρ²) at x (k,)."""
        return float(np.hypot(np.linalg.norm(self.R @ np.asarray(x) - self.d), self.rho))

    def gradient(self, x: ArrayLike) -> Array:
        """Return Aᵀ (b − A x) = Rᵀ (d − R x), (k,): the slope of −|A x − b|²/2 at x (k,)."""
        return self.R.T @ (self.d - self.R @ np.asarray(x))

    def rhs_norm(self) -> float:
        """Return |b|."""
        return float(np.hypot(np.linalg.norm(self.d), self.rho))

    def column_norms(self) -> Array:
        """Return |A_j| of every column, (k,)."""
        return np.linalg.norm(self.R, axis=0)

    @classmethod
    def _absorbed(cls, triangle: Array, rows: int, A: ArrayLike, b: ArrayLike) -> Triangle:
        """Absorb further equations into a triangle, which is overwritten."""
        A, b, k = np.asarray(A, dtype=float), np.asarray(b, dtype=float), len(triangle) - 1
        for start in range(0, len(b), _PIECE):
            part = slice(start, start + _PIECE)
            piece = np.empty((len(b[part]), k + 1), order="F")
            piece[:, :-1], piece[:, -1] = A[part], b[part]
            triangle, *_ = lapack.dtpqrt(
                0, min(_PANEL, k + 1), triangle, piece, overwrite_a=1, overwrite_b=1
            )
        return cls._of_square(triangle, rows + len(b))

    @classmethod
    def _of_square(cls, triangle: Array, rows: int) -> Triangle:
        if not np.isfinite(triangle).all():
            raise FitError("an equation has a number that is not finite; valid: finite ones only")
        signed = triangle * np.where(triangle.diagonal() < 0, -1.0, 1.0)[:, None]
        signed += 0.0  # no −0.0
        signed.flags.writeable = False
        return cls(signed[:-1, :-1], signed[:-1, -1], float(signed[-1, -1]), rows)


NOT_FINITE = (
    "the equations hold numbers that are not finite: some value of the log or of the mechanism is "
    "absurdly large or small; look for it with ident check"
)


def svd(A: Array, full_matrices: bool = True) -> tuple[Array, Array, Array]:
    """Return U, s, Vᵀ of A (…, m, n); raises FitError if A is not finite."""
    try:
        U, s, Vt = np.linalg.svd(A, full_matrices=full_matrices)
        return U, s, Vt
    except np.linalg.LinAlgError:
        _check_finite(A)
    U, s, Vt = scipy.linalg.svd(A, full_matrices, lapack_driver="gesvd")
    return U, s, Vt


def pinv(A: Array, rcond: float = 1e-15, hermitian: bool = False) -> Array:
    """Return the pseudo-inverse of A (…, m, n); raises FitError if A is not finite."""
    try:
        return np.asarray(np.linalg.pinv(A, rcond=rcond, hermitian=hermitian))
    except np.linalg.LinAlgError:
        U, s, Vt = svd(A, full_matrices=False)
    keep = s > rcond * s.max(axis=-1, keepdims=True, initial=0.0)
    inverse = np.where(keep, 1 / np.where(keep, s, 1.0), 0.0)
    return np.asarray((Vt.swapaxes(-1, -2) * inverse[..., None, :]) @ U.swapaxes(-1, -2))


def lstsq(A: Array, b: Array, rcond: float | None = None) -> tuple[Array, int]:
    """Return x of least ‖A x − b‖, then of least ‖x‖, and the rank of A; FitError if not finite."""
    try:
        x, _, rank, _ = np.linalg.lstsq(A, b, rcond=rcond)
    except np.linalg.LinAlgError:
        _check_finite(A, b)
        small = np.finfo(float).eps * max(A.shape) if rcond is None else rcond
        x, _, rank, _ = scipy.linalg.lstsq(A, b, cond=small, lapack_driver="gelss")
    return np.asarray(x), int(rank)


def _check_finite(*arrays: Array) -> None:
    if not all(np.isfinite(item).all() for item in arrays):
        raise FitError(NOT_FINITE) from None


# --- many small products at once ----------------------------------------------------------------

UNDETERMINED = 1e-8  # numerics: of 1: a direction of the left-out block alone is not predicted


def inverse(H: Array) -> Array:
    """H⁻¹ (n, u, u) in the directions that are determined, zero in the others."""
    values, vectors = np.linalg.eigh(H)
    good = values > UNDETERMINED
    return np.asarray(
        (vectors * (good / np.where(good, values, 1.0))[:, None, :]) @ vectors.transpose(0, 2, 1)
    )
