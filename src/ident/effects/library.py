"""All kinds by name, and how `kind:joint[,joint]` is read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ident.effects.base import Effect
from ident.effects.coupling import Coupling
from ident.effects.drive import Delay, Drift, RotorInertia, TorqueGain, TorqueOffset
from ident.effects.elastic import Cable, EndStop, Ripple, Spring
from ident.effects.friction import (
    Coulomb,
    Drag,
    Hysteresis,
    LoadFriction,
    Stribeck,
    TemperatureFriction,
    Viscous,
)
from ident.effects.measured import (
    Backlash,
    ClosureCompliance,
    Elasticity,
    EncoderOffset,
    Geometry,
    GravityTilt,
)
from ident.effects.payload import Payload
from ident.errors import MechanismError, one_of

KINDS: Mapping[str, type[Effect]] = {
    effect.kind: effect
    for effect in (
        Viscous, Coulomb, Stribeck, LoadFriction, Hysteresis, Drag, Spring, Cable, EndStop,
        RotorInertia, Coupling, Ripple, TorqueOffset, TorqueGain, Delay, EncoderOffset,
        GravityTilt, Payload, Elasticity, Backlash, Geometry, ClosureCompliance,
        TemperatureFriction, Drift,
    )
}  # fmt: skip


def create(
    kind: str,
    joints: str | Sequence[str] = (),
    values: Mapping[str, float] | None = None,
    rotational: bool = True,
) -> Effect:
    """An effect of the library.

    Args:
        kind: one of `KINDS`.
        joints: the joint's name, or several; none for an effect of the whole mechanism.
        values: parameters that are known, with their values.
        rotational: whether the (first) joint turns; a mechanism sets it when the effect is added.

    Raises:
        MechanismError: for a kind, number of joints or parameter that is not there.
    """
    if kind not in KINDS:
        raise MechanismError(f"there is no effect '{kind}'; {one_of(kind, KINDS)}")
    if isinstance(joints, str):
        joints = [part.strip() for part in joints.split(",")] if joints else []
    return KINDS[kind](tuple(joints), dict(values or {}), rotational)


def parse(text: str) -> tuple[str, tuple[str, ...]]:
    """`kind:joint[,joint]` or `kind` alone as (kind, joints); joints empty for `kind` alone.

    Raises:
        MechanismError: for a kind that is not in the library.
    """
    kind, colon, joints = text.partition(":")
    if kind not in KINDS:
        raise MechanismError(f"effect '{text}': there is no '{kind}'; {one_of(kind, KINDS)}")
    names = tuple(part.strip() for part in joints.split(",")) if colon else ()
    if colon and not all(names):
        raise MechanismError(f"effect '{text}': a joint's name is missing; write {kind}:joint")
    return kind, names
