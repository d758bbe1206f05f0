"""What noise of the residual's own spectrum looks like: autocorrelation, and surrogates of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.equations.filter import Decimator

MEMORY = 0.15  # autocorrelation beyond the filter's reach that is always taken for noise
ERRORS = 4.0  # or so many of its standard errors
FARTHEST = 400  # lags that are looked at
UNFILTERED = 2  # lags at which differentiated noise of encoders is correlated without any filter
FINE = 40  # samples a period of the cut-off at which the filter is looked at


@dataclass(frozen=True)
class Memory:
    """Largest autocorrelation of a series beyond the reach of its filter.

    Attributes:
        value: the autocorrelation; lag: where [s].
        threshold: below which |value| is that of noise: 0.15, or four standard errors (Bartlett).
        effective: number of independent rows, n / Σ r² of the filter alone.
    """

    value: float
    lag: float
    threshold: float
    effective: float

    @property
    def noise(self) -> bool:
        """Whether nothing is remembered for longer than the filter's reach."""
        return abs(self.value) <= self.threshold


def autocorrelation(runs: Sequence[np.ndarray], lags: int) -> np.ndarray:
    """r (lags + 1,) of a series in runs without a gap, about their common mean; r[0] = 1."""
    mean = np.concatenate(runs).mean()
    total, pairs = np.zeros(lags + 1), np.zeros(lags + 1)
    for run in runs:
        n = len(run)
        spectrum = np.fft.rfft(run - mean, 2 * n)
        product = np.fft.irfft(np.abs(spectrum) ** 2)[: min(lags + 1, n)]
        total[: len(product)] += product
        pairs[: len(product)] += n - np.arange(len(product))
    found = total / np.maximum(pairs, 1)
    return found / found[0] if found[0] > 0 else np.eye(1, lags + 1)[0]


def own_correlation(cutoff: float | None, rate: float) -> np.ndarray:
    """r (lags,) from lag 1 on that a filter gives to white noise, in rows at `rate` [Hz].

    For no filter there are two lags of 0, over which differentiated noise of encoders reaches.
    """
    if cutoff is None:
        return np.zeros(UNFILTERED)
    fine = Decimator.of(cutoff, FINE * cutoff)  # the same filter for samples at FINE · cutoff
    assert fine.taps is not None
    product = np.correlate(fine.taps, fine.taps, "full")[len(fine.taps) - 1 :]
    lags = np.arange(1, max(UNFILTERED, int(np.ceil(fine.half * rate / (FINE * cutoff)))) + 1)
    at = lags * FINE * cutoff / rate
    return np.interp(at, np.arange(len(product)), product / product[0], right=0.0)


def memory_of(runs: Sequence[np.ndarray], cutoff: float | None, rate: float) -> Memory:
    """Autocorrelation beyond the filter's reach.

    Args:
        runs: the series (n_i,), in runs without a gap.
        cutoff: of the filter that it went through [Hz]; None: none.
        rate: rows a second [Hz].
    """
    n, longest = sum(map(len, runs)), max(map(len, runs))
    own = own_correlation(cutoff, rate)
    first, last = len(own) + 1, min(longest // 3, FARTHEST)
    r = autocorrelation(runs, max(last, first))
    near = own if cutoff else r[1:first]
    effective = n / float(1 + 2 * (near**2).sum())
    if last <= first:
        return Memory(0.0, 0.0, MEMORY, effective)
    lags = np.arange(first, last + 1)
    pairs = sum(np.maximum(len(run) - lags, 0) for run in runs) * effective / n
    limit = np.maximum(MEMORY, ERRORS / np.sqrt(pairs))
    worst = int(np.argmax(np.abs(r[lags]) / limit))
    return Memory(float(r[lags[worst]]), lags[worst] / rate, float(limit[worst]), effective)


def surrogates(runs: Sequence[np.ndarray], count: int, seed: int = 0) -> np.ndarray:
    """(n, count) series with each run's spectrum and random phases: noise like it, but only noise.

    Theiler et al., Physica D 58, 1992.
    """
    random = np.random.default_rng(seed)
    found = []
    for run in runs:
        spectrum = np.abs(np.fft.rfft(run))[:, None]
        phase = np.exp(2j * np.pi * random.random((len(spectrum), count)))
        phase[0] = np.sign(phase[0].real)
        found.append(np.fft.irfft(spectrum * phase, len(run), axis=0))
    return np.concatenate(found)
