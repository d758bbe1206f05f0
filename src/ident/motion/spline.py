"""Channels of a motion: their noise and bandwidth, and one smooth motion fitted to all of a run.

    min_c Σ_k |x_k − u^(k)(t_k)|² / σ_k²,     u(t) = B(t) c,    u̇ = Ḃ c,    ü = B̈ c

over the channels k = 0, 1, 2 (position, velocity, acceleration) of each joint, each weighted by its
noise; B: quintic B-splines. Time stamps may jitter and channels may have rates of their own: the
spline is fitted at the times of the samples. |U (c − ĉ)|² is the loss of another motion c. SciPy's
`make_lsq_spline` fits values alone, and returns no U.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import comb

import numpy as np
from numpy.typing import NDArray

from ident.information.evidence import EXCESS
from ident.information.lapack import cholesky_banded, solve_cholesky_banded
from ident.information.time_bases import Basis
from ident.log.remember import once_a_series

DEGREE = 5  # range
WIDTH = DEGREE + 1  # range: functions that are nonzero at a time
BRIDGE = 1e-12  # numerics: weight of smoothness, which decides only where a few samples are missing
DOUBLINGS = 12  # work
HEAVIEST = 1e6  # numerics: rows of a channel over another's, whose squares rounding can add
ORDER = 6  # numerics: of the difference that leaves little but noise
POWER = 0.999  # range: share of the velocities' power that is the motion's
VISIBLE = 200.0  # tuned: times the mean power of noise; real noise (steps, jitter) is not white
# numerics: neighbouring frequencies over which that is the mean, twice the width of a line under
# the window: a lone one is a vibration or the mains; a motion's lines are thousands of times larger
NEIGHBOURS = 9
LARGEST = 1e30  # numerics: ratio where there is no noise at all
GRAINS = 20  # work: changes of a signal from which its quantisation can be known
# numerics: steps between two samples beyond which multiples are no sign of anything
LARGEST_STEP_RATIO = 1000.0
ORDERS = "qva"


# --- noise, quantisation and bandwidth of a uniformly sampled signal ------------------------------


def rms(parts: Sequence[np.ndarray]) -> float:
    """Root mean square of all numbers in some arrays; 0 where there are none."""
    every = np.concatenate(parts)
    return float(np.sqrt((every**2).sum() / max(len(every), 1)))


@once_a_series
def noise_level(x: np.ndarray) -> float:
    """Standard deviation of white noise in a smooth, uniformly sampled signal (n,).

    The 6th difference of a smooth signal is small, that of noise is large (√924 times the noise);
    a quantile of it makes rare jumps, such as friction at reversals, harmless, and is not zero
    where a quantised signal stands still for a while.
    """
    difference = np.diff(x, ORDER)
    if not len(difference):
        return 0.0
    gain = np.sqrt(924.0)  # Σ binomial(6, k)²
    return float(quantile(np.abs(difference), 0.8) / 1.2816 / gain)


def quantile(x: np.ndarray, share: float) -> float:
    """Return a quantile of numbers (n,), n > 0, as np.quantile, which looks at its arguments for
    longer; NaN if one of them is.
    """
    place = share * (len(x) - 1)
    low = int(place)
    high, part = min(low + 1, len(x) - 1), place - low
    parted = np.partition(x, (low, high, -1))
    if np.isnan(parted[-1]):
        return np.nan
    a, b = parted[low], parted[high]
    return float(b - (b - a) * (1 - part) if part >= 0.5 else a + (b - a) * part)


def is_white(x: np.ndarray, longest: int) -> bool:
    """Whether the noise of a smooth signal (n,) is the same in differences over 1, 2, 4, …, up to
    `longest` samples, as white noise is; false where there are not two of them.

    Medians: what few samples feel, such as friction at reversals, is no noise.
    """
    sizes, k = [], 1
    while k <= longest and len(x) > ORDER * k:
        difference = x
        for _ in range(ORDER):
            difference = difference[k:] - difference[:-k]
        sizes.append(float(np.median(np.abs(difference))))
        k *= 2
    return len(sizes) > 1 and max(sizes) < EXCESS * sizes[0]


def noise_share(x: np.ndarray, differences: int = 0) -> float:
    """Noise over signal in differences of x (n,), as they would be without smoothing; 0 for a
    constant.
    """
    spread = float(np.std(np.diff(x, differences)))
    gain = np.sqrt(float(comb(2 * differences, differences)))
    return gain * noise_level(x) / spread if spread > 0 else 0.0


def motion_bandwidth(x: np.ndarray, dt: float, order: int = 0) -> float:
    """Frequency [Hz] below which 99.9 % of the power of the velocity lies.

    The noise's own share, measured in the upper half of the spectrum, is taken off first: what
    does not stand out of it by VISIBLE, alone and with its NEIGHBOURS, cannot be told from it.
    x (n,) of step dt [s] is the position (order 0), velocity (1) or acceleration (2).
    """
    x = np.diff(x) / dt if order == 0 else x
    n = len(x)
    f = np.fft.rfftfreq(n, dt)
    power = np.abs(np.fft.rfft((x - x.mean()) * hanning(n))) ** 2
    # of white noise in the channel: differenced, as it is, or integrated
    shape = (2 * np.sin(np.pi * f * dt)) ** 2 if order == 0 else np.ones(len(f))
    high = slice(max(n // 4, 1), None)
    noise = np.median(power[high] / shape[high]) / np.log(2) * shape
    ratio = np.divide(power, noise, out=np.where(power > 0, LARGEST, 0.0), where=noise > 0)
    ratio[0] = ratio[min(1, len(f) - 1)]  # differenced noise has none at f = 0
    width = min(NEIGHBOURS, len(f))
    together = np.convolve(np.minimum(ratio, LARGEST), np.full(width, 1 / width), "same")
    power = np.where(np.minimum(ratio, together) > VISIBLE, power - noise, 0.0)
    if order == 2:
        power = power / np.maximum(2 * np.pi * f, 2 * np.pi * f[1]) ** 2
    total = np.cumsum(power)
    if total[-1] <= 0:
        return 0.0
    return float(f[min(np.searchsorted(total, POWER * total[-1]), n // 2)])


@lru_cache(2)
def hanning(n: int) -> np.ndarray:
    """Hann's window (n,), the same for all channels of a log."""
    window = np.hanning(n)
    window.flags.writeable = False
    return window


