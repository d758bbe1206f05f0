"""Decisions made once for a log, which its portions and streams obey.

The cut-off of the rows' filter and the knots of smoothing follow from the bandwidth and the noise
that the logs show; the speeds below which joints stand still from their top speeds and their noise.
A part of a log that decided anew would differ from its neighbours, and from the log in one piece.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.errors import MotionError
from ident.information import linear
from ident.mechanism.mechanism import Mechanism
from ident.motion.signals import Clock, LogSignals
from ident.motion.spline import (
    acceleration_size,
    grain,
    is_white,
    motion_bandwidth,
    noise_level,
    noise_share,
)
from ident.motion.state import HOPELESS, State, largest_nearness, nearness

AUTO = "auto"
NEAREST = 0.1  # work: periods of a given cut-off between two knots: the least of automatic choices
CLEAN = 1e-3  # tuned: share of noise below which a channel is taken as it is
FILTERED_NOISE = 0.02  # tuned: share of noise in an acceleration that the filter may let pass
ROWS_OVER_MOTION = 5.0  # tuned: cut-off of the rows' filter over the motion's bandwidth
ROWS_OVER_MOTION_LEAST = 2.0  # tuned: the same where accelerations are noisy
SMOOTH_OVER_MOTION = 2.0 * ROWS_OVER_MOTION  # level: of splines: twice what the rows' filter passes
WHITE = 1 / 3  # tuned: of that resolution: differences over longer times may hold motion
STILL = 0.004  # tuned: share of a joint's top speed below which it counts as standing still
NOISE = 4.0  # level: or so many times the noise of speeds, where that is more
# level: noise that is this share of the top speed is all that moves the joint
STANDSTILL_NOISE = 0.5
LOOKED_AT = 500  # work: samples from which the closures' transmission is taken


@dataclass(frozen=True)
class Band:
    """Bandwidth and noise of a motion, and the filter that follows from them."""

    motion: float  # frequency below which 99.9 % of the velocities' power lies [Hz]
    noise: float  # largest share of noise found in a channel that the regression uses
    cutoff: float | None  # of the zero-phase filter on all columns [Hz]; None: nothing to filter
    knots: tuple[float, float] = (0.0, np.inf)  # spacings [s] between which smoothing may choose
    white: bool = False  # whether noise is white in all channels of the motion

    @property
    def resolved(self) -> float:
        """The spacing of knots [s] that resolves SMOOTH_OVER_MOTION times the motion."""
        return 1 / (2.0 * SMOOTH_OVER_MOTION * self.motion) if self.motion > 0 else 0.0


@dataclass(frozen=True, eq=False)
class Recipe:
    """Everything that is decided once of a log, and that its parts have in common."""

    clock: Clock
    noisy: tuple[str, ...] = ()  # joints that are smoothed
    carriers: tuple[str, ...] = ()  # of the splines, if others than `noisy`
    knots: float = 0.0  # their distance [s]; one is at the clock's first instant
    noise: Mapping[str, float] = field(default_factory=dict)  # of the smoothed channels, by column
    ends: float = 0.0  # time [s] at the ends of a run where splines are not to be trusted
    logged: tuple[str, ...] = ()  # joints that determine the motion
    independent: tuple[str, ...] = ()  # joints in which errors are compared
    band: Band = Band(0.0, 0.0, None)  # with the cut-off of the rows' filter
    smoothing: float | str | None = AUTO  # spacing of the knots [s] as asked for, "auto" or None
    still: np.ndarray | None = None  # (J,) speed below which a joint stands still [rad/s | m/s]
    farthest: np.ndarray | None = None  # (J, d) largest velocity transmission; None for a tree
    singular: float = HOPELESS  # ‖K⁺‖ from which on a sample is too near a singular position
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # torques end there


def band_of(
    logs: list[LogSignals],
    names: tuple[str, ...],
    given: float | str | None,
    informing: Sequence[Collection[str]],
) -> Band:
    """Bandwidth and noise of logs, and the given cut-off, or with AUTO what they suggest; of the
    torques those count that are `informing` in a log.

    The cut-off is five times the bandwidth of the motion, so that accelerations pass and what lies
    above (quantisation, ripple, vibration) does not, or less, down to twice, where accelerations
    would be noisy; where the channels are clean nothing is filtered.
    """
    # of each joint and log, order, series, step and grain of its channels
    joints = [
        [
            (k, *signals.even(column), grain(signals.log.series(column)[1]))
            for k, column in enumerate(f"{letter}.{name}" for letter in "qva")
            if column in signals.columns
        ]
        for signals in logs
        for name in names
    ]
    every = [channel for channels in joints for channel in channels]
    torques = [
        signals.even(f"tau.{name}")[0]
        for signals, of in zip(logs, informing, strict=True)
        for name in of
    ]
    noise = max(
        [noise_share(x, 2 - k) for channels in joints for k, x, *_ in channels[-1:]]
        + [noise_share(x) for x in torques]
    )
    motion, cutoff = _cutoff(joints)
    slow = [signals for signals in logs if cutoff >= 0.25 / signals.dt]
    filtered = noise > CLEAN and cutoff > 0.0 and len(slow) < len(logs)
    if filtered and slow and given == AUTO:
        first = slow[0]
        rest = [channels for i, channels in enumerate(joints) if logs[i // len(names)] not in slow]
        need = "that the other logs need; leave it out"
        if _cutoff(rest)[1] < 0.25 / first.dt:
            need = f"that its own motion of up to {motion:.3g} Hz needs; identify it by itself"
        raise MotionError(
            f"{first.log.name}: at {1 / first.dt:.4g} Hz it is too slow for the filter at "
            f"{cutoff:.3g} Hz {need}, or give a cut-off below {0.25 / first.dt:.3g} Hz"
        )
    band = Band(motion, noise, cutoff if filtered else None)
    white = noise > CLEAN and all(  # steps of an encoder repeat, however white they look
        step <= noise_level(x) and is_white(x, int(WHITE * band.resolved / dt))
        for _, x, dt, step in every
    )
    if given != AUTO:
        chosen = None if given is None else float(given)
        band = replace(band, cutoff=chosen, knots=(NEAREST / chosen if chosen else 0.0, np.inf))
    return replace(band, white=white)


def _cutoff(joints: list[list[tuple[int, np.ndarray, float, float]]]) -> tuple[float, float]:
    """Bandwidth of the motion of some joints and the cut-off [Hz] that suits it."""
    every = (channel for channels in joints for channel in channels)
    motion = max((motion_bandwidth(x, dt, k) for k, x, dt, _ in every), default=0.0)
    return motion, min(
        [ROWS_OVER_MOTION * motion, *(_calm_cutoff(channels, motion) for channels in joints)]
    )


def _calm_cutoff(channels: list[tuple[int, np.ndarray, float, float]], motion: float) -> float:
    """Cut-off [Hz] below which the acceleration of a logged joint holds little noise.

    White noise σ of the k-th derivative, seen in the acceleration below f, with j = 2 − k:
    σ_a² = σ² 2 dt (2π)^(2j) f^(2j+1) / (2j+1)      ≤ (FILTERED_NOISE · its rms)²
    """
    size = acceleration_size(*channels[0][1:3], motion)
    cutoff = ROWS_OVER_MOTION_LEAST * motion
    for k, x, step, _ in channels:
        j = 2 - k
        noise = noise_level(x) * (2 * np.pi) ** j * np.sqrt(2 * step / (2 * j + 1))
        calm = (FILTERED_NOISE * size / max(noise, 1e-12 * size, 1e-300)) ** (2 / (2 * j + 1))
        cutoff = max(cutoff, float(calm))
    return cutoff


def checked_cutoff(cutoff: float | str, measured: Sequence[LogSignals]) -> float:
    """A cut-off that is asked for [Hz], if these logs can be filtered at it."""
    value = _number(cutoff, f"cut-off {cutoff!r}; valid: a number [Hz], 'auto' or none")
    slowest = max(measured, key=lambda signals: signals.dt)
    nyquist = 0.5 / slowest.dt
    lowest = 1 / max(float(np.ptp(signals.t)) for signals in measured)
    if not lowest <= value < nyquist:
        raise MotionError(
            f"cut-off {value:g} Hz; valid: above {lowest:.3g} Hz, for which a log is long enough, "
            f"and below {nyquist:.4g} Hz, half the rate of {slowest.log.name}, or none"
        )
    return value


def checked_spacing(
    spacing: float | str | None, measured: Sequence[LogSignals]
) -> float | str | None:
    """A spacing of knots that is asked for [s], "auto" or None, if these logs can have it."""
    if spacing is None or spacing == AUTO:
        return spacing
    value = _number(spacing, f"smoothing {spacing!r}; valid: knots' spacing [s], 'auto' or none")
    finest = max(signals.dt for signals in measured)
    longest = min(float(np.ptp(signals.t)) for signals in measured) / 2
    if not finest <= value <= longest:
        raise MotionError(
            f"smoothing {value:g} s; valid: knots every {finest:.3g} s (one sample) to "
            f"{longest:.3g} s"
        )
    return value


def _number(given: float | str, problem: str) -> float:
    try:
        return float(given)
    except (TypeError, ValueError):
        raise MotionError(problem) from None


def standstill(
    mechanism: Mechanism, signals: LogSignals, e: State, names: tuple[str, ...]
) -> np.ndarray:
    """(J,) speeds below which joints stand still; one that moves by noise alone never moves.

    Noise of the logged joints `names` is in the others' speeds too, by the closures' transmission.
    """
    at = [mechanism.joint_index[name] for name in names]
    noise = np.array([NOISE * _speed_noise(signals, e, name) for name in names])
    sampled = e.leverage[np.flatnonzero(e.usable)[:: max(1, len(e) // LOOKED_AT)]]
    gain = sampled @ linear.pinv(sampled[:, at])
    return still_speeds(e, np.sqrt((gain**2).mean(axis=0) @ noise**2))


def still_speeds(e: State, noise: np.ndarray | float = 0.0) -> np.ndarray:
    """(J,) speeds of standstill, of top speeds and the speeds (J,) that noise feigns."""
    top = np.abs(e.yd[e.usable]).max(axis=0, initial=0.0)
    speed = np.maximum(STILL * top, noise)
    return np.maximum(np.where(speed < STANDSTILL_NOISE * top, speed, 1.01 * top), 1e-9)


def _speed_noise(signals: LogSignals, e: State, name: str) -> float:
    """Standard deviation of the noise left in the rate of a logged joint [rad/s | m/s].

    Splines with knots every h pass what lies below f = 1/(2 h). Of white noise in v that is the
    share 2 f dt of its power, of noise in q: σ_v² = σ_q² · 2 f dt · (2π f)² / 3.
    """
    if f"v.{name}" in signals.columns:
        v, dt = signals.even(f"v.{name}")
        share = min(1.0, dt / e.smooth.spacing) if e.smooth and name in e.smooth.names else 1.0
        return float(noise_level(v) * np.sqrt(share))
    q, dt = signals.even(f"q.{name}")
    f = 1 / (2 * (e.smooth.spacing if e.smooth else 2 * dt))
    return float(noise_level(q) * np.sqrt(2 * f * dt / 3) * 2 * np.pi * f)


def recipe_of(states: Sequence[State], band: Band, clock: Clock | None = None) -> Recipe:
    """The recipe that states of one machine have in common, by default on the first one's clock."""
    e = states[0]
    clock = clock or Clock(float(e.t[0]), 1 / e.rate, len(e), even=True)
    loops = [state for state in states if state.loop is not None]
    smooth = [state.smooth for state in states if state.smooth is not None]
    noisy = {c.column.partition(".")[2] for state in states for c in state.channels if c.spacing}
    channels = [channel for state in smooth for channel in state.channels]
    spacing = min((state.spacing for state in smooth), default=0.0)  # at rest coarser ones would do
    length = clock.t_end - clock.t0
    return Recipe(
        clock,
        noisy=tuple(name for name in e.logged if name in noisy),
        carriers=smooth[0].names if smooth else (),
        knots=length / np.ceil(length / spacing - 1e-9) if smooth else 0.0,
        noise={
            name: float(np.median([c.sigma for c in channels if c.column == name]))
            for name in dict.fromkeys(channel.column for channel in channels)
        },
        ends=max(state.ends for state in states),
        logged=e.logged,
        independent=e.independent,
        band=band,
        still=np.max([state.still for state in states], axis=0),
        farthest=np.max([np.abs(x.leverage[x.usable]).max(axis=0, initial=0.0) for x in loops], 0)
        if loops
        else None,
        singular=largest_nearness(np.concatenate([*map(nearness, loops)])) if loops else np.inf,
    )
