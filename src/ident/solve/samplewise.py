"""Free multipliers: lambda has a value of its own at every sample, without a time basis.

Each sample's n equations Γ p + J^T lambda = τ are split by an orthogonal U = [range of J^T, rest]:
the rest, Z^T Γ p = Z^T τ with J Z = 0, is free of lambda: the classical null-space projection.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.errors import FitError
from ident.solve.factor import Array

_CLEAR = 1e-6  # pivots above this part of max|J| show full rank without singular values


@dataclass(frozen=True, eq=False)
class Projected:
    """Equations of p alone, A p = b, in each sample's own orthonormal directions.

    A: (N, n, k), b: (N, n): zero in the rows that lambda can always fill.
    rank: (N,) how many those are, the rank of J.
    """

    A: Array
    b: Array
    rank: NDArray[np.intp]

    @property
    def free(self) -> NDArray[np.bool_]:
        """(N, n) True where an equation is left: `Factor.of(A[free], b[free])`."""
        return np.arange(self.b.shape[1]) >= self.rank[:, None]


def eliminate_samplewise(J_T: Array, A: Array, b: Array, tol: float = 1e-9) -> Projected:
    """Project lambda out of A p + J_T lambda = b, sample by sample.

    J_T: (N, n, m), A: (N, n, k), b: (N, n). tol: singular values of J below tol max|J_T| count as
    zero, so redundant closure equations are no obstacle. Raises `FitError` for other shapes and for
    numbers that are not finite.
    """
    U, rank = _split(J_T, A.shape[:2], tol)
    if b.shape != A.shape[:2]:
        raise FitError(f"A {A.shape}, b {b.shape}; valid: (N, n, k), (N, n)")
    rows = U.swapaxes(1, 2) @ np.concatenate([A, b[..., None]], axis=2)
    rows[np.arange(rows.shape[1]) < rank[:, None]] = 0.0
    return Projected(rows[..., :-1], rows[..., -1], rank)


def multipliers_samplewise(J_T: Array, rest: Array, tol: float = 1e-9) -> Array:
    """lambda (N, m) of least norm that best makes J_T lambda = rest, rest = b - A p (N, n)."""
    if rest.shape != J_T.shape[:2]:
        raise FitError(f"J_T {J_T.shape}, rest {rest.shape}; valid: (N, n, m), (N, n)")
    U, s, Vt = np.linalg.svd(J_T, full_matrices=False)
    seen = s > tol * np.abs(J_T).max(initial=0.0)
    along = (U.swapaxes(1, 2) @ rest[..., None])[..., 0] * seen / np.where(seen, s, 1.0)
    return (Vt.swapaxes(1, 2) @ along[..., None])[..., 0]


def _split(J_T: Array, shape: tuple[int, ...], tol: float) -> tuple[Array, NDArray[np.intp]]:
    """Orthogonal U (N, n, n) of which the first rank (N,) columns span J_T."""
    if J_T.ndim != 3 or J_T.shape[:2] != shape:
        raise FitError(f"J_T {J_T.shape}; valid: {shape} and the number of multipliers")
    if not np.isfinite(J_T.sum()):
        raise FitError("a Jacobian has a number that is not finite; valid: finite ones only")
    N, n, m = J_T.shape
    scale = np.abs(J_T).max(initial=0.0)
    rank = np.full(N, m)
    if n >= m:
        U, R = np.linalg.qr(J_T, mode="complete")
        doubtful = ~(np.abs(R.diagonal(axis1=1, axis2=2)) > _CLEAR * scale).all(axis=1)
    else:
        U, doubtful = np.empty((N, n, n)), np.full(N, True)
    if doubtful.any():  # only these pay for singular values
        U[doubtful], s, _ = np.linalg.svd(J_T[doubtful])
        rank[doubtful] = (s > tol * scale).sum(axis=1)
    return U, rank
