"""q, v and a of the joints that determine the motion, from whatever was logged of them."""

from __future__ import annotations

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.motion.measure import Signals
from ident.motion.motion import Band
from ident.motion.smooth import fit, interpolate
from ident.motion.spectrum import (
    CLEAN,
    ROWS_OVER_MOTION,
    SMOOTH_OVER_MOTION,
    acceleration_noise_share,
    motion_bandwidth,
    noise_level,
    noise_share,
)


def band_of(mechanism: Mechanism, logs: list[Signals], names: tuple[str, ...]) -> Band:
    """Bandwidth, noise and cut-off that the logs themselves suggest.

    The cut-off is five times the bandwidth of the motion, so that accelerations pass and what lies
    above (quantisation, ripple, vibration) does not; where the channels are clean nothing is
    filtered, as is right for simulated logs.
    """
    motion, noise = 0.0, 0.0
    for signals in logs:
        columns, dt = signals.columns, signals.dt
        for name in names:
            q = columns[f"q.{name}"]
            motion = max(motion, motion_bandwidth(q, dt))
            if f"a.{name}" in columns:
                noise = max(noise, noise_share(columns[f"a.{name}"]))
            elif f"v.{name}" in columns:
                noise = max(noise, noise_share(np.diff(columns[f"v.{name}"])))
            else:
                noise = max(noise, acceleration_noise_share(q, dt))
        for name in mechanism.driven:
            if f"tau.{name}" in columns:
                noise = max(noise, noise_share(columns[f"tau.{name}"]))
    nyquist = min(0.5 / signals.dt for signals in logs)
    cutoff = ROWS_OVER_MOTION * motion
    filtered = noise > CLEAN and 0.0 < cutoff < 0.5 * nyquist
    return Band(motion, noise, cutoff if filtered else None)


def speed_noise(signals: Signals, name: str, band: Band) -> float:
    """Standard deviation of the noise left in the rate of a logged joint [rad/s | m/s]."""
    if f"v.{name}" in signals.columns:
        return noise_level(signals.columns[f"v.{name}"])
    # white noise in q below the smoothing's cut-off f: σ_v² = σ_q² · 2 f dt · (2π f)² / 3
    f = 1 / (2 * _spacing(signals, band, 1))
    sigma = noise_level(signals.columns[f"q.{name}"])
    return float(sigma * np.sqrt(2 * f * signals.dt / 3) * 2 * np.pi * f)


def _spacing(signals: Signals, band: Band, channels: int) -> float:
    """Knots [s] that resolve twice the rows' cut-off, where there is one."""
    wanted = ROWS_OVER_MOTION / (2.0 * SMOOTH_OVER_MOTION * band.cutoff) if band.cutoff else 0.0
    return max(wanted, (1.0 if channels > 1 else 2.0) * signals.dt)


def derive(signals: Signals, name: str, band: Band) -> tuple[np.ndarray, str]:
    """Coordinate, rate and acceleration (3, n) of a logged joint, and how they were had."""
    columns, t = signals.columns, signals.t
    present = [column for column in ("q", "v", "a") if f"{column}.{name}" in columns]
    if present == ["q", "v", "a"] and signals.exact:
        return np.stack([columns[f"{column}.{name}"] for column in present]), ""
    channels = []
    clean = True
    for order, column in enumerate(("q", "v", "a")):
        if column not in present:
            continue
        at, x = signals.log.series(f"{column}.{name}")
        sigma = noise_level(columns[f"{column}.{name}"])
        clean &= sigma <= CLEAN * 1e-3 * float(np.std(x))
        channels.append((order, at, x, max(sigma, 1e-9 * float(np.std(x)), 1e-300)))
    if clean and present == ["q"] and band.cutoff is None:
        _, at, x, _ = channels[0]
        return interpolate(at, x, t), f"{name}: v and a by quintic interpolation of q"
    spacing = _spacing(signals, band, len(channels))
    what = " and ".join(present)
    missing = " and ".join(c for c in ("v", "a") if c not in present) or "all three"
    return fit(channels, spacing, t), (
        f"{name}: {missing} from a quintic spline through {what}, knots {1e3 * spacing:.3g} ms"
    )
