"""White noise of a signal-to-noise ratio on the channels of a log.

    x + σ ε,  ε ~ N(0, 1) a sample,    σ = rms(x) · 10^(−SNR / 20)

The signal's power includes its mean, as in MATLAB's awgn(x, snr, 'measured'); the paper gives its
ratios without a definition.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.errors import LogError, one_of
from ident.log import Log

CHANNELS = ("q", "v", "a", "tau", "wrench")
USUAL = CHANNELS[:4]


def level(x: np.ndarray, snr: float) -> float:
    """Standard deviation σ of the noise of x (n,) at a signal-to-noise ratio [dB]."""
    known = x[np.isfinite(x)]
    power = float(np.mean(known**2)) if len(known) else 0.0
    return float(np.sqrt(power) * 10 ** (-snr / 20))


def touched(log: Log, channels: Sequence[str]) -> list[str]:
    """Columns of a log that get noise.

    Raises:
        LogError: for a channel that there is not, or a log that has none of them.
    """
    for channel in channels:
        if channel not in CHANNELS:
            raise LogError(f"noise on '{channel}'; {one_of(channel, CHANNELS)}")
    found = [name for name in log.columns if name.partition(".")[0] in channels]
    if not found:
        raise LogError(f"{log.name}: no column of {', '.join(channels)}, so there is no noise")
    return found


def noisy(log: Log, snr: float, columns: Sequence[str], random: np.random.Generator) -> Log:
    """The log with noise on some columns; empty cells stay empty."""
    found = dict(log.columns)
    for name in columns:
        x = found[name]
        found[name] = x + level(x, snr) * random.standard_normal(len(x))
    return Log(log.name, found, log.t, log.repairs)


def random_of(seed: int, snr: float, run: int) -> np.random.Generator:
    """The noise of one run: it depends on these three alone, not on what else is asked for."""
    decibels = round(1000 * snr)
    key = (2 * abs(decibels) + (decibels < 0), run)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
