"""The speeds below which joints stand still, where dry friction is open."""

from __future__ import annotations

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.motion.measure import Signals
from ident.motion.motion import Experiment
from ident.motion.spectrum import noise_level

STILL = 0.004  # share of a joint's top speed below which it counts as standing still
NOISE = 4.0  # or so many times the noise of speeds, where that is more
HARDLY = 0.5  # noise that reaches this share of the top speed is all that moves the joint
LOOKED_AT = 500  # samples from which the closures' leverage is taken


def standstill(
    mechanism: Mechanism, signals: Signals, e: Experiment, names: tuple[str, ...]
) -> np.ndarray:
    """(J,) speeds below which joints stand still; one that moves by noise alone never moves.

    The noise of a logged joint's speed reaches the others through the closures, by how fast they
    move for a unit of its rate.
    """
    return thresholds(top_speeds(e), noise_of_speeds(mechanism, signals, e, names))


def top_speeds(e: Experiment) -> np.ndarray:
    """(J,) of the usable samples [rad/s | m/s]."""
    return np.asarray(np.abs(e.yd[e.usable]).max(axis=0, initial=0.0))


def noise_of_speeds(
    mechanism: Mechanism, signals: Signals, e: Experiment, names: tuple[str, ...]
) -> np.ndarray:
    """(J,) speeds that noise of the logged joints can feign."""
    at = [mechanism.joint_index[name] for name in names]
    noise = np.array([NOISE * speed_noise(signals, e, name) for name in names])
    if e.leverage is None:
        reached = np.zeros(e.yd.shape[1])
        reached[at] = noise
        return reached
    some = e.leverage[e.usable][:: max(1, len(e) // LOOKED_AT)]
    gain = some @ np.linalg.pinv(some[:, at])
    return np.asarray(np.sqrt((gain**2).mean(axis=0) @ noise**2))


def thresholds(top: np.ndarray, reached: np.ndarray) -> np.ndarray:
    """(J,) speeds of standstill from top speeds and what noise reaches, both (J,)."""
    speed = np.maximum(STILL * top, reached)
    return np.maximum(np.where(speed < HARDLY * top, speed, 1.01 * top), 1e-9)


def speed_noise(signals: Signals, e: Experiment, name: str) -> float:
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
