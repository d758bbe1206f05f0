"""Rows of banded equations reduced in batches: many small orthogonal reductions in one call.

Basis functions of time are grouped into knots, wide enough for a row to touch two neighbouring
knots only: the band becomes block-bidiagonal whatever the degree or the filter. The rows of each
interval of knots are reduced to a small block; `band` then eliminates the knots.

A direction of the unknowns that no equation weighs (a redundant closure, a gap) shows up as
rounding, 1e-16 instead of 0. Its row must not be used: it takes the residual of the equations
along and hands it back 1e16 times larger; damping by 1e-9 would not help, 1e-16 / 1e-18 is as bad.
So weak pivots are looked at more closely, by singular values.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ident.errors import FitError
from ident.information import linear
from ident.information.triangle import Array, Index

CLOSE = 1e3  # a pivot above this many tolerances hides no singular value below one


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some rows of [A | L] [p; a] = b (paper, eq. 8), in any order, each on a short window of L.

        A p + Σ_w L[:, w] a[first + w] = b

    Attributes:
        first: (r,) the first basis function that a row touches.
        L: (r, width, m) its entries for basis functions first … first + width − 1, m multipliers
            each. width is the basis' degree + 1, or more where rows were filtered in time.
        A: (r, k); b: (r,).
    """

    first: Index
    L: Array
    A: Array
    b: Array

    def __post_init__(self) -> None:
        r = len(self.first)
        shapes = self.L.shape, self.A.shape, self.b.shape
        if [len(shape) for shape in shapes] != [3, 2, 1] or {shape[0] for shape in shapes} != {r}:
            raise FitError(f"L, A, b {shapes}; valid: ({r}, width, m), ({r}, k), ({r},)")
        if not np.isfinite([self.L.sum(), self.A.sum(), self.b.sum()]).all():
            raise FitError("an equation has a number that is not finite; valid: finite ones only")

    @classmethod
    def of_samples(cls, first: Index, values: Array, J_T: Array, A: Array, b: Array) -> Chunk:
        """Return the rows of N samples: L = Jᵀ B(t) (paper, eq. 7).

        Args:
            first, values: (N,), (N, width): the basis at the samples' times, `Basis.window`.
            J_T: (N, n, m), transposed constraint Jacobians.
            A, b: (N, n, k), (N, n).
        """
        (N, n, m), width, k = J_T.shape, values.shape[1], A.shape[2]
        L = np.tile(J_T.reshape(N * n, m), width)
        L *= values.repeat(n, axis=0).repeat(m, axis=1)
        rows = L.reshape(N * n, width, m), A.reshape(N * n, k), b.reshape(N * n)
        return cls(np.repeat(first, n), *rows)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Width, m, k."""
        return self.L.shape[1], self.L.shape[2], self.A.shape[1]


class Blocks(NamedTuple):
    """Rows X a + Y [p; −1] = 0 of some intervals, ascending, or of spans of several of them.

    a are the coefficients of the knots inside a span, then of the two at its ends.
    """

    interval: Index  # (n,)
    X: Array  # (n, c, c), c = (span + 1) group m
    Y: Array  # (n, c, k + 1), the last column is the right-hand side


class Free(NamedTuple):
    """Rows that touch no multiplier any more, of some intervals or knots, ascending."""

    place: Index  # (n,)
    Y: Array  # (n, r, k + 1)


def compress(chunk: Chunk, group: int, tol: float, span: int = 1) -> tuple[Blocks, list[Free]]:
    """Reduce a chunk's rows to blocks of `span` intervals; one with many rows has several of them.

    Rows that weigh multipliers less than `tol` are free.
    """
    width, m, k = chunk.shape
    c = (span + 1) * group * m
    number, place = np.divmod(chunk.first, group * span)
    slot, owner, height = _pack(number, c)
    rows = np.zeros((len(owner) * height, c + k + 1))
    if m:
        by_function = rows[:, :c].reshape(len(rows), -1, m)
        column = np.arange((span + 1) * group)  # the first knot's stand behind those inside
        column[: span * group] = (column[: span * group] - group) % (span * group)
        for i in range(width):
            by_function[slot, column[place + i]] = chunk.L[:, i]
    rows[slot, c:-1], rows[slot, -1] = chunk.A, chunk.b
    return _reduce(owner, rows.reshape(len(owner), height, -1), c, tol)


def unite(blocks: list[Blocks], intervals: int, tol: float) -> tuple[Array, Array, list[Free]]:
    """Return one block an interval: X (intervals, c, c), Y (intervals, c, k + 1).

    An interval without rows is zero. Intervals of several blocks (chunks met in them, or their rows
    were many) are reduced further, which frees rows.
    """
    owner, X, Y = (
        np.concatenate(parts) if len(parts) > 1 else parts[0] for parts in zip(*blocks, strict=True)
    )
    c = X.shape[-1]
    freed: list[Free] = []
    whole_X, whole_Y = np.zeros((intervals, c, c)), np.zeros((intervals, c, Y.shape[-1]))
    while len(owner) and c:
        several = (np.bincount(owner) > 1)[owner]
        single = owner[~several]
        whole_X[single], whole_Y[single] = X[~several], Y[~several]
        owner, X, Y = owner[several], X[several], Y[several]
        if len(owner):
            slot, owner, height = _pack(np.repeat(owner, c), c)
            rows = np.zeros((len(owner) * height, c + Y.shape[-1]))
            rows[slot, :c], rows[slot, c:] = X.reshape(-1, c), Y.reshape(-1, Y.shape[-1])
            rows = rows.reshape(len(owner), height, -1)
            (owner, X, Y), free = _reduce(owner, rows, c, tol)
            freed += free
    return whole_X, whole_Y, freed


def _pack(interval: Index, c: int) -> tuple[Index, Index, int]:
    """Pack rows in blocks of equal height that hold rows of one interval each.

    Returns slot (rows,) in the stacked blocks, owner (blocks,) the blocks' interval, ascending, and
    the height. It is bounded by the mean number of rows, so that one crowded interval does not pad
    all the others: memory stays linear in rows.
    """
    order = np.argsort(interval, kind="stable")
    ordered = interval[order]
    start = np.flatnonzero(np.diff(ordered, prepend=ordered[0] - 1))
    owner, rows = ordered[start], np.diff(start, append=len(ordered))
    height = min(max(int(rows.max()), c), max(4 * c, 2 * int(rows.mean())))
    blocks = -(-rows // height)
    within = np.arange(len(interval)) - np.repeat(start, rows)
    slot = np.empty_like(order)
    slot[order] = np.repeat((np.cumsum(blocks) - blocks) * height, rows) + within
    return slot, np.repeat(owner, blocks), height


def _reduce(owner: Index, rows: Array, c: int, tol: float) -> tuple[Blocks, list[Free]]:
    """Reduce stacks of rows (n, height, c + k + 1)."""
    R, Y = reflect_rows(rows, c)
    R, own = R.copy(), Y[:, :c].copy()  # the rest of the stack may go
    released, more = release(R, own, tol)
    return Blocks(owner, R, own), [Free(owner, Y[:, c:]), Free(owner[released], more)]


def reflect(X: Array, Y: Array) -> tuple[Array, Array]:
    """Reduce stacks X (n, r, c), r ≥ c, to triangles, and transform Y (n, r, k) along with them.

    Qᵀ [X Y] = [R Y_1; 0 Y_2] gives R (n, c, c) upper triangular and [Y_1; Y_2]: its first c rows
    belong to R, the others are free of the unknowns of X, and no more of them than k.
    X may be rank-deficient.
    """
    return reflect_rows(np.concatenate([X, Y], axis=-1), X.shape[-1])


def reflect_rows(rows: Array, c: int) -> tuple[Array, Array]:
    """Reduce ready rows [X Y] (n, r, c + k) as `reflect` does.

    A narrow Y is reduced by the same pass of Householder reflections, and so is Y_2, which has
    fewer rows then. For a wide one that would be work for nothing.
    """
    r, width = rows.shape[-2:]
    if not c:
        return rows[..., :0, :0], rows
    if width - c > r:
        return _block_reflector(rows[..., :c], rows[..., c:])
    packed, _ = np.linalg.qr(rows, mode="raw")
    # packedᵀ (n, r, c + k): the triangle, and the reflectors below it
    height = min(r, width)
    whole = packed[..., :height].swapaxes(-1, -2) * _upper(height, width)
    return whole[..., :c, :c], whole[..., c:]


@cache
def _upper(rows: int, columns: int) -> NDArray[np.bool_]:
    return ~np.tri(rows, columns, k=-1, dtype=bool)


def _block_reflector(X: Array, Y: Array) -> tuple[Array, Array]:
    """Return R and Qᵀ Y.

    Q = I − V U⁻¹ Vᵀ with the reflectors as columns of V, U = diag(1/τ) + the strict upper part of
    VᵀV (the UT transform: T. Joffrain et al., ACM Trans. Math. Softw. 32(2), 2006): a few matrix
    products instead of c passes over Y, and no Q.
    """
    r, c = X.shape[-2:]
    packed, tau = np.linalg.qr(X, mode="raw")  # packedᵀ (n, r, c): R, and the reflectors below it
    R = packed[..., :c].swapaxes(-1, -2) * ~np.tri(c, k=-1, dtype=bool)
    Vt = packed * ~np.tri(c, r, dtype=bool)
    diagonal = np.arange(c)
    Vt[..., diagonal, diagonal] = 1.0
    idle = tau == 0  # LAPACK found nothing to reflect: H = I
    if idle.any():
        Vt[idle], tau[idle] = 0.0, 1.0
    V = Vt.swapaxes(-1, -2)
    Ut = (Vt @ V) * np.tri(c, k=-1)
    Ut[..., diagonal, diagonal] = 1.0 / tau
    return R, Y - V @ np.linalg.solve(Ut, Vt @ Y)


def weak(R: Array, tol: float) -> NDArray[np.bool_]:
    """Return (n, c) pivots of triangles that may hide a singular value below `tol`."""
    return np.asarray(np.abs(R.diagonal(axis1=-2, axis2=-1)) <= CLOSE * tol)


def release(R: Array, Y: Array, tol: float) -> tuple[NDArray[np.bool_], Array]:
    """Free rows of [R | Y] from unknowns that they weigh less than `tol`, in place.

    Returns which of the stack had such rows, (n,), and those rows of Y, (of them, c, k), zero where
    a row still belongs to unknowns.
    """
    pivots = weak(R, tol)
    doubtful: NDArray[np.bool_] = np.any(pivots, axis=-1)
    if doubtful.any():
        doubtful = np.any(pivots & np.any(Y, axis=-1), axis=-1)
    if not doubtful.any():
        return doubtful, Y[:0]
    U, s, Vt = linear.svd(R[doubtful])
    weighed = (s > tol)[..., None]
    rows = U.swapaxes(-1, -2) @ Y[doubtful]
    R[doubtful] = np.where(weighed, s[..., None] * Vt, 0.0)
    Y[doubtful] = np.where(weighed, rows, 0.0)
    return doubtful, np.where(weighed, 0.0, rows)
