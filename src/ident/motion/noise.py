"""Noise, quantisation and bandwidth of one uniformly sampled signal."""

from __future__ import annotations

from math import comb

import numpy as np

from ident.information.chance import LOUD

ORDER = 6  # numerics: of the difference that leaves little but noise
POWER = 0.999  # range: share of the velocities' power that is the motion's
VISIBLE = 200.0  # tuned: times the mean power of noise; real noise (steps, jitter) is not white
# numerics: neighbouring frequencies over which that is the mean, twice the width of a line under
# the window: a lone one is a vibration or the mains; a motion's lines are thousands of times larger
NEIGHBOURS = 9
LARGEST = 1e30  # numerics: ratio where there is no noise at all
GRAINS = 20  # work: changes of a signal from which its quantisation can be known
MOST = 1000.0  # numerics: steps between two samples beyond which multiples are no sign of anything


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


def is_white(x: np.ndarray, longest: int) -> bool:
    """Whether the noise of a smooth signal (n,) is the same in differences over 1, 2, 4, …, up to
    `longest` samples, as white noise is; false where there are not two of them.

    Medians: what few samples feel, such as friction at reversals, is no noise.
    """
    sizes, k = [], 1
    while k <= longest and len(x) > ORDER * k:
        difference = x
        for _ in range(ORDER):
            difference = difference[k:] - difference[:-k]
        sizes.append(float(np.median(np.abs(difference))))
        k *= 2
    return len(sizes) > 1 and max(sizes) < LOUD * sizes[0]


def noise_share(x: np.ndarray, differences: int = 0) -> float:
    """Noise over signal in differences of x (n,), as they would be without smoothing; 0 for a
    constant.
    """
    spread = float(np.std(np.diff(x, differences)))
    gain = np.sqrt(float(comb(2 * differences, differences)))
    return gain * noise_level(x) / spread if spread > 0 else 0.0


def motion_bandwidth(x: np.ndarray, dt: float, order: int = 0) -> float:
    """Frequency [Hz] below which 99.9 % of the power of the velocity lies.

    The noise's own share, measured in the upper half of the spectrum, is taken off first: what
    does not stand out of it by VISIBLE, alone and with its NEIGHBOURS, cannot be told from it.
    x (n,) of step dt [s] is the position (order 0), velocity (1) or acceleration (2).
    """
    x = np.diff(x) / dt if order == 0 else x
    n = len(x)
    f = np.fft.rfftfreq(n, dt)
    power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(n))) ** 2
    # of white noise in the channel: differenced, as it is, or integrated
    shape = (2 * np.sin(np.pi * f * dt)) ** 2 if order == 0 else np.ones(len(f))
    high = slice(max(n // 4, 1), None)
    noise = np.median(power[high] / shape[high]) / np.log(2) * shape
    ratio = np.divide(power, noise, out=np.where(power > 0, LARGEST, 0.0), where=noise > 0)
    ratio[0] = ratio[min(1, len(f) - 1)]  # differenced noise has none at f = 0
    width = min(NEIGHBOURS, len(f))
    together = np.convolve(np.minimum(ratio, LARGEST), np.full(width, 1 / width), "same")
    power = np.where(np.minimum(ratio, together) > VISIBLE, power - noise, 0.0)
    if order == 2:
        power = power / np.maximum(2 * np.pi * f, 2 * np.pi * f[1]) ** 2
    total = np.cumsum(power)
    if total[-1] <= 0:
        return 0.0
    return float(f[min(np.searchsorted(total, POWER * total[-1]), n // 2)])


def acceleration_size(q: np.ndarray, dt: float, below: float) -> float:
    """rms of the second derivative of q (n,) below a frequency [Hz]."""
    n, window = len(q), np.hanning(len(q))
    x = (q - np.polyval(np.polyfit(np.arange(n), q, 1), np.arange(n))) * window
    f = np.fft.rfftfreq(n, dt)
    power = 2 * np.abs(np.fft.rfft(x)) ** 2 * (2 * np.pi * f) ** 4
    return float(np.sqrt(power[f <= below].sum() / n / (window**2).sum()))


def grain(x: np.ndarray) -> float:
    """The step of a signal (n,) that only takes multiples of one; 0 for others."""
    steps = np.abs(np.diff(x))
    stays = steps == 0
    again = np.count_nonzero(stays[1:] & ~stays[:-1]) >= GRAINS
    steps = steps[~stays]
    if len(steps) < GRAINS or steps.min() * MOST < steps.max():
        return 0.0
    off = steps / steps.min()
    whole = np.round(off)
    multiples = (np.abs(off - whole) < 0.01 * off).all()
    # a ramp has one step, too, but does not stay at its values again and again
    return float(steps.min()) if multiples and (again or np.ptp(whole) > 0) else 0.0
