"""Which samples become frames, and residuals that do not flicker."""

from __future__ import annotations

import numpy as np

from ident.show.view3d.stage import nearest


def frames(t: np.ndarray, rate: float, most: int, least: int = 2) -> np.ndarray:
    """Indices of the samples that become frames: evenly in time, each the nearest sample.

    Args:
        t: (n,) times [s], ascending.
        rate: frames a second [Hz].
        most: never more frames than this.
        least: a short motion gets as many where it has the samples, to be watched slowly.

    Returns:
        (k,) indices without repetition, the first and the last sample among them.
    """
    span = float(t[-1] - t[0])
    count = int(np.clip(round(rate * span) + 1, least, most))
    if count >= len(t):
        return np.arange(len(t))
    return np.unique(nearest(t, np.linspace(t[0], t[-1], count)))


def running_rms(t: np.ndarray, x: np.ndarray, width: float) -> np.ndarray:
    """Root mean square of x over `width` around each sample; NaN counts as no sample.

    Args:
        t: (n,) times [s], ascending; x: (n, k); width: [s].

    Returns:
        (n, k); NaN where no sample within the width is a number.
    """
    known = np.isfinite(x)
    zero = np.zeros((1, x.shape[1]))
    power = np.concatenate([zero, np.cumsum(np.where(known, x, 0.0) ** 2, axis=0)])
    count = np.concatenate([zero, np.cumsum(known, axis=0)])
    first = np.searchsorted(t, t - width / 2, side="left")
    last = np.searchsorted(t, t + width / 2, side="right")
    number = count[last] - count[first]
    mean = (power[last] - power[first]) / np.where(number > 0, number, np.nan)
    return np.sqrt(np.maximum(mean, 0.0))
