"""What a torque channel is: a measurement, a command, a model's own number, or nothing.

Decided once by the samples of the channel and of the others in its log, and asked by knots, the
cut-off, checks, candidates and laws alike; by the equations in `torque_models`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ident.log.remember import once_a_series
from ident.mechanism.mechanism import Mechanism
from ident.motion.recipe import CLEAN
from ident.motion.signals import REGULAR
from ident.motion.spline import grain, noise_level, noise_share

NOISE = 0.5**0.5  # level: noise over rms: from half of its squares on a torque is no torque
ZERO = 0.2  # tuned: share of the samples at which a joint moves, where its torque is exactly zero
# range: samples for which most values stay: a staircase of a slower controller
STAIRCASE_SAMPLES = 2
ALWAYS = 0.98  # tuned: share of pairs from which rows are repeated: a slow channel repeats some
SHORTEST = 20  # work: samples of a channel that can be judged
SAME = 1e-6  # numerics: of a channel's size, by which it may differ from a command and still be it
LEVELS = 3  # range: values of a command that switches: forward, off, backward
SWITCHED_SHARE = 0.98  # range: share of the samples that have one of them
LEVEL_SHARE = 0.05  # range: share of the samples that each of two of them has at least
FEWEST_SWITCHES = 4  # range: changes from one to another
MOVING = 0.1  # range: of a joint's rms speed, from which it moves well above standstill
COMMAND = re.compile(
    r"(des|cmd|command|ref|set|target|goal|con)(ired|erence|point|trol)?[\W_\d]*", re.I
)


class TorqueClass(StrEnum):
    """What the numbers of a torque channel are."""

    MEASURED = "measured"
    COMMANDED = "commanded"  # what a controller asked for: as good as the drive follows it
    COMPUTED = "computed"  # by the model of a controller or a simulator
    COMPENSATED = "compensated"  # measured less gravity or friction of a model
    FREE = "free"  # zero all the time: the joint swings, or nothing is logged
    DEAD = "dead"  # nothing


@dataclass(frozen=True)
class TorqueVerdict:
    """The class of a channel with what decided it.

    Attributes:
        kind: the class; cause: the check that decided it, "" for a measurement.
        number, threshold: of that check; column: of which it is a multiple.
        levels: the values [N m | N] of a command that switches.
    """

    kind: TorqueClass = TorqueClass.MEASURED
    cause: str = ""
    number: float = 0.0
    threshold: float = 0.0
    column: str = ""
    levels: tuple[float, ...] = ()

    @property
    def measured(self) -> bool:
        """Whether the channel says what acted, as far as is known."""
        return self.kind in (TorqueClass.MEASURED, TorqueClass.FREE)

    @property
    def informs(self) -> bool:
        """Whether knots and cut-off ask it; zero all the time is no signal, or a free swing."""
        return self.kind not in (TorqueClass.DEAD, TorqueClass.FREE)


MEASURED = TorqueVerdict()


def torque_verdict(
    name: str,
    x: np.ndarray,
    moving: np.ndarray,
    columns: Mapping[str, np.ndarray],
    used: Collection[str] = (),
) -> TorqueVerdict:
    """Judge the samples of a torque channel.

    Args:
        name: of the channel; x: (n,) its samples [N m | N].
        moving: (n,) whether the joint moves.
        columns: of its log, by name; those of other length than x are not compared.
        used: columns of the file that are channels of a joint, and so no commands.
    """
    if len(x) <= SHORTEST or not moving.any():
        return MEASURED
    dead, commanded = TorqueClass.DEAD, TorqueClass.COMMANDED
    if not np.ptp(x):
        return TorqueVerdict(dead if x[0] else TorqueClass.FREE, "constant")
    if levels := switched_levels(x):
        return TorqueVerdict(commanded, "switched", len(levels), LEVELS, levels=levels)
    if (copy := _multiple_of(name, x, columns, used)) is not None:
        return copy
    if (steps := held_samples(x)) is not None:
        return TorqueVerdict(commanded, "staircase", steps, STAIRCASE_SAMPLES)
    if (share := float((x[moving] == 0).mean())) > ZERO:
        return TorqueVerdict(commanded, "zero", share, ZERO)
    if (share := noise_level(x) / float(np.sqrt(np.mean(x**2)))) > NOISE:
        return TorqueVerdict(dead, "noise_only", share, NOISE)
    if (less := _less_noise_than_others(name, x, columns)) is not None:
        return TorqueVerdict(commanded, "noiseless", less, CLEAN)
    return MEASURED


def is_compared(name: str) -> bool:
    """Return whether a torque may be a multiple of a column, by its name."""
    return name.startswith("tau.") or bool(COMMAND.search(name.replace(".", "_")))


@once_a_series
def switched_levels(x: np.ndarray) -> tuple[float, ...]:
    """Return the few values between which a command switches; () for any other signal (n,)."""
    n = len(x)
    most_others = (1 - SWITCHED_SHARE) * n  # samples that may have other values
    thinned = x[:: max(1, int(n / (most_others + LEVELS + 1)))]
    if (
        len(np.unique(thinned)) > most_others + LEVELS
    ):  # a thirtieth of the samples, for most signals
        return ()
    values, counts = np.unique(x, return_counts=True)
    most = np.argsort(-counts)[:LEVELS]
    shares = counts[most] / len(x)
    several = (shares > LEVEL_SHARE).sum() >= 2
    if not several or shares.sum() < SWITCHED_SHARE:
        return ()
    chosen = most[shares > LEVEL_SHARE]
    if np.count_nonzero(np.diff(x)) < FEWEST_SWITCHES:
        return ()
    return tuple(float(value) + 0.0 for value in np.sort(values[chosen]))


@once_a_series
def held_samples(x: np.ndarray) -> float | None:
    """Return for how many samples at a time a channel is held, again and again; None for none."""
    lengths = np.diff(np.flatnonzero(np.diff(x)))
    usual = float(np.median(lengths)) if len(lengths) >= 10 else 0.0
    # steps of a coarse sensor are as long as the channel is flat, only two samples are never by it
    regular = np.abs(lengths - usual) <= (usual > STAIRCASE_SAMPLES)
    least = REGULAR if usual > STAIRCASE_SAMPLES else ALWAYS
    return None if usual < STAIRCASE_SAMPLES or regular.mean() < least else usual


def _multiple_of(
    name: str, x: np.ndarray, columns: Mapping[str, np.ndarray], used: Collection[str]
) -> TorqueVerdict | None:
    for other, y in columns.items():
        if other == name or other in used or len(y) != len(x) or not is_compared(other):
            continue
        at = _largest(y)
        if at is None:
            continue
        gain = float(x[at] / y[at])
        if abs(x[at // 2] - gain * y[at // 2]) > SAME * np.abs(x[at]):  # most end here
            continue
        off = float(np.linalg.norm(x - gain * y)) / max(float(np.linalg.norm(x)), 1e-300)
        if gain and off < SAME:
            times = "" if abs(gain - 1) < SAME else f"{gain:.4g} times "
            column = f"{times}the column '{other}'"
            cause = "shared" if other.startswith("tau.") else "copied"
            return TorqueVerdict(TorqueClass.COMMANDED, cause, off, SAME, column)
    return None


@once_a_series
def _largest(x: np.ndarray) -> int | None:
    """Return the place of the largest size in a channel (n,); None of one that is constant."""
    return int(np.abs(x).argmax()) if np.ptp(x) else None


def _less_noise_than_others(
    name: str, x: np.ndarray, columns: Mapping[str, np.ndarray]
) -> float | None:
    share = noise_share(x)
    if share > CLEAN or grain(x):
        return None
    others = [y for other, y in columns.items() if other.startswith("tau.") and other != name]
    usual_share = float(np.median([noise_share(y) for y in others])) if others else 0.0
    if usual_share < CLEAN or share > CLEAN * usual_share:
        return None
    return share / usual_share


def torque_verdicts(
    mechanism: Mechanism, t: np.ndarray, columns: Mapping[str, np.ndarray]
) -> dict[str, TorqueVerdict]:
    """Return the classes of a log's torques on a clock t (n,), as logged or as a drive supplies
    them, by joint.
    """
    used = {source.column for source in mechanism.columns.values()}
    verdicts = {joint: MEASURED for joint in mechanism.drives if f"tau.{joint}" in columns}
    for joint in mechanism.measured:
        x, q = columns.get(f"tau.{joint}"), columns.get(f"q.{joint}")
        if x is None:
            continue
        speed = np.abs(np.gradient(q, t)) if q is not None and len(q) > 1 else np.ones(len(x))
        moving = speed > MOVING * float(np.sqrt(np.mean(speed**2)))
        verdicts[joint] = torque_verdict(f"tau.{joint}", x, moving, columns, used)
    return verdicts


def informing(verdicts: Mapping[str, TorqueVerdict]) -> frozenset[str]:
    """Return the joints whose torques knots and cut-off ask."""
    return frozenset(joint for joint, verdict in verdicts.items() if verdict.informs)
