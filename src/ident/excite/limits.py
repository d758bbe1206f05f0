"""What an exciting motion must keep: limits of the URDF, or others in their place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ident.errors import MechanismError, one_of
from ident.mechanism.mechanism import Joint, Mechanism

TURN = 2 * np.pi
PACE = 1.0  # s in which a joint without a limit of speed may cross its range
Given = float | Mapping[str, float] | None


@dataclass(frozen=True)
class Limits:
    """Limits in place of the URDF's. A number holds for all driven joints, where the URDF's is not
    lower; a mapping by joint replaces the URDF's.

    Attributes:
        range: by joint, (lower, upper) [rad | m].
        speed: [rad/s | m/s]; acceleration: [rad/s² | m/s²], of which a URDF knows none.
        torque: [N m | N].
        reserve: share of the torque that is left to what the model does not know, friction first.
        singular: times its value at home that ‖K⁺‖ may reach: the distance to loop singularities.

    Raises:
        MechanismError: for a number that is no limit.
    """

    range: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    speed: Given = None
    acceleration: Given = None
    torque: Given = None
    reserve: float = 0.2
    singular: float = 3.0

    def __post_init__(self) -> None:
        for what in ("speed", "acceleration", "torque"):
            given = getattr(self, what)
            for x in given.values() if isinstance(given, Mapping) else [given]:
                if x is not None and not 0 < x < np.inf:
                    raise MechanismError(f"limit of {what}: {x:g}; a number above 0 is expected")
        for name, (low, high) in self.range.items():
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise MechanismError(
                    f"limit of range: {name} = {low:g} to {high:g}; two numbers, the lower first"
                )
        if not 0 <= self.reserve < 1:
            raise MechanismError(
                f"reserve of torque: {self.reserve:g}; a share from 0 to below 1 is expected"
            )
        if not self.singular > 1:
            raise MechanismError(
                f"distance to singularities: {self.singular:g} times ‖K⁺‖ at home; a number above "
                "1 is expected"
            )


@dataclass(frozen=True)
class Kept:
    """The limits that hold, one `Joint` each, with what was assumed where there are none.

    Attributes:
        joints: the mechanism's, with the limits in force.
        acceleration: by joint [rad/s² | m/s²], inf where there is none.
        reserve, singular: see `Limits`.
        notes: what was assumed.
    """

    joints: tuple[Joint, ...]
    acceleration: tuple[float, ...]
    reserve: float
    singular: float
    notes: tuple[str, ...]


def kept(
    mechanism: Mechanism, limits: Limits, independent: tuple[str, ...], start: Mapping[str, float]
) -> Kept:
    """The limits in force for every joint of a mechanism.

    Args:
        mechanism: with the URDF's limits.
        limits: in their place.
        independent: joints that are moved; these need a range and a speed.
        start: their positions [rad | m].

    Raises:
        MechanismError: for a joint that is not there, or a sliding drive without a range.
    """
    _check_names(mechanism, limits)
    joints, notes = [], []
    for joint in mechanism.joints:
        driven = joint.name in mechanism.driven
        low, high = limits.range.get(joint.name, (joint.lower, joint.upper))
        given = replace(
            joint,
            lower=low,
            upper=high,
            velocity=_limit(limits.speed, joint.name, driven, joint.velocity or np.inf),
            effort=_limit(limits.torque, joint.name, driven, joint.effort or np.inf),
        )
        if joint.name in independent:
            given, said = _bounded(given, start[joint.name])
            notes += said
        joints.append(given)
    acceleration = [
        _limit(limits.acceleration, joint.name, joint.name in mechanism.driven, np.inf)
        for joint in joints
    ]
    return Kept(tuple(joints), tuple(acceleration), limits.reserve, limits.singular, tuple(notes))


def _check_names(mechanism: Mechanism, limits: Limits) -> None:
    tables = [limits.range, limits.speed, limits.acceleration, limits.torque]
    for table in (each for each in tables if isinstance(each, Mapping)):
        for name in table:
            mechanism.joint(name)
    for name in limits.torque if isinstance(limits.torque, Mapping) else ():
        if name not in mechanism.driven:
            raise MechanismError(
                f"{mechanism.name}: limit of torque: '{name}' is passive; "
                f"{one_of(name, mechanism.driven)}"
            )


def _limit(given: Given, name: str, driven: bool, urdf: float) -> float:
    if isinstance(given, Mapping):
        return float(given.get(name, urdf))
    return min(float(given), urdf) if given is not None and driven else urdf


def _bounded(joint: Joint, start: float) -> tuple[Joint, list[str]]:
    """A driven joint with a range and a speed, where the URDF gives none."""
    notes = []
    if joint.rotational and joint.upper - joint.lower > TURN:
        joint = replace(joint, lower=start - np.pi, upper=start + np.pi)
        notes.append(f"{joint.name} may turn on and on: moved by up to half a turn either way")
    if not np.isfinite(joint.upper - joint.lower):
        raise MechanismError(
            f"joint '{joint.name}' slides without limits; say how far: "
            f"--range {joint.name}=LOWER:UPPER"
        )
    if not np.isfinite(joint.velocity):
        joint = replace(joint, velocity=(joint.upper - joint.lower) / PACE)
        notes.append(
            f"{joint.name} has no limit of speed: {joint.velocity:.3g} {joint.unit}/s is taken"
        )
    return joint, notes
