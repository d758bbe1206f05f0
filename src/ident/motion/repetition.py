"""The period of a motion that is repeated."""

from __future__ import annotations

import numpy as np

from ident.motion.state import State

ALIKE = 0.98  # likeness of two periods of one motion
APART = 0.5  # likeness below which the motion has left where it was
MOVING = 0.05  # share of samples in which a joint moves, for it to count
FINE = 16  # samples a period of the motion's bandwidth, from which periods are found
FEWEST = 16  # samples from which a period can be determined


def period_of(e: State, joints: np.ndarray, bandwidth: float) -> float | None:
    """Return the period [s] of a motion in its longest run; None if it is not repeated.

    Args:
        e: the motion.
        joints: places of the joints (d,) that are looked at.
        bandwidth: of the motion [Hz].
    """
    run = max(e.segments(), key=lambda each: each.stop - each.start, default=slice(0, 0))
    stride = max(1, int(e.rate / (FINE * max(bandwidth, 1e-9))))
    t, y, yd = (x[run][::stride] for x in (e.t, e.y, e.yd))
    if len(t) < FEWEST:
        return None
    moves = (np.abs(yd[:, joints]) > e.still[joints]).mean(axis=0) > MOVING
    if not moves.any():
        return None
    likeness = np.min([_likeness(y[:, i]) for i in joints[moves]], axis=0)
    inner = likeness[1:-1]
    peak = (inner >= likeness[:-2]) & (inner >= likeness[2:]) & (inner >= ALIKE)
    away = np.flatnonzero(likeness < APART)
    lags = 1 + np.flatnonzero(peak)
    lags = lags[lags > away[0]] if len(away) else lags[:0]
    if not len(lags):
        return None
    low, mid, high = likeness[lags[0] - 1 : lags[0] + 2]
    bend = low - 2 * mid + high
    exact = lags[0] + (0.5 * (low - high) / bend if bend < 0 else 0.0)
    return float(exact * (t[-1] - t[0]) / (len(t) - 1))


def _likeness(q: np.ndarray) -> np.ndarray:
    """Return the likeness by lag (n // 2 + 3,); whole turns between periods do not count."""
    n = len(q)
    x = q - np.linspace(q[0], q[-1], n)  # a joint that turns on and on varies about this
    x -= x.mean()
    lags = np.arange(n // 2 + 3)
    product = np.fft.irfft(np.abs(np.fft.rfft(x, 2 * n)) ** 2)[: len(lags)]
    s, ss = (np.concatenate([[0.0], np.cumsum(y)]) for y in (x, x**2))
    pairs = n - lags
    mean = (s[n] - s[lags] - s[pairs]) / pairs
    difference = (ss[n] - ss[lags] + ss[pairs] - 2 * product) / pairs - mean**2
    return np.asarray(1 - difference / (2 * max(float(np.var(x)), 1e-300)))