def acceleration_size(q: np.ndarray, dt: float, below: float) -> float:
    """rms of the second derivative of q (n,) below a frequency [Hz]."""
    n, window = len(q), hanning(len(q))
    since = np.arange(n) - 0.5 * (n - 1)
    slope = float(since @ q) / max(float(since @ since), 1e-300)
    x = (q - q.mean() - slope * since) * window
    f = np.fft.rfftfreq(n, dt)
    power = 2 * np.abs(np.fft.rfft(x)) ** 2 * (2 * np.pi * f) ** 4
    return float(np.sqrt(power[f <= below].sum() / n / (window**2).sum()))


@once_a_series
def grain(x: np.ndarray) -> float:
    """The step of a signal (n,) that only takes multiples of one; 0 for others."""
    steps = np.abs(np.diff(x))
    stays = steps == 0
    again = np.count_nonzero(stays[1:] & ~stays[:-1]) >= GRAINS
    steps = steps[~stays]
    if len(steps) < GRAINS or steps.min() * LARGEST_STEP_RATIO < steps.max():
        return 0.0
    off = steps / steps.min()
    steps_off = np.round(off)
    multiples = (np.abs(off - steps_off) < 0.01 * off).all()
    # a ramp has one step, too, but does not stay at its values again and again
    return float(steps.min()) if multiples and (again or np.ptp(steps_off) > 0) else 0.0


# --- splines through channels ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Channel:
    """The logged samples of one derivative of one joint's coordinate."""

    joint: str
    order: int  # 0 position, 1 velocity, 2 acceleration
    t: np.ndarray  # (n,) [s], as logged
    x: np.ndarray  # (n,), as logged
    sigma: float  # standard deviation of its noise
    spread: float  # standard deviation of x

    @property
    def column(self) -> str:
        """Its name in the log."""
        return f"{ORDERS[self.order]}.{self.joint}"

    @property
    def noise(self) -> float:
        """Its noise as a share of its spread; 0 for a constant."""
        return self.sigma / self.spread if self.spread > 0 else 0.0

    def within(self, t: np.ndarray) -> Channel:
        """Its samples in a run of the clock t (n,)."""
        margin = 0.75 * (t[1] - t[0]) if len(t) > 1 else 0.0
        a, b = np.searchsorted(self.t, (t[0] - margin, t[-1] + margin))
        return replace(self, t=self.t[a:b], x=self.x[a:b])


