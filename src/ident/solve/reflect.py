"""Many small Householder reductions in one call: where `eliminate` spends its time."""

from __future__ import annotations

import numpy as np

from ident.solve.factor import Array

_ROUNDING = 1e-5  # of `floor`: entries of a faint column below this are rounding, not damping


def reflect(X: Array, Y: Array, floor: float = 0.0) -> tuple[Array, Array]:
    """Reduce stacks X (n, r, c), r >= c, to triangles, and take Y (n, r, k) along.

    Q^T X = [R; 0] gives R (n, c, c) upper triangular and Q^T Y (n, r, k): its first c rows belong
    to R, the others are free of the unknowns of X. X may be rank-deficient.

    floor: columns of which less than this is new are faint, and rounding is removed from them. Where
        a faint column is damped this is vital: rounding 1e-16 beside a damping 1e-9 has a
        direction, takes the residual of the equations along it, and returns it times 1e-16 / 1e-18.

    Q = I - V U^-1 V^T with the reflectors as columns of V, U = diag(1/tau) + the strict upper part
    of V^T V (the UT transform: T. Joffrain et al., ACM Trans. Math. Softw. 32(2), 2006): a few
    matrix products instead of c passes over Y, and no Q.
    """
    r, c = X.shape[-2:]
    if not c:
        return X[..., :0, :], Y
    packed, tau = np.linalg.qr(X, mode="raw")  # packed^T (n, r, c): R, and the reflectors below it
    faint = (np.abs(packed.diagonal(axis1=1, axis2=2)) < floor).any(axis=1)
    if faint.any():
        packed[faint], tau[faint] = _cleaned(X[faint], floor)
    R = packed[..., :c].swapaxes(-1, -2) * ~np.tri(c, k=-1, dtype=bool)
    Vt = packed * ~np.tri(c, r, dtype=bool)
    diagonal = np.arange(c)
    Vt[..., diagonal, diagonal] = 1.0
    idle = tau == 0  # nothing to reflect: H = I
    if idle.any():
        Vt[idle], tau[idle] = 0.0, 1.0
    V = Vt.swapaxes(-1, -2)
    Ut = (Vt @ V) * np.tri(c, k=-1)
    Ut[..., diagonal, diagonal] = 1.0 / tau
    return R, Y - V @ np.linalg.solve(Ut, Vt @ Y)


def _cleaned(X: Array, floor: float) -> tuple[Array, Array]:
    """LAPACK's dgeqr2 for a stack, (n, c, r) and tau (n, c), with rounding cleared on the way."""
    T = X.copy()
    n, r, c = T.shape
    packed, tau = np.zeros((n, c, r)), np.zeros((n, c))
    for j in range(c):
        x = T[:, j:, j]
        norm = np.linalg.norm(x, axis=1)
        x[(np.abs(x) < _ROUNDING * floor) & (norm < floor)[:, None]] = 0.0
        norm = np.linalg.norm(x, axis=1)
        beta = -np.copysign(norm, x[:, 0])
        step = np.where(norm > 0, x[:, 0] - beta, 1.0)
        tau[:, j] = -step / np.where(norm > 0, beta, -np.inf)
        v = x / step[:, None]
        v[:, 0] = 1.0
        T[:, j:, j:] -= (tau[:, j, None] * v)[:, :, None] * (v[:, None, :] @ T[:, j:, j:])
        packed[:, j, j + 1 :] = v[:, 1:]
        packed[:, j:, j], packed[:, j, j] = T[:, j, j:], beta
    return packed, tau
