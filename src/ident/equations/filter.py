"""Zero-phase low-pass filtering and decimation of all columns alike.

A symmetric finite impulse response has no phase and a finite reach: it can be evaluated only where
samples are wanted, in pieces, and what is lost at the ends of an experiment is known exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ident.information.splines import Basis

RIPPLE = 60.0  # dB in the stop band
OVERSAMPLING = 4.0  # filtered samples a period of the cut-off
STICKING = 0.2  # share of a filtered row that may come from samples that do not inform it
CHUNK = 4096  # samples that are in memory at once
ROUNDING = 1e-6  # of a sample: parts of a log, whose rates differ by it, are decimated alike


@dataclass(frozen=True, eq=False)
class Decimator:
    """The filter's taps (2 · half + 1,), or None to keep every sample as it is."""

    taps: np.ndarray | None  # symmetric, of unit sum
    factor: int  # one sample of `factor` remains

    @classmethod
    @lru_cache(64)
    def of(cls, cutoff: float | None, rate: float) -> Decimator:
        """A Kaiser-windowed low-pass of −6 dB at `cutoff` [Hz] for samples at `rate` [Hz]."""
        if cutoff is None:
            return cls(None, 1)
        # Kaiser: length = (A − 8) / (2.285 Δω), transition from cutoff/2 to 3/2 cutoff
        half = int(np.ceil((RIPPLE - 8) / (2.285 * 2 * np.pi * cutoff / rate) / 2))
        beta = 0.1102 * (RIPPLE - 8.7)
        # scipy.signal has this too, but needs half a second to be imported
        taps = np.sinc(2 * cutoff / rate * np.arange(-half, half + 1)) * np.kaiser(
            2 * half + 1, beta
        )
        taps /= taps.sum()
        return cls(taps, max(1, int(rate / (OVERSAMPLING * cutoff) + ROUNDING)))

    @property
    def half(self) -> int:
        """Samples that the filter needs on either side."""
        return 0 if self.taps is None else len(self.taps) // 2

    def filtered(
        self,
        segment: slice,
        make: Callable[[slice], Sequence[np.ndarray]],
        sticking: float = STICKING,
    ) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
        """Series of a run of samples, filtered and decimated: (samples kept (n,), series (n, …)).

        `make` gives the series of some samples, each (samples, …); columns that stand whole in
        memory are not copied. Every sample is made once. A series of booleans says which samples
        inform: a filtered row does if less than the share `sticking` of it, by |taps|, comes from
        samples that do not. What the filter needs at the ends of the run is lost.
        """
        parts = (
            slice(start, min(start + CHUNK, segment.stop))
            for start in range(segment.start, segment.stop, CHUNK)
        )
        if self.taps is not None and segment.stop - segment.start <= 2 * self.half:
            return
        run = FilterRun(self, segment.start, sticking)
        for part in parts:
            sample, series = run.push(make(part))
            if len(sample):
                yield sample, series


class FilterRun:
    """A run of samples on its way through a filter: rows leave it half its length later.

    Attributes:
        end: number of the next sample.
    """

    def __init__(self, decimator: Decimator, first: int, sticking: float = STICKING) -> None:
        self.end, self._decimator, self._sticking = first, decimator, sticking
        self._next = first + decimator.half  # first row that has not left
        self._sums: list[np.ndarray] = []  # (columns, rows) that samples have entered, from that on

    def push(self, series: Sequence[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return samples kept (n,) and series (n, …) that are complete with further samples."""
        start, stop = self.end, self.end + len(series[0])
        self.end, taps, half = stop, self._decimator.taps, self._decimator.half
        if taps is None:
            return np.arange(start, stop), list(series)
        centres = np.arange(self._next, stop + half, self._decimator.factor)
        # columns of all series (columns, n); of booleans, where they are false
        flat = [
            np.moveaxis(~x if x.dtype == bool else x, 0, -1).reshape(-1, len(x)) for x in series
        ]
        before = self._sums or [np.empty((len(x), 0)) for x in flat]
        more = len(centres) - before[0].shape[1]
        sums = [np.hstack([y, np.zeros((len(y), more))]) for y in before]
        padded = np.concatenate([[0.0], taps, [0.0]])
        step = max(half // 2, 64)  # samples of one dense product, of which a half is zeros
        for first in range(start, stop, step):
            sample = np.arange(first, min(first + step, stop))
            rows = slice(*np.searchsorted(centres, (sample[0] - half, sample[-1] + half + 1)))
            place = sample[:, None] - centres[rows] + half + 1
            weights = padded[np.clip(place, 0, len(padded) - 1)]
            inside = slice(first - start, first - start + len(sample))
            for total, x in zip(sums, flat, strict=True):
                total[:, rows] += x[:, inside] @ (np.abs(weights) if x.dtype == bool else weights)
        ready = int(np.searchsorted(centres, stop - half))
        self._sums = [y[:, ready:] for y in sums]
        self._next += ready * self._decimator.factor
        done = [
            np.moveaxis(y[:, :ready].reshape(*x.shape[1:], ready), -1, 0)
            for y, x in zip(sums, series, strict=True)
        ]
        informed = [
            y < self._sticking if x.dtype == bool else y for y, x in zip(done, series, strict=True)
        ]
        return centres[:ready], informed


def decimated(x: np.ndarray, taps: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Filtered series Σ_i taps_i x[at − half + i] (N, c) at samples `at` (N,) of series x (n, c).

    Rows in equal steps h share products: x in blocks X_r of h samples and taps in blocks T_j give
    y_r = Σ_j T_j X_(r+j), each block product made once.
    """
    out, half = np.empty((len(at), x.shape[1])), len(taps) // 2
    step = np.diff(at, append=at[-1:])
    first = 0
    while first < len(at):
        h = int(step[first]) or len(taps)
        other = np.flatnonzero(step[first:-1] != h)
        last = first + int(other[0]) + 1 if len(other) else len(at)
        count, J = last - first, -(-len(taps) // h)
        T = np.zeros(J * h)
        T[: len(taps)] = taps
        start = at[first] - half
        X = x[start : start + (count + J - 1) * h]
        X = np.concatenate([X, np.zeros(((count + J - 1) * h - len(X), x.shape[1]))])
        Y = T.reshape(J, h) @ X.reshape(count + J - 1, h, -1)
        out[first:last] = sum(Y[j : j + count, j] for j in range(J))
        first = last
    return out


def filtered_windows(
    decimator: Decimator,
    basis: Basis,
    t: np.ndarray,
    first: np.ndarray,
    values: np.ndarray,
    sample: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Filtered Σ_w values[:, w] c[first + w], linear in coefficients c of a time basis.

    From windows (N, w, …) of the basis functions that differ from zero at the times t (N,) [s]
    follow (first (n,), wider windows (n, w', …)) at some samples (n,).
    """
    half, w = decimator.half, values.shape[1]
    if decimator.taps is None:
        return first[sample], values[sample]
    width = min(w + 1 + int(np.ceil(2 * half * (t[1] - t[0]) / basis.spacing)), basis.count)
    low = np.minimum(first[sample - half], basis.count - width)
    wide = np.zeros((len(sample), width, *values.shape[2:]))
    row = np.arange(len(sample))[:, None]
    for tap, h in enumerate(decimator.taps):
        at = sample - half + tap
        wide[row, (first[at] - low)[:, None] + np.arange(w)] += h * values[at]
    return low, wide
