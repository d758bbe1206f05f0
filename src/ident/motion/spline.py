"""One smooth motion of a run of samples, fitted to all channels that were measured of it.

    min_c Σ_k |x_k − u^(k)(t_k)|² / σ_k²,     u(t) = B(t) c,    u̇ = Ḃ c,    ü = B̈ c

over the channels k = 0, 1, 2 (position, velocity, acceleration) of each joint, each weighted by its
noise; B: quintic B-splines. Time stamps may jitter and channels may have rates of their own: the
spline is fitted at the times of the samples. |U (c − ĉ)|² is the loss of another motion c. SciPy's
`make_lsq_spline` fits values alone, and returns no U.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from ident.information.chance import LOUD
from ident.information.time_bases import Basis
from ident.motion.signals import Channel

DEGREE = 5  # range
WIDTH = DEGREE + 1  # range: functions that are nonzero at a time
BRIDGE = 1e-12  # numerics: weight of smoothness, which decides only where a few samples are missing
DOUBLINGS = 12  # work
HEAVIEST = 1e6  # numerics: rows of a channel over another's, whose squares rounding can add


@dataclass(frozen=True, eq=False)
class Observations:
    """Linear observations Σ_r Σ_i R[·, r, i] c[first + r, i] = x, divided by the noise."""

    first: NDArray[np.intp]  # (n,)
    R: np.ndarray  # (n, WIDTH, d)
    x: np.ndarray  # (n,)


@dataclass(frozen=True, eq=False)
class Spline:
    """One run's motion in d coordinates, and how well its channels determine it."""

    basis: Basis  # quintic B-splines over the run
    c: np.ndarray  # (count, d) coefficients ĉ
    # lower bands of N = UᵀU factored by Cholesky: of each coordinate alone, (WIDTH, count), or one
    # of all, (WIDTH · d, count · d)
    factors: tuple[np.ndarray, ...]

    def at(self, t: np.ndarray) -> np.ndarray:
        """u, u̇, ü (3, n, d) at times t (n,) of the run [s]."""
        return evaluated(self.basis, self.c, t)

    @property
    def first(self) -> NDArray[np.intp]:
        """(count · d,) the first function in each row of U."""
        count, d = self.c.shape
        return np.minimum(np.arange(count * d) // d, count - WIDTH)

    @cached_property
    def U(self) -> np.ndarray:
        """(count · d, WIDTH, d) rows of U."""
        count, d = self.c.shape
        each = d // len(self.factors)
        U, row = np.zeros((count, d, WIDTH, d)), np.arange(count * each)
        column = row - np.minimum(row // each, count - WIDTH) * each
        for i, lower in enumerate(self.factors):
            own = np.zeros((count * each, WIDTH * each))
            for k in range(WIDTH * each):  # lower[k, a] = L[a + k, a] = U[a, a + k]
                inside = column + k < WIDTH * each
                own[row[inside], (column + k)[inside]] = lower[k, inside]
            mine = slice(i * each, (i + 1) * each)
            U[:, mine, :, mine] = own.reshape(count, each, WIDTH, each)
        return U.reshape(-1, WIDTH, d)


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
    """A derivative (n, d) of coefficients c (count, d) at times t (n,)."""
    first, B = basis.window(np.clip(t, basis.t0, basis.t_end), order)
    u = np.zeros((len(t), c.shape[1]))
    for r in range(WIDTH):
        u += B[:, r, None] * c[first + r]
    return u


def solved(basis: Basis, rows: Sequence[Observations], d: int) -> Spline:
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
    D = np.array([-1.0, 3.0, -3.0, 1.0])  # third differences of the coefficients fill missing ones
    rough = np.zeros((len(D), count))  # lower bands of DᵀD
    for k in range(len(D)):
        for r in range(len(D) - k):
            rough[k, r : count - len(D) + 1 + r] += D[r] * D[r + k]
        normal[k * d] += BRIDGE * normal[0].max() * np.repeat(rough[k], d)
    lower = cholesky_banded(normal, lower=True, check_finite=False)
    c = cho_solve_banded((lower, True), right, check_finite=False).reshape(count, d)
    return Spline(basis, c, (lower,))


def interpolate(t: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Value, first and second derivative (3, n_at) of the quintic spline through x (n,)."""
    if np.ptp(x) == 0:  # a spline would have rates of rounding, which look like a motion
        return np.stack([np.full(len(at), x[0]), np.zeros(len(at)), np.zeros(len(at))])
    from scipy.interpolate import make_interp_spline  # takes 0.2 s to import

    spline = make_interp_spline(t, x, k=DEGREE)
    return np.stack([spline(at, nu) for nu in range(3)])


def fitted(basis: Basis, channels: Sequence[Channel], names: Sequence[str]) -> Spline:
    """The spline of the joints `names`, each from its own channels.

    A channel without noise beside a noisy one weighs no more than rounding allows.
    """
    parts = []
    for name in names:
        own = [each for each in channels if each.joint == name]
        windows = [basis.window(np.clip(c.t, basis.t0, basis.t_end), c.order) for c in own]
        largest = [float(np.abs(B).max(initial=1e-300)) for _, B in windows]
        most = HEAVIEST * min(size / c.sigma for size, c in zip(largest, own, strict=True))
        rows = []
        for channel, (first, B), size in zip(own, windows, largest, strict=True):
            weight = min(1 / channel.sigma, most / size)
            rows.append(Observations(first, weight * B[:, :, None], weight * channel.x))
        parts.append(solved(basis, rows, 1))
    c = np.concatenate([part.c for part in parts], axis=1)
    return Spline(basis, c, tuple(part.factors[0] for part in parts))


def residuals(
    spline: Spline, channels: Sequence[Channel], names: Sequence[str]
) -> list[np.ndarray]:
    """Measured minus smoothed (n_k,) of each channel."""
    at = {name: spline.c[:, [i]] for i, name in enumerate(names)}
    return [
        each.x - derivative(spline.basis, at[each.joint], each.t, each.order)[:, 0]
        for each in channels
    ]


def weighted(basis: Basis, channels: Sequence[Channel], names: Sequence[str]) -> list[Channel]:
    """The channels with the noise that residuals show, where that is more than they had.

    Positions are believed. A velocity that a controller has filtered is smooth, but late: where
    positions are missed by more than their noise, rates and accelerations weigh less until they
    are not. The channels' samples are those in the one run of the basis.
    """
    result = []
    for name in names:
        own = before = [channel for channel in channels if channel.joint == name]
        n = sum(len(channel.x) for channel in own)
        spare = np.sqrt(n / max(n - basis.count, 1))  # as if coefficients cost nothing
        for _ in range(DOUBLINGS + 1):
            off = residuals(fitted(basis, own, (name,)), own, (name,))
            rms = [spare * float(np.sqrt(np.mean(x**2))) for x in off]
            late = [c.order == 0 and r > LOUD * c.sigma for c, r in zip(own, rms, strict=True)]
            if not any(late) or len(own) == 1:
                break
            own = [c if c.order == 0 else replace(c, sigma=2 * c.sigma) for c in own]
        result += reweighted(before, rms)
    return result


def reweighted(channels: Sequence[Channel], rms: Sequence[float]) -> list[Channel]:
    """The channels with the rms of their residuals as noise, where that is clearly more."""
    return [
        replace(channel, sigma=r) if r > LOUD * channel.sigma else channel
        for channel, r in zip(channels, rms, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class Smooth:
    """The smooth motion of an experiment in its independent coordinates."""

    names: tuple[str, ...]  # the joints whose coordinates are splines
    spacing: float  # of the knots [s]
    runs: tuple[tuple[slice, Spline], ...]  # the samples of each run, and its spline
    channels: tuple[Channel, ...]  # fitted to, of these joints and of others that depend on them

    @classmethod
    def of(
        cls,
        channels: Sequence[Channel],
        names: tuple[str, ...],
        spacing: float,
        runs: Sequence[tuple[slice, np.ndarray, Basis]],
    ) -> Smooth:
        """Splines of all runs (samples, times (n,), basis), each joint's from its own channels."""
        splines = tuple(
            (run, fitted(basis, [channel.within(t) for channel in channels], names))
            for run, t, basis in runs
        )
        return cls(names, spacing, splines, tuple(channels))
