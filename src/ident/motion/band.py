"""What the logs themselves suggest: bandwidth, noise, and the cut-off of the rows' filter."""

from __future__ import annotations

import numpy as np

from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.motion.measure import Signals
from ident.motion.motion import Band
from ident.motion.spectrum import (
    CLEAN,
    ROWS_OVER_MOTION,
    ROWS_OVER_MOTION_LEAST,
    acceleration_noise_share,
    acceleration_size,
    motion_bandwidth,
    noise_level,
    noise_share,
)

QUIET = 0.02  # share of noise in an acceleration that the filter may let pass


def band_of(mechanism: Mechanism, logs: list[Signals], names: tuple[str, ...]) -> Band:
    """Bandwidth, noise and cut-off that the logs themselves suggest.

    The cut-off is five times the bandwidth of the motion, so that accelerations pass and what lies
    above (quantisation, ripple, vibration) does not, or less, down to twice, where accelerations
    would be noisy; where the channels are clean nothing is filtered, as is right for simulated
    logs.

    Raises:
        MotionError: if one log is too slow for the filter that the others need.
    """
    motion, noise = 0.0, 0.0
    for signals in logs:
        for name in names:
            q, dt = signals.even(f"q.{name}")
            motion = max(motion, *(_bandwidth(signals, name, order) for order in range(3)))
            if f"a.{name}" in signals.columns:
                noise = max(noise, noise_share(signals.even(f"a.{name}")[0]))
            elif f"v.{name}" in signals.columns:
                noise = max(noise, noise_share(np.diff(signals.even(f"v.{name}")[0])))
            else:
                noise = max(noise, acceleration_noise_share(q, dt))
        for name in mechanism.driven:
            if f"tau.{name}" in signals.columns:
                noise = max(noise, noise_share(signals.even(f"tau.{name}")[0]))
    cutoff = min(
        [ROWS_OVER_MOTION * motion]
        + [_quiet_cutoff(signals, name, motion) for signals in logs for name in names]
    )
    slow = [signals for signals in logs if cutoff >= 0.25 / signals.dt]
    filtered = noise > CLEAN and cutoff > 0.0 and len(slow) < len(logs)
    if filtered and slow:
        raise MotionError(
            f"{slow[0].log.name}: at {1 / slow[0].dt:.4g} Hz it is too slow for the filter at "
            f"{cutoff:.3g} Hz that the other logs need; leave it out, or give a cut-off"
        )
    return Band(motion, noise, cutoff if filtered else None)


def _bandwidth(signals: Signals, name: str, order: int) -> float:
    """Of the motion [Hz], as one of a joint's channels shows it; 0 where there is none."""
    column = f"{'qva'[order]}.{name}"
    return motion_bandwidth(*signals.even(column), order) if column in signals.columns else 0.0


def _quiet_cutoff(signals: Signals, name: str, motion: float) -> float:
    """Cut-off [Hz] below which the acceleration of a logged joint holds little noise.

    White noise σ of the k-th derivative, seen in the acceleration below f, with j = 2 − k:
    σ_a² = σ² 2 dt (2π)^(2j) f^(2j+1) / (2j+1)      ≤ (QUIET · its rms)²
    """
    q, dt = signals.even(f"q.{name}")
    size = acceleration_size(q, dt, motion)
    lowest = ROWS_OVER_MOTION_LEAST * motion
    best = 0.0
    for k, channel in enumerate("qva"):
        if f"{channel}.{name}" not in signals.columns:
            continue
        x, step = signals.even(f"{channel}.{name}")
        j = 2 - k
        noise = noise_level(x) * (2 * np.pi) ** j * np.sqrt(2 * step / (2 * j + 1))
        best = max(best, (QUIET * size / max(noise, 1e-12 * size, 1e-300)) ** (2 / (2 * j + 1)))
    return float(max(best, lowest))
