"""Linear algebra: the triangular factor of equations A x = b, and drivers that do not fail.

    Qᵀ [A | b] = [R  d; 0  ρ]    so that    |A x − b|² = |R x − d|² + ρ²   for every x

Rows arrive in any order and in any pieces, and the triangles of pieces add: batch, recursive and
distributed identification are the same few lines. A block of fewer rows than columns stays as it
is. Source: sequential orthogonal reduction, Å. Björck, Numerical Methods for Least Squares Problems
(SIAM 1996), sect. 3.2.4 and 6.2; Q is never formed and AᵀA never multiplied out (it would square
the condition number).

Singular values, pseudo-inverses and least squares survive LAPACK's fast driver, too: that of NumPy
(divide and conquer) does not converge for rare matrices; the slower ones of SciPy (QR iterations)
do. Arguments and results are those of `numpy.linalg`, stacks of matrices included.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ident.errors import FitError
from ident.information.lapack import lapack

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Columns = Index | NDArray[np.bool_] | list[int]

_PIECE = 640  # work: rows reduced at a time: the piece and the triangle stay in the cache
_PANEL = 16  # work: columns LAPACK handles as one block


@dataclass(frozen=True, eq=False)
class Triangle:
    """An immutable factor of the stacked block [A | b], A (rows, k), b (rows,): m ≤ k rows.

    It is upper triangular where the block has k rows or more; fewer stay as they are, since no
    triangle is smaller. Where columns depend on each other, rounding decides which part of the
    residual is in d and which in rho; `residual_norm` is the same, and `restricted` to independent
    columns is definite.
    """

    R: Array  # (m, k), of m = k rows upper triangular with a diagonal ≥ 0: equal data, equal R
    d: Array  # (m,), the right-hand side that some x attains
    rho: float  # ≥ 0, the norm of what no x attains
    rows: int  # equations absorbed

    @classmethod
    @lru_cache(maxsize=256)  # many blocks have no rows at standstill
    def empty(cls, k: int) -> Triangle:
        """Return the triangle of no equations in `k` unknowns."""
        return cls._of_rows(np.zeros((0, k + 1)), 0)

    @classmethod
    def of(cls, A: ArrayLike, b: ArrayLike) -> Triangle:
        """Return the triangle of A (rows, k), b (rows,); FitError if a number is not finite."""
        A = np.asarray(A, dtype=float)
        rows, k = A.shape
        if rows < k:
            return cls._of_rows(np.column_stack([A, np.asarray(b, dtype=float)]), rows)
        return cls._absorbed(np.zeros((k + 1, k + 1), order="F"), 0, A, b)

    @classmethod
    def of_columns(cls, columns: Array) -> Triangle:
        """Return the triangle of [A | b]ᵀ (k + 1, rows), which is overwritten."""
        k, rows = len(columns) - 1, columns.shape[1]
        if k <= rows <= _PIECE:
            triangle, *_ = lapack.dtpqrt(
                0, min(_PANEL, k + 1), np.zeros((k + 1, k + 1), order="F"), columns.T,
                overwrite_a=1, overwrite_b=1,
            )  # fmt: skip
            return cls._signed(triangle, rows)
        return cls.of(columns[:-1].T, columns[-1])

    @classmethod
    def merge(cls, triangles: Iterable[Triangle]) -> Triangle:
        """Return the triangle of all equations together; they must have the same unknowns."""
        triangles = list(triangles)
        if len(triangles) == 1:
            return triangles[0]
        filled = [item for item in triangles if len(item.R) or item.rho]
        if len(filled) < 2:  # of most blocks there are no rows at standstill
            one, rows = (filled or triangles)[0], sum(item.rows for item in triangles)
            return cls(one.R, one.d, one.rho, rows)
        at = next((i for i, item in enumerate(triangles) if item.is_square), -1)
        others = [*triangles[:at], *triangles[at + 1 :]] if at >= 0 else triangles
        stack = np.concatenate([item.stack() for item in others])
        stack = stack[stack.any(axis=1)]  # rows of zeros hold no information
        A, b = stack[:, :-1], stack[:, -1]
        merged = triangles[at].updated(A, b) if at >= 0 and len(b) else triangles[at]
        if at < 0:
            merged = cls.of(A, b)
        return replace(merged, rows=sum(item.rows for item in triangles))

    @property
    def k(self) -> int:
        """Number of unknowns."""
        return self.R.shape[1]

    @property
    def is_square(self) -> bool:
        """Whether R is a triangle, and not fewer rows."""
        return len(self.R) == self.k

    def updated(self, A: ArrayLike, b: ArrayLike) -> Triangle:
        """Return the triangle with further equations A (rows, k), b (rows,), in 2 rows (k+1)² flops
        and a few hundred rows of memory.
        """
        if self.is_square:
            return self._absorbed(np.asfortranarray(self.stack()), self.rows, A, b)
        more = np.column_stack([np.asarray(A, dtype=float), np.asarray(b, dtype=float)])
        stack = np.concatenate([self.stack(), more])
        return replace(self.of(stack[:, :-1], stack[:, -1]), rows=self.rows + len(more))

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
        if len(place) == k and (np.diff(place) > 0).all():
            return self
        wide = np.zeros((len(stack), k + 1))
        wide[:, np.append(place, k)] = stack
        return replace(Triangle.of(wide[:, :-1], wide[:, -1]), rows=self.rows)

    def restricted(self, columns: Columns, x_known: ArrayLike | None = None) -> Triangle:
        """Return the equations in the unknowns `columns` alone, in that order.

        The other unknowns are zero, or have their values in `x_known` (k,): d − R_known x_known.
        """
        keep, stack = np.arange(self.k)[columns], self.stack()
        if x_known is not None:
            known = np.array(x_known, dtype=float)
            known[keep] = 0.0
            stack[: len(self.R), -1] -= self.R @ known
        return replace(Triangle.of(stack[:, keep], stack[:, -1]), rows=self.rows)

    def stack(self) -> Array:
        """Return rows [A | b] that say the same as all equations: [R d; 0 ρ], without the last one
        where R has fewer rows than columns and ρ is zero.
        """
        m, k = self.R.shape
        stack = np.zeros((m + 1 if m == k or self.rho else m, k + 1))
        stack[:m, :k], stack[:m, k], stack[m:, k] = self.R, self.d, self.rho
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
        return cls._signed(triangle, rows + len(b))

    @classmethod
    def _signed(cls, triangle: Array, rows: int) -> Triangle:
        """Take a triangle (k + 1, k + 1), with a diagonal ≥ 0 and without −0.0."""
        signed = triangle * np.where(triangle.diagonal() < 0, -1.0, 1.0)[:, None]
        signed += 0.0
        return cls._of_rows(signed, rows)

    @classmethod
    def of_square(cls, triangle: Array, rows: int) -> Triangle:
        """Take a triangle [R d; 0 ρ] (k + 1, k + 1) of so many rows."""
        return cls._of_rows(triangle, rows)

    @classmethod
    def _of_rows(cls, stack: Array, rows: int) -> Triangle:
        """Take rows [A | b], fewer than columns, or a triangle [R d; 0 ρ], which is not copied."""
        if not np.isfinite(stack).all():
            raise FitError("an equation has a number that is not finite; valid: finite ones only")
        stack.flags.writeable = False
        k = stack.shape[1] - 1
        rho = float(stack[k, k]) if len(stack) > k else 0.0
        return cls(stack[:k, :k], stack[:k, k], rho, rows)


def merged_by_support(blocks: Sequence[Array], k: int) -> Array:
    """Return the triangle (k + 1, k + 1) of rows [A | b] of several blocks (m, k + 1), those with
    the fewest columns that are not zero first: of a chain of joints a third of the work.
    """
    triangle, present = np.zeros((1, 1), order="F"), np.zeros(0, dtype=int)
    pairs = [(np.flatnonzero(rows[:, :k].any(axis=0)), rows) for rows in blocks if len(rows)]
    for support, rows in sorted(pairs, key=lambda pair: len(pair[0])):
        union = np.union1d(present, support)
        if len(union) > len(present):  # a triangle stays one
            at = np.append(np.searchsorted(union, present), len(union))
            wider = np.zeros((len(union) + 1,) * 2, order="F")
            wider[np.ix_(at, at)] = triangle
            triangle, present = wider, union
        for start in range(0, len(rows), _PIECE):
            piece = np.asfortranarray(rows[start : start + _PIECE][:, np.append(present, k)])
            triangle, *_ = lapack.dtpqrt(
                0, min(_PANEL, len(triangle)), triangle, piece, overwrite_a=1, overwrite_b=1
            )
    square, at = np.zeros((k + 1, k + 1)), np.append(present, k)
    square[np.ix_(at, at)] = triangle * np.where(triangle.diagonal() < 0, -1.0, 1.0)[:, None]
    return square + 0.0


def weighted_total(totals: Sequence[Triangle], sigma: Array) -> Triangle:
    """Return the triangle of all coordinates' rows, each divided by its coordinate's sigma."""
    rows = [t.stack() / s for t, s in zip(totals, sigma, strict=True)]
    k, count = totals[0].k, sum(t.rows for t in totals)
    if sum(map(len, rows)) < k:
        return Triangle.merge(t.scaled(1 / s) for t, s in zip(totals, sigma, strict=True))
    return Triangle.of_square(merged_by_support(rows, k), count)


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
    import scipy.linalg  # takes 0.2 s to import

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
        import scipy.linalg  # takes 0.2 s to import

        x, _, rank, _ = scipy.linalg.lstsq(A, b, cond=small, lapack_driver="gelss")
    return np.asarray(x), int(rank)


def _check_finite(*arrays: Array) -> None:
    if not all(np.isfinite(item).all() for item in arrays):
        raise FitError(NOT_FINITE) from None


# --- many small products at once ----------------------------------------------------------------

UNDETERMINED = 1e-8  # numerics: of 1: a direction of the left-out block alone is not predicted


def inverse(H: Array, least: float = UNDETERMINED) -> Array:
    """Return H⁻¹ (…, u, u) of symmetric H in the directions that are determined, whose eigenvalues
    are larger than `least`; zero in the others.
    """
    if H.shape[-1] == 1:
        good = least < H
        return np.asarray(good / np.where(good, H, 1.0))
    with suppress(np.linalg.LinAlgError):  # all are determined: a tenth of the time
        np.linalg.cholesky(H - least * np.eye(H.shape[-1]))
        return np.asarray(np.linalg.inv(H))
    if H.ndim > 3:
        return np.stack([inverse(matrices, least) for matrices in H])
    values, vectors = np.linalg.eigh(H)
    good = values > least
    scaled = vectors * (good / np.where(good, values, 1.0))[..., None, :]
    return np.asarray(scaled @ vectors.swapaxes(-1, -2))


def nonnegative(A: Array, b: Array) -> Array:
    """Return x ≥ 0 of least |A x − b|, for a few unknowns; FitError if it does not end."""

    def solve(free: Array) -> Array:
        return lstsq(A[:, free], b)[0]

    return _active_set(A.T @ b, lambda x: A.T @ (b - A @ x), solve)


def nonnegative_least(H: Array, g: Array, start: np.ndarray | None = None) -> Array:
    """Return x ≥ 0 of least ½ xᵀ H x − gᵀ x, H positive definite, for a few unknowns; `start` (n,)
    says which are perhaps above 0. FitError if it does not end.
    """

    def solve(free: Array) -> Array:
        _, x, failed = lapack.dposv(H[free][:, free], g[free])
        return np.asarray(x) if not failed else lstsq(H[free][:, free], g[free])[0]

    return _active_set(g, lambda x: g - H @ x, solve, start)


def _active_set(
    g: Array, slope_at: Callable[[Array], Array], solve: Callable[[Array], Array],
    start: np.ndarray | None = None,
) -> Array:  # fmt: skip
    """Return x ≥ 0 at which no slope of a zero is above 0 and others are zero.

    Source: C. Lawson, R. Hanson, Solving Least Squares Problems, 1974, ch. 23. As
    `scipy.optimize.nnls`, whose package takes 0.3 s to import.

    Args:
        g: (n,) slopes at zero, downhill; slope_at: these at x.
        solve: unknowns of some places, with zero at the others; start: places to begin with.
    """
    n = len(g)
    x, free, blocked = np.zeros(n), np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    if start is not None and start.any() and ((s := solve(start)) > 0).all():
        free[start], x[start] = True, s
    least = 1e-12 * max(float(np.abs(g).max(initial=0.0)), 1e-300)
    for _ in range(10 * (n + 1)):
        slope = np.where(free | blocked, -np.inf, slope_at(x))
        if not n or slope.max() <= least:
            return x
        entering, before = int(slope.argmax()), x
        free[entering] = True
        while free.any():
            s = np.zeros(n)
            s[free] = solve(free)
            negative = free & (s <= 0)
            if not negative.any():
                x = s
                break
            back = x[negative] - s[negative]  # ≥ 0; zero where a number has just entered as zero
            share = np.where(back > 0, x[negative] / np.where(back > 0, back, 1.0), 0.0).min()
            x = x + share * (s - x)
            free &= ~(negative & (x <= 1e-15 * np.abs(x).max(initial=0.0)))
            x[~free] = 0.0
        # one that leaves at once is as good as zero, until another one changes
        blocked = blocked.copy() if np.array_equal(x, before) else np.zeros(n, dtype=bool)
        blocked[entering] = not free[entering]
    raise FitError("least squares with x ≥ 0 found no end; look for absurd values with ident check")
