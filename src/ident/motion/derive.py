"""q, v and a of the joints that determine the motion, from whatever was logged of them."""

from __future__ import annotations

import numpy as np

from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.motion.clock import runs
from ident.motion.measure import Signals
from ident.motion.motion import Band
from ident.motion.smooth import Channel, filled, fit, interpolate
from ident.motion.spectrum import (
    CLEAN,
    ROWS_OVER_MOTION,
    ROWS_OVER_MOTION_LEAST,
    SMOOTH_OVER_MOTION,
    acceleration_noise_share,
    acceleration_size,
    motion_bandwidth,
    noise_level,
    noise_share,
)

QUIET = 0.02  # share of noise in an acceleration that the filter may let pass
ENDS = 2.0  # knots at either end of a run between which a spline is not to be trusted


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
            motion = max(motion, motion_bandwidth(q, dt))
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


def speed_noise(signals: Signals, name: str, band: Band) -> float:
    """Standard deviation of the noise left in the rate of a logged joint [rad/s | m/s]."""
    if f"v.{name}" in signals.columns:
        return noise_level(signals.even(f"v.{name}")[0])
    # white noise in q below the smoothing's cut-off f: σ_v² = σ_q² · 2 f dt · (2π f)² / 3
    q, dt = signals.even(f"q.{name}")
    f = 1 / (2 * _spacing(dt, band, 1))
    return float(noise_level(q) * np.sqrt(2 * f * dt / 3) * 2 * np.pi * f)


def _spacing(dt: float, band: Band, channels: int) -> float:
    """Knots [s] that resolve twice the rows' cut-off, where there is one."""
    wanted = ROWS_OVER_MOTION / (2.0 * SMOOTH_OVER_MOTION * band.cutoff) if band.cutoff else 0.0
    return max(wanted, (1.0 if channels > 1 else 2.0) * dt)


def derive(signals: Signals, name: str, band: Band) -> tuple[np.ndarray, str, float]:
    """Coordinate, rate and acceleration (3, n) of a logged joint, how they were had, and ends.

    Ends [s] are where a fitted spline has data on one side only and its accelerations are poor.

    Every run between gaps has a spline of its own. Inside gaps the coordinate goes straight from
    one side to the other, for the closures to be followed; those samples take no part.
    """
    present = [c for c in ("q", "v", "a") if f"{c}.{name}" in signals.columns]
    columns = [f"{c}.{name}" for c in present]
    whole = present == ["q", "v", "a"] and signals.exact
    channels, steps, clean = [], [], True
    for order, column in zip(("qva".index(c) for c in present), columns, strict=True):
        at, x = signals.log.series(column)
        even, step = signals.even(column)
        sigma, spread = noise_level(even), float(np.std(x))
        clean &= sigma <= CLEAN * 1e-3 * spread
        steps.append(step)
        channels.append((order, at, x, max(sigma, 1e-9 * spread, 1e-300)))
    t, spacing = signals.t, _spacing(min(steps), band, len(channels))
    through = clean and present == ["q"] and band.cutoff is None
    found = np.zeros((3, len(t)))
    for run in runs(signals.usable):
        inside = [_within(channel, t[run], signals.dt) for channel in channels]
        if whole:  # as logged, but for a few empty cells
            found[:, run] = [filled(at, x, t[run]) for _, at, x, _ in inside]
        elif through:
            found[:, run] = interpolate(inside[0][1], inside[0][2], t[run])
        else:
            found[:, run] = fit(inside, spacing, t[run])
    gap = ~signals.usable
    found[0, gap] = np.interp(t[gap], t[~gap], found[0, ~gap])
    if whole:
        return found, "", 0.0
    if through:
        return found, "v and a by quintic interpolation of q", 0.0
    missing = " and ".join(c for c in ("v", "a") if c not in present) or "all three"
    how = (
        f"{missing} from a quintic spline through {' and '.join(present)}, "
        f"knots {1e3 * spacing:.3g} ms"
    )
    return found, how, 0.0 if "a" in present else ENDS * spacing


def _within(channel: Channel, t: np.ndarray, dt: float) -> Channel:
    """A channel's samples of one run."""
    order, at, x, sigma = channel
    inside = (at > t[0] - 0.75 * dt) & (at < t[-1] + 0.75 * dt)
    return order, at[inside], x[inside], sigma
