"""Position, velocity and acceleration of one coordinate from what was measured of it.

One quintic B-spline y(t) is fitted to positions (and velocities, where logged), each weighted by
its noise; v and a are its derivatives, so the three belong together. Time stamps may jitter and
channels may have rates of their own: the spline is fitted where the samples are.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import solveh_banded

DEGREE = 5
BRIDGE = 1e-12  # weight of smoothness, which decides only where a few samples are missing
Channel = tuple[int, np.ndarray, np.ndarray, float]  # derivative's order, t, x, noise


def interpolate(t: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Value, first and second derivative (3, n_at) of the quintic spline through x (n,)."""
    spline = make_interp_spline(t, x, k=DEGREE)
    return np.stack([spline(at, nu) for nu in range(3)])


def filled(t: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """x (n,) at the times `at` (n_at,): as it is if complete, else a spline's values."""
    return x if len(t) == len(at) else make_interp_spline(t, x, k=DEGREE)(at)


def fit(channels: list[Channel], spacing: float, at: np.ndarray) -> np.ndarray:
    """Value, first and second derivative (3, n_at) of the least-squares spline.

    Args:
        channels: (order of the derivative, t (n,), x (n,), standard deviation of its noise).
        spacing: of the knots [s].
        at: times (n_at,) [s].
    """
    start = min(t[0] for _, t, _, _ in channels)
    stop = max(t[-1] for _, t, _, _ in channels)
    intervals = max(1, int(np.ceil((stop - start) / spacing)))
    h = (stop - start) / intervals
    knots = start + h * np.arange(-DEGREE, intervals + DEGREE + 1)
    count = intervals + DEGREE
    normal = np.zeros((DEGREE + 1, count))  # lower bands of Σ BᵀB / σ²
    right = np.zeros(count)
    for order, t, x, sigma in channels:
        first, B = _design(t, start, h, intervals, order)
        B = B / sigma
        for i in range(DEGREE + 1):
            right += np.bincount(first + i, B[:, i] * (x / sigma), count)
            for k in range(DEGREE + 1 - i):
                normal[k] += np.bincount(first + i, B[:, i] * B[:, i + k], count)
    normal += BRIDGE * normal[0].max() * _roughness(count)
    spline = BSpline(knots, solveh_banded(normal, right, lower=True), DEGREE)
    return np.stack([spline(at, nu) for nu in range(3)])


def _roughness(count: int) -> np.ndarray:
    """Lower bands of DᵀD, D the third differences of the coefficients: what fills a few missing."""
    D = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((DEGREE + 1, count))
    for k in range(len(D)):
        for i in range(len(D) - k):
            bands[k, i : count - len(D) + 1 + i] += D[i] * D[i + k]
    return bands


def _design(
    t: np.ndarray, start: float, h: float, intervals: int, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """First basis function (n,) and the values (n, 6) of those that reach t, or a derivative's."""
    x = (t - start) / h
    first = np.clip(np.floor(x).astype(int), 0, intervals - 1)
    local = x - first
    # on its interval each basis function is a polynomial in the local time; all intervals are alike
    unit = np.eye(2 * DEGREE + 1)
    knots = np.arange(-DEGREE, DEGREE + 2, dtype=float)
    values = np.empty((len(t), DEGREE + 1))
    for k in range(DEGREE + 1):
        basis = BSpline(knots, unit[k, : DEGREE + 1], DEGREE)
        values[:, k] = basis(local, order) / h**order
    return first, values
