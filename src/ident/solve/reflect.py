"""Many small Householder reductions in one call: where `eliminate` spends its time."""

from __future__ import annotations

import numpy as np

from ident.solve.factor import Array


def reflect(X: Array, Y: Array) -> tuple[Array, Array]:
    """Reduce stacks X (n, r, c), r >= c, to triangles, and take Y (n, r, k) along.

    Q^T X = [R; 0] gives R (n, c, c) upper triangular and Q^T Y (n, r, k): its first c rows belong
    to R, the others are free of the unknowns of X. X may be rank-deficient.

    Q = I - V U^-1 V^T with the reflectors as columns of V, U = diag(1/tau) + the strict upper part
    of V^T V (the UT transform: T. Joffrain et al., ACM Trans. Math. Softw. 32(2), 2006): a few
    matrix products instead of c passes over Y, and no Q.
    """
    r, c = X.shape[-2:]
    if not c:
        return X[..., :0, :], Y
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
