"""A torque channel that is a command and no measurement, by the signs that commands have."""

from __future__ import annotations

import re

import numpy as np

from ident.fit import Fit
from ident.health.channels import Channel, Channels
from ident.health.check import Check
from ident.motion import Experiment
from ident.motion.spectrum import noise_level, noise_share

HELD = 3.0  # samples that most values are held: a staircase of a slower controller
REGULAR = 0.8  # share of the steps of one and the same length
ZERO = 0.2  # share of the moving samples at which the torque is exactly zero
NOISELESS = 1e-3  # of the other channels' median share of noise: this one has none
NOISY = 1e-3  # share of noise from which the others count as measured
SAME = 1e-6  # of a channel's size, by which it may differ from a command and still be it
COMMAND = re.compile(
    r"(des|cmd|command|ref|set|target|goal|con)(ired|erence|point|trol)?[\W_\d]*", re.I
)


def commands(fit: Fit, data: Channels) -> list[Check]:
    """The signs of a command, for each torque channel and log; quiet ones are left out."""
    found = []
    by_log = {e.name: e for e in fit.motion.experiments}
    torques = data.of("tau")
    for channel in torques:
        e = by_log.get(channel.log)
        if e is None or float(np.ptp(channel.x)) == 0.0:
            continue
        peers = [c for c in torques if c.log == channel.log and c is not channel]
        others = [c for (log, _), c in data.others.items() if log == channel.log]
        for number, threshold, text, unit in (
            *_zero(fit, e, channel),
            *_staircase(channel),
            *_noiseless(channel, peers),
            *_copy(channel, others + peers),
        ):
            found.append(
                Check(
                    "command", (channel.name,), number, threshold, True,
                    f"{channel.log}: {text}: a command, not a measurement",
                    "give the measured torque or motor current instead: "
                    f'[log] "{channel.name}" = {{ column = …, scale = … }}',
                    unit,
                )
            )  # fmt: skip
    return found


Sign = tuple[float, float, str, str]


def _zero(fit: Fit, e: Experiment, channel: Channel) -> list[Sign]:
    """Exactly zero while the joint moves."""
    at = fit.mechanism.joint_index[channel.name.removeprefix("tau.")]
    speed = np.abs(np.interp(channel.t, e.t, e.yd[:, at]))
    moving = speed > max(float(e.still[at]), 0.1 * float(np.sqrt(np.mean(speed**2))))
    if moving.sum() < 20:
        return []
    share = float((channel.x[moving] == 0.0).mean())
    text = f"exactly zero in {100 * share:.0f} % of the samples at which the joint moves"
    return [(share, ZERO, text, "of moving samples")] if share > ZERO else []


def _staircase(channel: Channel) -> list[Sign]:
    """Held for the same number of samples again and again."""
    edges = np.flatnonzero(np.diff(channel.x) != 0)
    lengths = np.diff(edges)
    if len(lengths) < 10 or np.median(lengths) < HELD:
        return []
    usual = int(np.median(lengths))
    regular = float((np.abs(lengths - usual) <= 1).mean())
    if regular < REGULAR:  # a coarse sensor's steps are as long as the torque is flat
        return []
    text = f"held for {usual} samples at a time, as a slower controller does"
    return [(float(usual), HELD, text, "samples")]


def _noiseless(channel: Channel, peers: list[Channel]) -> list[Sign]:
    """No noise, where the other torques have it; a quantised one has that of its steps."""
    if not peers or channel.step > 0:
        return []
    theirs = float(np.median([noise_share(c.x) for c in peers]))
    own = noise_level(channel.x) / float(np.std(channel.x))
    if theirs < NOISY or own > NOISELESS * theirs:
        return []
    text = "not the least noise, while the other torques have it"
    return [(own / theirs, NOISELESS, text, "of the others' noise")]


def _copy(channel: Channel, others: list[Channel]) -> list[Sign]:
    """A constant times another column that is called a command, or another joint's torque."""
    for other in others:
        peer = other.name.startswith("tau.")
        if not (peer or COMMAND.search(other.name.replace(".", "_"))):
            continue
        if len(other.x) != len(channel.x) or float(np.ptp(other.x)) == 0.0:
            continue
        gain = float(channel.x @ other.x) / float(other.x @ other.x)
        off = float(np.linalg.norm(channel.x - gain * other.x) / np.linalg.norm(channel.x))
        if gain and off < SAME:
            times = "" if abs(gain - 1) < SAME else f"{gain:.4g} times "
            return [(off, SAME, f"it is {times}the column '{other.name}'", "difference")]
    return []