@dataclass(frozen=True)
class Smoothed:
    """The result of smoothing a channel."""

    column: str  # of the log
    how: str  # in words
    noise: float  # estimated, white; a channel that the others contradict weighs less
    residual: float  # rms of measured minus smoothed; 0 where it was taken as logged
    spacing: float = 0.0  # of the knots [s]; 0 where there are none


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
        per_factor = d // len(self.factors)
        U, row = np.zeros((count, d, WIDTH, d)), np.arange(count * per_factor)
        column = row - np.minimum(row // per_factor, count - WIDTH) * per_factor
        for i, lower in enumerate(self.factors):
            block = np.zeros((count * per_factor, WIDTH * per_factor))
            for k in range(WIDTH * per_factor):  # lower[k, a] = L[a + k, a] = U[a, a + k]
                inside = column + k < WIDTH * per_factor
                block[row[inside], (column + k)[inside]] = lower[k, inside]
            columns = slice(i * per_factor, (i + 1) * per_factor)
            U[:, columns, :, columns] = block.reshape(count, per_factor, WIDTH, per_factor)
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


class Windows:
    """The functions of a basis at times of several channels, most of which share their times."""

    def __init__(self, basis: Basis) -> None:
        self.basis = basis
        # order of the derivative, times (n,) [s], and the functions there
        self._known: list[tuple[int, np.ndarray, tuple[NDArray[np.intp], np.ndarray]]] = []

    def at(self, t: np.ndarray, order: int) -> tuple[NDArray[np.intp], np.ndarray]:
        """As `Basis.window`, of times (n,) [s] that may be beyond the ends: there, theirs."""
        for known_order, times, window in self._known:
            if known_order == order and (times is t or np.array_equal(times, t)):
                return window
        window = self.basis.window(np.clip(t, self.basis.t0, self.basis.t_end), order)
        self._known.append((order, t, window))
        return window


def evaluated(
    basis: Basis,
    c: np.ndarray,
    t: np.ndarray,
    orders: Sequence[int] = range(3),
    windows: Windows | None = None,
) -> np.ndarray:
    """u, u̇, ü (3, n, d) of coefficients c (count, d) at times t (n,); beyond the ends, theirs."""
    windows, values = windows or Windows(basis), np.zeros((len(orders), len(t), c.shape[1]))
    for u, order in zip(values, orders, strict=True):
        first, B = windows.at(t, order)
        for r in range(WIDTH):
            u += B[:, r, None] * c[first + r]
    return values


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
    lower = cholesky_banded(normal)
    c = solve_cholesky_banded(lower, right).reshape(count, d)
    return Spline(basis, c, (lower,))


def interpolate(t: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Value, first and second derivative (3, n_at) of the quintic spline through x (n,)."""
    if np.ptp(x) == 0:  # a spline would have rates of rounding, which look like a motion
        return np.stack([np.full(len(at), x[0]), np.zeros(len(at)), np.zeros(len(at))])
    from scipy.interpolate import make_interp_spline  # takes 0.2 s to import

    spline = make_interp_spline(t, x, k=DEGREE)
    return np.stack([spline(at, nu) for nu in range(3)])


def fitted(
    basis: Basis, channels: Sequence[Channel], names: Sequence[str], shared: Windows | None = None
) -> Spline:
    """The spline of the joints `names`, each from its own channels.

    A channel without noise beside a noisy one weighs no more than rounding allows.
    """
    parts, known = list[Spline](), shared or Windows(basis)
    for name in names:
        of_joint = [channel for channel in channels if channel.joint == name]
        windows = [known.at(c.t, c.order) for c in of_joint]
        largest = [float(np.abs(B).max(initial=1e-300)) for _, B in windows]
        most = HEAVIEST * min(size / c.sigma for size, c in zip(largest, of_joint, strict=True))
        rows = []
        for channel, (first, B), size in zip(of_joint, windows, largest, strict=True):
            weight = min(1 / channel.sigma, most / size)
            rows.append(Observations(first, weight * B[:, :, None], weight * channel.x))
        parts.append(solved(basis, rows, 1))
    c = np.concatenate([part.c for part in parts], axis=1)
    return Spline(basis, c, tuple(part.factors[0] for part in parts))


def residuals(
    spline: Spline, channels: Sequence[Channel], names: Sequence[str], shared: Windows | None = None
) -> list[np.ndarray]:
    """Measured minus smoothed (n_k,) of each channel."""
    at = {name: spline.c[:, [i]] for i, name in enumerate(names)}
    known = shared or Windows(spline.basis)
    smooth = (evaluated(spline.basis, at[c.joint], c.t, (c.order,), known) for c in channels)
    return [c.x - x[0, :, 0] for c, x in zip(channels, smooth, strict=True)]


def weighted(basis: Basis, channels: Sequence[Channel], names: Sequence[str]) -> list[Channel]:
    """The channels with the noise that residuals show, where that is more than they had.

    Positions are believed. A velocity that a controller has filtered is smooth, but late: where
    positions are missed by more than their noise, rates and accelerations weigh less until they
    are not. The channels' samples are those in the one run of the basis.
    """
    result, known = [], Windows(basis)
    for name in names:
        of_joint = before = [channel for channel in channels if channel.joint == name]
        n = sum(len(channel.x) for channel in of_joint)
        spare = np.sqrt(n / max(n - basis.count, 1))  # as if coefficients cost nothing
        for _ in range(DOUBLINGS + 1):
            spline = fitted(basis, of_joint, (name,), known)
            off = residuals(spline, of_joint, (name,), known)
            rms = [spare * float(np.sqrt(np.mean(x**2))) for x in off]
            late = [
                c.order == 0 and r > EXCESS * c.sigma for c, r in zip(of_joint, rms, strict=True)
            ]
            if not any(late) or len(of_joint) == 1:
                break
            of_joint = [c if c.order == 0 else replace(c, sigma=2 * c.sigma) for c in of_joint]
        result += reweighted(before, rms)
    return result


def reweighted(channels: Sequence[Channel], rms: Sequence[float]) -> list[Channel]:
    """The channels with the rms of their residuals as noise, where that is clearly more."""
    return [
        replace(channel, sigma=r) if r > EXCESS * channel.sigma else channel
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
