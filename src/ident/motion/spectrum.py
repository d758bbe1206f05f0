"""What the data say of noise and bandwidth, from which filter and smoothing are chosen."""

from __future__ import annotations

import numpy as np

ORDER = 6  # of the difference that leaves little but noise
POWER = 0.999  # share of the velocities' power that is the motion's
CLEAN = 1e-3  # share of noise below which a channel is taken as it is
VISIBLE = 200.0  # times the mean power of noise; real noise (quantised, jittering) is not white
ROWS_OVER_MOTION = 5.0  # cut-off of the rows' filter over the motion's bandwidth
ROWS_OVER_MOTION_LEAST = 2.0  # the same where accelerations are noisy
SMOOTH_OVER_MOTION = 10.0  # resolution of smoothing over the motion's bandwidth


def noise_level(x: np.ndarray) -> float:
    """Standard deviation of white noise in a smooth, uniformly sampled signal (n,).

    The 6th difference of a smooth signal is small, that of noise is large (√924 times the noise);
    a quantile of it makes rare jumps, such as friction at reversals, harmless, and is not zero
    where a quantised signal stands still for a while.
    """
    difference = np.diff(x, ORDER)
    if not len(difference):
        return 0.0
    gain = np.sqrt(924.0)  # Σ binomial(6, k)²
    return float(np.quantile(np.abs(difference), 0.8) / 1.2816 / gain)


def noise_share(x: np.ndarray) -> float:
    """Noise over the signal's standard deviation; 0 for a constant."""
    spread = float(np.std(x))
    return noise_level(x) / spread if spread > 0 else 0.0


def acceleration_noise_share(q: np.ndarray, dt: float) -> float:
    """Noise over signal of the second difference of q (n,), as it would be without smoothing."""
    a = np.diff(q, 2) / dt**2
    spread = float(np.std(a))
    return float(np.sqrt(6.0)) * noise_level(q) / dt**2 / spread if spread > 0 else 0.0


def motion_bandwidth(x: np.ndarray, dt: float, order: int = 0) -> float:
    """Frequency [Hz] below which 99.9 % of the power of the velocity lies.

    The noise's own share, measured in the upper half of the spectrum, is taken off first: what
    does not stand out of it by VISIBLE cannot be told from it.

    Args:
        x: (n,) position, velocity or acceleration; dt: its step [s]; order: which, 0, 1 or 2.
    """
    x = np.diff(x) / dt if order == 0 else x
    n = len(x)
    window = np.hanning(n)
    f = np.fft.rfftfreq(n, dt)
    power = np.abs(np.fft.rfft((x - x.mean()) * window)) ** 2
    # of white noise in the channel: differenced, as it is, or integrated
    shape = (2 * np.sin(np.pi * f * dt)) ** 2 if order == 0 else np.ones(len(f))
    noise = np.median(power[n // 4 :] / shape[n // 4 :]) / np.log(2) * shape
    power = np.where(power > VISIBLE * noise, power - noise, 0.0)
    if order == 2:
        power = power / np.maximum(2 * np.pi * f, 2 * np.pi * f[1]) ** 2
    total = np.cumsum(power)
    if total[-1] <= 0:
        return 0.0
    return float(f[min(np.searchsorted(total, POWER * total[-1]), n // 2)])


def acceleration_size(q: np.ndarray, dt: float, below: float) -> float:
    """rms of the second derivative of q (n,) below a frequency [Hz]."""
    n = len(q)
    window = np.hanning(n)
    x = (q - np.polyval(np.polyfit(np.arange(n), q, 1), np.arange(n))) * window
    f = np.fft.rfftfreq(n, dt)
    power = 2 * np.abs(np.fft.rfft(x)) ** 2 * (2 * np.pi * f) ** 4
    return float(np.sqrt(power[f <= below].sum() / n / (window**2).sum()))
