"""What the record itself says: dead channels, noise instead of torque, jitter, gaps, repairs."""

from __future__ import annotations

import re

import numpy as np

from ident.fit import Fit
from ident.health.channels import Channel, Channels
from ident.health.check import Check
from ident.motion.spectrum import noise_level

NOISE = 0.7  # noise over rms from which a torque channel is noise and no torque
JITTER = 0.1  # of a step, rms: information below and above, since stamps are taken as they are
REPAIRS = re.compile(r"jitter|uneven|no sample|empty|repeated|left out|interpolat|gap|repair|back")


def dead(fit: Fit, data: Channels) -> list[Check]:
    """Channels that never change, and torques that are noise alone."""
    by_log = {e.name: e for e in fit.motion.experiments}
    surplus = len(fit.mechanism.driven) > len(fit.motion.independent)
    found = []
    for channel in [*data.of("tau"), *data.of("q")]:
        e = by_log.get(channel.log)
        kind, joint = channel.name.split(".", 1)
        if e is None:
            continue
        moves = float(np.ptp(e.y[e.usable, fit.mechanism.joint_index[joint]])) > 0
        spread = float(np.ptp(channel.x))
        if spread == 0.0 and kind == "tau" and moves and joint in fit.mechanism.driven:
            found.append(_constant(channel, surplus and not channel.x.any()))
        elif spread == 0.0 and kind == "q":
            text = f"{channel.log}: never changes: the joint is locked, or its encoder is"
            found.append(Check("dead", (channel.name,), 0.0, 0.0, False, text))
        elif kind == "tau" and channel.rms > 0:
            share = noise_level(channel.x) / channel.rms
            if share > NOISE:
                found.append(_noise(channel, joint, share))
    return found


def _constant(channel: Channel, idle: bool) -> Check:
    """`idle`: a drive that others could do without may be off, and its torque zero."""
    text = f"{channel.log}: always {channel.x[0]:.4g} while the joint moves: " + (
        "a motor that is off, or no measurement" if idle else "no measurement"
    )
    joint = channel.name.removeprefix("tau.")
    return Check(
        "dead", (channel.name,), 0.0, 0.0, not idle, text,
        f"map the right column in [log], or put '{joint}' among the passive joints",
    )  # fmt: skip


def _noise(channel: Channel, joint: str, share: float) -> Check:
    text = (
        f"{channel.log}: {100 * share:.0f} % of its rms is noise of the sensor: the motor does "
        "nothing there, and its relative error says nothing"
    )
    return Check(
        "noise only", (channel.name,), share, NOISE, True, text,
        f"put '{joint}' among the passive joints for this log, friction kept as an effect",
        "of rms torque",
    )  # fmt: skip


def clock(data: Channels) -> list[Check]:
    """Jitter and gaps of the logs' time stamps, as information."""
    found = []
    for log in data.logs:
        step = 1 / log.rate
        share = log.jitter[1] / step
        if share > 1e-6:
            text = f"{log.name}: steps of {1e3 * step:.3g} ms ± {100 * share:.2g} % rms"
            found.append(Check("jitter", ("t",), share, JITTER, False, text, unit="of a step"))
        if log.gaps():
            longest = max(b - a for a, b in log.gaps())
            text = f"{log.name}: {len(log.gaps())} gap(s), the longest {longest:.3g} s"
            found.append(Check("gaps", ("t",), float(len(log.gaps())), np.nan, False, text))
    return found


def repairs(fit: Fit) -> list[Check]:
    """What was repaired or left out on the way, as information."""
    return [
        Check("repair", (), np.nan, np.nan, False, note)
        for note in fit.motion.notes
        if REPAIRS.search(note) and "spline" not in note
    ]
