"""Curves between two positions: mixtures of sines, and strokes of constant speed.

y = c + h m(w t)        m: three sines of unrelated frequencies, or strokes with rounded ends
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid

WAVES = ((1.0, 0.62, 0.3), (1.73, 0.3, 1.1), (2.91, 0.16, 2.3))  # frequency, share, phase
CORNER = 8.0  # steepness of a stroke's ends
Series = tuple[np.ndarray, np.ndarray, np.ndarray]  # y, ẏ, ÿ, each (n,)


def sines(low: float, high: float, speed: float, t: np.ndarray, pitch: float = 1.0) -> Series:
    """y, ẏ, ÿ (n,) between low and high, at up to `speed`."""
    fine = np.linspace(0.0, 60.0, 6001)
    shape, slope, _ = _waves(fine, pitch)
    h = (high - low) / (shape.max() - shape.min())
    w = speed / (h * np.abs(slope).max())
    m0, m1, m2 = _waves(w * t, pitch)
    return low + h * (m0 - shape.min()), h * w * m1, h * w**2 * m2


def _waves(x: np.ndarray, pitch: float) -> Series:
    parts = [(f * pitch, a, f * pitch * x + p) for f, a, p in WAVES]
    return (
        sum((a * np.sin(z) for _, a, z in parts), np.zeros_like(x)),
        sum((a * f * np.cos(z) for f, a, z in parts), np.zeros_like(x)),
        sum((-a * f**2 * np.sin(z) for f, a, z in parts), np.zeros_like(x)),
    )


def strokes(low: float, high: float, speed: float, t: np.ndarray, pitch: float = 1.0) -> Series:
    """y, ẏ, ÿ (n,) to and fro at constant speed, rounded at the ends."""
    w = pitch * speed * np.pi / (high - low)
    fine = np.linspace(0.0, 2 * np.pi, 4001)
    way = cumulative_trapezoid(np.tanh(CORNER * np.sin(fine)), fine, initial=0.0)
    h = (high - low) / way.max()
    shape = np.tanh(CORNER * np.sin(w * t))
    bend = CORNER * np.cos(w * t) * (1 - shape**2)
    y = low + h * np.interp(np.mod(w * t, 2 * np.pi), fine, way)
    return y, h * w * shape, h * w**2 * bend
