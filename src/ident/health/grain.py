"""Quantisation: the step of a channel against its size, and what it does to accelerations.

step Δ of q:  σ_a = Δ/√12 · (2π f)² · √(2 f dt / 5)      white noise below the cut-off f
step Δ of v:  σ_a = Δ/√12 · 2π f · √(2 f dt / 3)
"""

from __future__ import annotations

import numpy as np

from ident.fit import Fit
from ident.health.channels import Channel, Channels
from ident.health.check import Check
from ident.motion.spectrum import ROWS_OVER_MOTION, noise_level

TORQUE = 0.01  # of the rms torque: a coarser step is an error that no model can explain
ACCELERATION = 0.1  # of the rms acceleration
OWN = 0.5  # share of a channel's noise that its steps must make for them to matter


def grains(fit: Fit, data: Channels) -> list[Check]:
    """The steps of all quantised channels, the coarsest of the logs for each."""
    worst: dict[str, Check] = {}
    for channel in [*data.of("tau"), *data.of("q"), *data.of("v")]:
        step = channel.step
        if not step:
            continue
        if channel.name.startswith("tau."):
            check: Check | None = _torque(fit, channel, step)
        else:
            check = _position(fit, data, channel, step)
        if check and (channel.name not in worst or check.number > worst[channel.name].number):
            worst[channel.name] = check
    return list(worst.values())


def _torque(fit: Fit, channel: Channel, step: float) -> Check:
    share = step / np.sqrt(12) / channel.rms
    unit = fit.mechanism.joint(channel.name.removeprefix("tau.")).force_unit
    bad = share > TORQUE
    text = f"{channel.log}: steps of {step:.3g} {unit}, {100 * share:.2g} % of the rms torque"
    return Check(
        "quantisation", (channel.name,), float(share), TORQUE, bad,
        text + (": a staircase; the error cannot fall below it" if bad else ""),
        "log the torque with more digits or a finer range", "of rms torque",
    )  # fmt: skip


def _position(fit: Fit, data: Channels, channel: Channel, step: float) -> Check | None:
    kind, joint = channel.name.split(".", 1)
    e = next((e for e in fit.motion.experiments if e.name == channel.log), None)
    if e is None:
        return None
    dt = float(np.median(np.diff(channel.t)))
    motion = fit.motion.band
    f = min(motion.cutoff or ROWS_OVER_MOTION * motion.motion, 0.5 / dt)
    power, digits = (2, 5) if kind == "q" else (1, 3)
    noise = step / np.sqrt(12) * (2 * np.pi * f) ** power * np.sqrt(2 * f * dt / digits)
    a = e.ydd[e.usable, fit.mechanism.joint_index[joint]]
    size = float(np.sqrt(np.mean(a**2)))
    share = float(noise / size) if size > 0 else np.inf
    own = step / np.sqrt(12) / max(noise_level(channel.x), 1e-300)
    finer = ("a", "v") if kind == "q" else ("a",)  # from which accelerations are rather had
    logged = any((e.name, f"{other}.{joint}") in data.found for other in finer)
    bad = share > ACCELERATION and own > OWN and not logged
    unit = fit.mechanism.joint(joint).unit + ("/s" if kind == "v" else "")
    text = (
        f"{channel.log}: steps of {step:.3g} {unit}, which make {100 * share:.2g} % noise in the "
        f"accelerations below {f:.3g} Hz"
    )
    return Check(
        "quantisation", (channel.name,), share, ACCELERATION, bad, text,
        "lower --cutoff, move faster, or log velocities too", "of rms acceleration",
    )  # fmt: skip
