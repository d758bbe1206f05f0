"""A command between its samples: held, straight or smooth, and late.

A drive holds its command from a sample to the next, so what acts at t − delay is a staircase. Rows
are filtered, and a filter passes of a staircase the mean of a smooth curve through the samples over
one hold: R(f) sinc(f T) e^(−iπfT). A straight line half a sample late has the same lateness, but
cos(πfT) for sinc(fT), three times the loss of size (1.2 % for 0.4 % at a twentieth of the rate).
The smooth curve is the cardinal cubic spline (Unser, IEEE Signal Processing Magazine 16(6), 1999),
its mean the difference of its integral.
"""

from __future__ import annotations

import numpy as np

POLE = np.sqrt(3.0) - 2.0  # of the filter from samples to coefficients of cubic B-splines
REACH = 8  # numerics: samples to which that filter reaches; POLE**REACH is 3e-5
SUPPORT = 2  # numerics: samples to which a cubic B-spline reaches
HOLD_FROM = 1.5  # range: samples from which a command is held between its changes
STRAIGHT = 1e-9  # numerics: bend of a straight line, as a share of a command's way
# range: samples over which a drive goes straight at most, as with set-points every 10 ms on a bus
# with 1 kHz (interpolated position mode, CiA 402); a longer line is a ramp that was commanded
LONGEST_LINE = 10
REGULAR = 0.9  # level: share of the lines that have this length where a drive made them


def late_command(t: np.ndarray, x: np.ndarray, late: float, hold: float) -> np.ndarray:
    """Return a command (n,) as it acts below half the rate of its samples.

    Args:
        t: (n,) [s], uniform; x: (n,), constant before and after the samples.
        late: [s] by which it acts later; hold: [s] for which it is held, 0: it is smooth.
    """
    step = float(t[-1] - t[0]) / (len(t) - 1)
    d, h = late / step, hold / step
    first = int(np.floor(d)) - SUPPORT - REACH
    last = int(np.ceil(d + h)) + SUPPORT + REACH
    u = np.arange(first + REACH, last - REACH + 1) - d
    mean = (_integral(u) - _integral(u - h)) / h if h > 0 else _spline(u)
    weights = np.convolve(mean, _prefilter())  # of x[k − j], j = first … last
    weights /= weights.sum()  # a constant stays one
    before, after = max(last, 0), max(-first, 0)
    padded = np.concatenate([np.full(before, x[0]), x, np.full(after, x[-1])])
    y = np.convolve(padded, weights, mode="full")
    start = before - first
    return y[start : start + len(x)]


def held_samples(x: np.ndarray) -> int:
    """Return for how many samples a command (n,) is held between its changes, 1 if for none."""
    changes = np.flatnonzero(np.diff(x))
    if len(changes) < 3:
        return 1
    usual = float(np.median(np.diff(changes)))
    return round(usual) if usual > HOLD_FROM else 1


def linear_samples(x: np.ndarray) -> int:
    """Return for how many samples a command (n,) goes straight on between regular bends, as a drive
    that interpolates makes them, 1 if for none.
    """
    bend = np.abs(np.diff(x, 2))
    bends = np.flatnonzero(bend > STRAIGHT * max(float(np.ptp(x)), 1e-300))
    if len(bends) < 3 or held_samples(x) > 1:
        return 1
    lines = np.diff(bends)
    usual = round(float(np.median(lines)))
    is_regular = usual <= LONGEST_LINE and float(np.mean(lines == usual)) >= REGULAR
    return usual if is_regular else 1


def _prefilter() -> np.ndarray:
    """Return the filter (2 REACH + 1,) from samples to coefficients of cubic B-splines."""
    k = np.abs(np.arange(-REACH, REACH + 1))
    return -6.0 * POLE / (1.0 - POLE**2) * POLE**k


def _spline(u: np.ndarray) -> np.ndarray:
    """Return the cubic B-spline at u [samples]."""
    a = np.abs(u)
    inner = 2.0 / 3.0 - a**2 + a**3 / 2.0
    return np.where(a < 1, inner, np.where(a < 2, (2.0 - np.minimum(a, 2.0)) ** 3 / 6.0, 0.0))


def _integral(u: np.ndarray) -> np.ndarray:
    """Return the integral of the cubic B-spline from −∞ to u, less a half."""
    a = np.minimum(np.abs(u), 2.0)
    inner = 2.0 / 3.0 * a - a**3 / 3.0 + a**4 / 8.0
    return np.sign(u) * np.where(a < 1, inner, 0.5 - (2.0 - a) ** 4 / 24.0)
