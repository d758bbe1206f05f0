"""The smooth motion of one run: a quintic B-spline in the independent coordinates.

u(t) = B(t) c,    u̇ = Ḃ c,    ü = B̈ c        so that the three belong together
|U (c − ĉ)|²      what the measured channels lose where the spline is not the best one, ĉ
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from ident.solve.basis import Basis

DEGREE = 5
WIDTH = DEGREE + 1  # functions that are nonzero at a time
BRIDGE = 1e-12  # weight of smoothness, which decides only where a few samples are missing


@dataclass(frozen=True, eq=False)
class Rows:
    """Linear observations of the coefficients: Σ_r Σ_i R[·, r, i] c[first + r, i] = x.

    first: (n,); R: (n, WIDTH, d); x: (n,), all divided by the noise.
    """

    first: NDArray[np.intp]
    R: np.ndarray
    x: np.ndarray


@dataclass(frozen=True, eq=False)
class Spline:
    """One run's motion in d coordinates, and how much its channels say of it.

    Attributes:
        basis: quintic B-splines over the run.
        c: (count, d) coefficients ĉ.
        roots: U of each coordinate alone, (count, WIDTH, 1), or one of all, (count · d, WIDTH, d).
    """

    basis: Basis
    c: np.ndarray
    roots: tuple[np.ndarray, ...]

    def at(self, t: np.ndarray) -> np.ndarray:
        """u, u̇, ü (3, n, d) at times t (n,) of the run [s]."""
        return evaluated(self.basis, self.c, t)

    @property
    def first(self) -> NDArray[np.intp]:
        """(count · d,) the first function that each row of U reaches."""
        count, d = self.c.shape
        return np.minimum(np.arange(count * d) // d, count - WIDTH)

    @cached_property
    def U(self) -> np.ndarray:
        """(count · d, WIDTH, d) rows of U."""
        if len(self.roots) == 1:
            return self.roots[0]
        count, d = self.c.shape
        whole = np.zeros((count, d, WIDTH, d))
        for i, root in enumerate(self.roots):
            whole[:, i, :, i] = root[:, :, 0]
        return whole.reshape(-1, WIDTH, d)

    def leading(self, rows: int) -> np.ndarray:
        """The first rows of U (rows, WIDTH, d), a multiple of d."""
        d = self.c.shape[1]
        if len(self.roots) == 1:
            return self.roots[0][:rows]
        few = tuple(root[: rows // d] for root in self.roots)
        return Spline(self.basis, self.c[: rows // d], few).U


def basis_over(start: float, stop: float, spacing: float, origin: float | None = None) -> Basis:
    """Quintic splines over a run, with knots every `spacing` [s] or a little less.

    Or, with an `origin` [s], every `spacing` from there, so that the run may begin between two.
    """
    if origin is not None:
        first = np.floor((start - origin) / spacing + 1e-6)
        last = max(np.ceil((stop - origin) / spacing - 1e-6), first + 1)
        count = int(last - first) + DEGREE
        return Basis.with_count(origin + first * spacing, origin + last * spacing, count, DEGREE)
    intervals = max(1, int(np.ceil((stop - start) / spacing - 1e-9)))
    return Basis.with_count(start, stop, intervals + DEGREE, DEGREE)


def evaluated(basis: Basis, c: np.ndarray, t: np.ndarray) -> np.ndarray:
    """u, u̇, ü (3, n, d) of coefficients c (count, d) at times t (n,); beyond the ends, theirs."""
    return np.stack([derivative(basis, c, t, order) for order in range(3)])


def derivative(basis: Basis, c: np.ndarray, t: np.ndarray, order: int) -> np.ndarray:
    """One of them (n, d), of an order."""
    first, B = basis.window(np.clip(t, basis.t0, basis.t_end), order)
    found = np.zeros((len(t), c.shape[1]))
    for r in range(WIDTH):
        found += B[:, r, None] * c[first + r]
    return found


def solved(basis: Basis, rows: list[Rows], d: int) -> Spline:
    """The least-squares spline of observations."""
    count, band = basis.count, WIDTH * d
    normal, right = np.zeros((band, count * d)), np.zeros(count * d)
    for part in rows:
        place = part.first * d
        flat = part.R.reshape(len(place), band)
        used = np.flatnonzero(np.abs(flat).max(axis=0, initial=0.0) > 0)
        for i in used:
            right += np.bincount(place + i, flat[:, i] * part.x, count * d)
            for j in used[used >= i]:
                normal[j - i] += np.bincount(place + i, flat[:, i] * flat[:, j], count * d)
    rough = _roughness(count)
    for k in range(WIDTH):
        normal[k * d] += BRIDGE * normal[0].max() * np.repeat(rough[k], d)
    lower = cholesky_banded(normal, lower=True, check_finite=False)
    c = cho_solve_banded((lower, True), right, check_finite=False).reshape(count, d)
    row = np.arange(count * d)
    first = np.minimum(row // d, count - WIDTH)
    U = np.zeros((count * d, band))
    column = row - first * d
    for k in range(band):  # lower[k, a] = L[a + k, a] = U[a, a + k]
        inside = column + k < band
        U[row[inside], (column + k)[inside]] = lower[k, inside]
    return Spline(basis, c, (U.reshape(-1, WIDTH, d),))


def _roughness(count: int) -> np.ndarray:
    """Lower bands of DᵀD, D the third differences of the coefficients: what fills a few missing."""
    D = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((WIDTH, count))
    for k in range(len(D)):
        for i in range(len(D) - k):
            bands[k, i : count - len(D) + 1 + i] += D[i] * D[i + k]
    return bands
