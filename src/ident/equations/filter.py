"""Zero-phase low-pass filtering and decimation of all columns alike.

A symmetric finite impulse response has no phase and a finite reach: it can be evaluated only where
samples are wanted, in pieces, and what is lost at the ends of an experiment is known exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ident.information.linear import Array, Index
from ident.information.time_bases import Basis

RIPPLE = 60.0  # level: dB in the stop band
OVERSAMPLING = 4.0  # level: filtered samples a period of the cut-off
STICKING = 0.2  # tuned: share of a filtered row that may come from samples that do not inform it
STANDING = 0.02  # tuned: share of a row in motion that may come from standstill
CHUNK = 4096  # work: samples that are in memory at once
SAME_RATE = 1e-6  # numerics: of a sample: rates that differ by it are decimated alike
Product = tuple[slice, np.ndarray]  # samples m, and weights (rows, m) of some filtered rows


@dataclass(frozen=True, eq=False)
class Decimator:
    """The filter's taps (2 · half + 1,), or None to keep every sample as it is."""

    taps: np.ndarray | None  # symmetric, of unit sum
    factor: int  # one sample of `factor` remains

    @classmethod
    @lru_cache(64)
    def of(cls, cutoff: float | None, rate: float) -> Decimator:
        """A Kaiser-windowed low-pass of −6 dB at `cutoff` [Hz] for samples at `rate` [Hz]; none of
        poses, whose rate is 0.
        """
        if cutoff is None or not rate:
            return cls(None, 1)
        # Kaiser: length = (A − 8) / (2.285 Δω), transition from cutoff/2 to 3/2 cutoff
        half = int(np.ceil((RIPPLE - 8) / (2.285 * 2 * np.pi * cutoff / rate) / 2))
        beta = 0.1102 * (RIPPLE - 8.7)
        # scipy.signal has this too, but needs half a second to be imported
        window = np.kaiser(2 * half + 1, beta)
        taps = np.sinc(2 * cutoff / rate * np.arange(-half, half + 1)) * window
        taps /= taps.sum()
        return cls(taps, max(1, int(rate / (OVERSAMPLING * cutoff) + SAME_RATE)))

    @property
    def half(self) -> int:
        """Samples that the filter needs on either side."""
        return 0 if self.taps is None else len(self.taps) // 2

    @property
    def independent(self) -> float:
        """Share of the rows to which white noise that was filtered is equal: its bandwidth over
        half their rate.
        """
        return 1.0 if self.taps is None else min(1.0, self.factor * float(self.taps @ self.taps))

    def filtered(
        self, segment: slice, make: Callable[[slice], Sequence[np.ndarray]]
    ) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
        """Series of a run of samples, filtered and decimated: (samples kept (n,), series (n, …)).

        `make` gives the series of some samples, each (samples, …); every sample is made once. Of a
        series of booleans the share of each row, by |taps|, is given that comes from samples at
        which it is false. What the filter needs at the ends of the run is lost.
        """
        starts = range(segment.start, segment.stop, CHUNK)
        parts = (slice(start, min(start + CHUNK, segment.stop)) for start in starts)
        if self.taps is None:
            for part in parts:
                shares = [1.0 - x if x.dtype == bool else x for x in make(part)]
                yield np.arange(part.start, part.stop), shares
            return
        if segment.stop - segment.start <= 2 * self.half:
            return
        pending: list[np.ndarray] = []  # samples from `first` on that rows still need, by series
        first, row = segment.start, segment.start + self.half
        for part in parts:
            series = make(part)
            flat = [(~x if x.dtype == bool else x).reshape(len(x), -1) for x in series]
            if pending:
                flat = [np.concatenate(pair) for pair in zip(pending, flat, strict=True)]
            pending = flat
            at = np.arange(row, part.stop - self.half, self.factor)
            if len(at):
                row = int(at[-1]) + self.factor
                kinds = {x.dtype == bool for x in series}
                taps = {masks: np.abs(self.taps) if masks else self.taps for masks in kinds}
                weights = {masks: products(h, at - first) for masks, h in taps.items()}
                outputs = [
                    multiplied(weights[x.dtype == bool], y).reshape(len(at), *x.shape[1:])
                    for x, y in zip(series, pending, strict=True)
                ]
                yield at, outputs
            needed = min(row - self.half, part.stop)
            pending, first = [y[needed - first :] for y in pending], needed


def products(taps: np.ndarray, at: np.ndarray) -> list[Product]:
    """The products that filter a series at samples `at` (N,); near rows share one."""
    padded, blocks = np.concatenate([[0.0], taps, [0.0]]), list[Product]()
    first, near, weights = 0, np.zeros(0, int), np.zeros((0, 0))
    while first < len(at):
        last = int(np.searchsorted(at, at[first] + len(taps), side="right"))
        offsets = at[first:last] - at[first]
        if not np.array_equal(offsets, near):
            near, place = offsets, np.arange(offsets[-1] + len(taps)) - offsets[:, None] + 1
            weights = padded[np.clip(place, 0, len(padded) - 1)]
        start = int(at[first]) - len(taps) // 2
        blocks.append((slice(start, start + weights.shape[1]), weights))
        first = last
    return blocks


def multiplied(blocks: Sequence[Product], x: np.ndarray) -> np.ndarray:
    """The filtered series (N, c) of a series x (n, c)."""
    return np.concatenate([weights @ x[samples] for samples, weights in blocks])


def filtered_windows(
    decimator: Decimator, basis: Basis, t: Array, first: Index, values: Array, sample: Index
) -> tuple[Index, Array]:
    """Filtered Σ_w values[:, w] c[first + w], linear in coefficients c of a time basis: from
    windows (N, w, …) of functions at the times t (N,) [s], (first (n,), wider windows (n, w', …))
    at some samples (n,).
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
