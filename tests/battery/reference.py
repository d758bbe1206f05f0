"""What the driven joints shall do: a finite Fourier series that runs slow and fast in turns."""

from __future__ import annotations

import numpy as np
from rigid import Machine
from simulate import BEFORE, Reference

SECONDS = 9.0  # of a log
HARMONICS = 5
FUNDAMENTAL = 2 * np.pi / 8.0  # [rad/s]


def reference(machine: Machine, seed: int, experiment: int, seconds: float = SECONDS) -> Reference:
    """Seeded; scaled to the joint's reach or top speed, whichever it meets first."""
    t = np.arange(round((seconds + BEFORE) / machine.step) + 1) * machine.step - BEFORE
    rng = np.random.default_rng([3, seed, experiment])
    # s(t) runs at 0.2 to 1.8 of the clock: slow parts show friction at low speed
    w, phase = 2 * np.pi / 4.5, rng.uniform(0, 2 * np.pi)
    s = t + 0.8 / w * np.sin(w * t + phase)
    ds, dds = 1 + 0.8 * np.cos(w * t + phase), -0.8 * w * np.sin(w * t + phase)
    q, v, a = (np.zeros((len(t), len(machine.ranges))) for _ in range(3))
    for k, limit in enumerate(machine.ranges.values()):
        turning = limit.reach > np.pi  # whole turns want long strokes
        base = FUNDAMENTAL / 1.5 if turning else FUNDAMENTAL
        for n in range(1, (3 if turning else HARMONICS) + 1):
            x, y = rng.normal(size=2) / (n**2.5 if turning else n**0.7)
            arg = n * base * s
            wave, slope = x * np.sin(arg) + y * np.cos(arg), x * np.cos(arg) - y * np.sin(arg)
            rate = n * base
            q[:, k] += wave
            v[:, k] += rate * slope * ds
            a[:, k] += rate * slope * dds - rate**2 * wave * ds**2
        middle = (q[:, k].max() + q[:, k].min()) / 2
        scale = min(
            limit.reach / np.abs(q[:, k] - middle).max(), limit.speed / np.abs(v[:, k]).max()
        )
        q[:, k] = limit.centre + scale * (q[:, k] - middle)
        v[:, k] *= scale
        a[:, k] *= scale
    return Reference(q, v, a)
