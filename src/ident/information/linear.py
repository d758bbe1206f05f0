"""Singular values, pseudo-inverses and least squares that survive LAPACK's fast driver.

That of NumPy (divide and conquer) does not converge for rare matrices; the slower ones of SciPy (QR
iterations) do. Arguments and results are those of `numpy.linalg`, stacks of matrices included.
"""

from __future__ import annotations

import numpy as np

from ident.errors import FitError
from ident.information.triangle import Array

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
        from scipy.linalg import svd as slower  # takes 0.1 s to import

    _check_finite(A)
    every = [
        slower(each, full_matrices, lapack_driver="gesvd") for each in A.reshape(-1, *A.shape[-2:])
    ]
    U, s, Vt = (
        np.reshape(part, (*A.shape[:-2], *part[0].shape)) for part in zip(*every, strict=True)
    )
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
    """Return x of least ‖A x − b‖, then of least ‖x‖, and the rank of A.

    Raises FitError if A or b is not finite.
    """
    try:
        x, _, rank, _ = np.linalg.lstsq(A, b, rcond=rcond)
    except np.linalg.LinAlgError:
        from scipy.linalg import lstsq as slower

        _check_finite(A, b)
        small = np.finfo(float).eps * max(A.shape) if rcond is None else rcond
        x, _, rank, _ = slower(A, b, cond=small, lapack_driver="gelss")
    return np.asarray(x), int(rank)


def _check_finite(*arrays: Array) -> None:
    if not all(np.isfinite(each).all() for each in arrays):
        raise FitError(NOT_FINITE) from None


# --- many small products at once ----------------------------------------------------------------

UNDETERMINED = 1e-8  # of 1: a direction that only the left-out block excites is not predicted in it


def inner(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """aᵀb (n, u, u) of columns (m, n, u) of n groups."""
    if a.shape[2] == 1:
        return np.einsum("mn,mn->n", a[:, :, 0], b[:, :, 0])[:, None, None]
    return a.transpose(1, 2, 0) @ b.transpose(1, 0, 2)


def turned(V: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Vᵀc (blocks, n, u, R)."""
    return c * V[:, :, :1] if c.shape[2] == 1 else V.transpose(0, 2, 1) @ c


def times(H: np.ndarray, x: np.ndarray) -> np.ndarray:
    """H x (n, u, R)."""
    return H * x if H.shape[1] == 1 else (H @ x)


def inverse(H: Array) -> Array:
    """H⁻¹ (n, u, u) in the directions that are determined, zero in the others."""
    values, vectors = np.linalg.eigh(H)
    good = values > UNDETERMINED
    return np.asarray(
        (vectors * (good / np.where(good, values, 1.0))[:, None, :]) @ vectors.transpose(0, 2, 1)
    )
