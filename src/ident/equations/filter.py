"""Zero-phase low-pass filtering and decimation of all columns alike.

A symmetric finite impulse response has no phase and a finite reach: it can be evaluated only where
samples are kept, in pieces, and what is lost at the ends of an experiment is known exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import firwin

RIPPLE = 60.0  # dB in the stop band
OVERSAMPLING = 4.0  # samples kept a period of the cut-off
ROUNDING = 1e-6  # of a sample: parts of a log, whose rates differ by it, are decimated alike


@dataclass(frozen=True, eq=False)
class Decimator:
    """The filter's taps (2 · half + 1,), or None to keep every sample as it is.

    Attributes:
        taps: symmetric, of unit sum.
        factor: one sample of `factor` is kept.
    """

    taps: np.ndarray | None
    factor: int

    @classmethod
    def of(cls, cutoff: float | None, rate: float) -> Decimator:
        """A Kaiser-windowed low-pass of −6 dB at `cutoff` [Hz] for samples at `rate` [Hz]."""
        if cutoff is None:
            return cls(None, 1)
        # Kaiser: length = (A − 8) / (2.285 Δω), transition from cutoff/2 to 3/2 cutoff
        half = int(np.ceil((RIPPLE - 8) / (2.285 * 2 * np.pi * cutoff / rate) / 2))
        beta = 0.1102 * (RIPPLE - 8.7)
        taps = firwin(2 * half + 1, cutoff, window=("kaiser", beta), fs=rate)
        return cls(taps, max(1, int(rate / (OVERSAMPLING * cutoff) + ROUNDING)))

    @property
    def half(self) -> int:
        """Samples that the filter needs on either side."""
        return 0 if self.taps is None else len(self.taps) // 2

    def pieces(self, segment: slice, chunk: int) -> Iterator[tuple[slice, slice]]:
        """(samples needed, samples answered for) of each piece of a segment."""
        if segment.stop - segment.start <= 2 * self.half:
            return
        chunk = max(chunk, 4 * self.half)
        first, last = segment.start + self.half, segment.stop - self.half
        for start in range(first, last, chunk):
            stop = min(start + chunk, last)
            yield slice(start - self.half, stop + self.half), slice(start, stop)

    def centres(self, part: slice, segment: slice) -> np.ndarray:
        """Samples of a piece at which filtered rows are kept, on one grid for the segment."""
        first = segment.start + self.half
        skip = -(part.start - first) % self.factor
        return np.arange(part.start + skip, part.stop, self.factor)

    def apply(
        self, x: np.ndarray, inside: slice, sample: np.ndarray, absolute: bool = False
    ) -> np.ndarray:
        """Filtered x (n, …) of the samples `inside`, at the kept samples: (kept, …)."""
        assert self.taps is not None
        taps = np.abs(self.taps) if absolute else self.taps
        flat = np.moveaxis(x, 0, -1).reshape(-1, len(x))  # no copy where columns stand whole
        out = np.empty((len(flat), len(sample)))
        group = max(1, 2 * self.half // self.factor)  # outputs that share one dense product
        for i in range(0, len(sample), group):
            centre = sample[i : i + group]
            first, last = centre[0] - self.half, centre[-1] + self.half + 1
            weights = np.zeros((len(centre), last - first))
            for row, at in enumerate(centre - self.half - first):
                weights[row, at : at + len(taps)] = taps
            reached = flat[:, first - inside.start : last - inside.start]
            out[:, i : i + len(centre)] = reached @ weights.T
        return np.moveaxis(out.reshape(*x.shape[1:], len(sample)), -1, 0)
