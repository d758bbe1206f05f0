"""Many small orthogonal reductions in one call: where `eliminate` spends its time.

A direction of the unknowns that no equation weighs (a redundant closure, a gap) shows up as
rounding, 1e-16 instead of 0. Its row must not be used: it takes the residual of the equations
along and hands it back 1e16 times larger; damping by 1e-9 would not help, 1e-16 / 1e-18 is as bad.
So weak pivots are looked at more closely, by singular values.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from ident.solve.factor import Array

_CLOSE = 1e3  # a pivot above this many tolerances hides no singular value below one


def reflect(X: Array, Y: Array) -> tuple[Array, Array]:
    """Reduce stacks X (n, r, c), r >= c, to triangles, and take Y (n, r, k) along.

    Q^T [X Y] = [R Y_1; 0 Y_2] gives R (n, c, c) upper triangular and [Y_1; Y_2]: its first c rows
    belong to R, the others are free of the unknowns of X, and no more of them than k.
    X may be rank-deficient.
    """
    return reflect_rows(np.concatenate([X, Y], axis=-1), X.shape[-1])


def reflect_rows(rows: Array, c: int) -> tuple[Array, Array]:
    """The same of ready rows [X Y] (n, r, c + k).

    A narrow Y is reduced by the same pass of Householder reflections, and so is Y_2, which has
    fewer rows then. For a wide one that would be work for nothing.
    """
    r, width = rows.shape[-2:]
    if not c:
        return rows[..., :0, :0], rows
    if width - c > r:
        return _block_reflector(rows[..., :c], rows[..., c:])
    packed, _ = np.linalg.qr(rows, mode="raw")
    # packed^T (n, r, c + k): the triangle, and the reflectors below it
    left = min(r, width)
    whole = packed[..., :left].swapaxes(-1, -2) * _upper(left, width)
    return whole[..., :c, :c], whole[..., c:]


@cache
def _upper(rows: int, columns: int) -> NDArray[np.bool_]:
    return ~np.tri(rows, columns, k=-1, dtype=bool)


def _block_reflector(X: Array, Y: Array) -> tuple[Array, Array]:
    """R and Q^T Y.

    Q = I - V U^-1 V^T with the reflectors as columns of V, U = diag(1/tau) + the strict upper part
    of V^T V (the UT transform: T. Joffrain et al., ACM Trans. Math. Softw. 32(2), 2006): a few
    matrix products instead of c passes over Y, and no Q.
    """
    r, c = X.shape[-2:]
    packed, tau = np.linalg.qr(X, mode="raw")  # packed^T (n, r, c): R, and the reflectors below it
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
    """(n, c) pivots of triangles that may hide a singular value below `tol`."""
    return np.asarray(np.abs(R.diagonal(axis1=-2, axis2=-1)) <= _CLOSE * tol)


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
    U, s, Vt = np.linalg.svd(R[doubtful])
    seen = (s > tol)[..., None]
    rows = U.swapaxes(-1, -2) @ Y[doubtful]
    R[doubtful], Y[doubtful] = np.where(seen, s[..., None] * Vt, 0.0), np.where(seen, rows, 0.0)
    return doubtful, np.where(seen, 0.0, rows)
