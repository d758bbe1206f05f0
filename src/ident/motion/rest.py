"""The speeds below which joints stand still, where dry friction is open."""

from __future__ import annotations

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.motion.derive import speed_noise
from ident.motion.measure import Signals
from ident.motion.motion import Band, Experiment

STILL = 0.004  # share of a joint's top speed below which it counts as standing still
NOISE = 4.0  # or so many times the noise of speeds, where that is more
HARDLY = 0.5  # noise that reaches this share of the top speed is all that moves the joint
LOOKED_AT = 500  # samples from which the closures' leverage is taken


def standstill(
    mechanism: Mechanism, signals: Signals, e: Experiment, names: tuple[str, ...], band: Band
) -> np.ndarray:
    """(J,) speeds below which joints stand still; one that moves by noise alone never moves.

    The noise of a logged joint's speed reaches the others through the closures, by how fast they
    move for a unit of its rate.
    """
    top = np.abs(e.yd[e.usable]).max(axis=0, initial=0.0)
    at = [mechanism.joint_index[name] for name in names]
    noise = np.array([NOISE * speed_noise(signals, name, band) for name in names])
    if e.leverage is None:
        reached = np.zeros(len(top))
        reached[at] = noise
    else:
        some = e.leverage[e.usable][:: max(1, len(e) // LOOKED_AT)]
        gain = some @ np.linalg.pinv(some[:, at])
        reached = np.sqrt((gain**2).mean(axis=0) @ noise**2)
    speed = np.maximum(STILL * top, reached)
    return np.maximum(np.where(speed < HARDLY * top, speed, 1.01 * top), 1e-9)
