"""All kinds by name; how `kind:joint[,joint]` is read; all effects that a mechanism could have."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from ident.effects.curve import Curve
from ident.effects.drive import Coupling, Delay, Drift, RotorInertia, TorqueGain, TorqueOffset
from ident.effects.effect import Effect, Sites
from ident.effects.elastic import Cable, EndStop, Payload, Ripple, Spring
from ident.effects.friction import (
    Coulomb,
    Drag,
    Hysteresis,
    LoadFriction,
    Stribeck,
    TemperatureFriction,
    Viscous,
)
from ident.effects.measurement import (
    Backlash,
    ClosureCompliance,
    Elasticity,
    EncoderOffset,
    Geometry,
    GravityTilt,
)
from ident.errors import MechanismError, one_of

KINDS: Mapping[str, type[Effect]] = {
    effect.kind: effect
    for effect in (
        Viscous, Coulomb, Stribeck, LoadFriction, Hysteresis, Drag, Spring, Cable, EndStop,
        RotorInertia, Coupling, Ripple, TorqueOffset, TorqueGain, Delay, EncoderOffset,
        GravityTilt, Payload, Elasticity, Backlash, Geometry, ClosureCompliance,
        TemperatureFriction, Drift, Curve,
    )
}  # fmt: skip


def kind_of(name: str, before: str = "") -> type[Effect]:
    """Return the kind of the library called `name`; `before` begins the message of an error."""
    if name not in KINDS:
        raise MechanismError(f"{before}there is no effect '{name}'; {one_of(name, KINDS)}")
    return KINDS[name]


def create(
    kind: str,
    joints: str | Sequence[str] = (),
    values: Mapping[str, float] | None = None,
    rotational: bool = True,
    signal: str = "",
) -> Effect:
    """Return an effect of the library.

    Args:
        kind: one of `KINDS`.
        joints: the joint's name, or several; none for an effect of the whole mechanism.
        values: parameters that are known, with their values.
        rotational: whether the (first) joint is rotational; a mechanism sets it when the effect is
            added.
        signal: of a kind that is a function of a signal of one's choice.

    Raises:
        MechanismError: for a kind, number of joints or parameter that does not exist.
    """
    if isinstance(joints, str):
        joints = [part.strip() for part in joints.split(",")] if joints else []
    return kind_of(kind)(tuple(joints), dict(values or {}), rotational, signal)


def parse(text: str) -> tuple[str, tuple[str, ...], str]:
    """Return (kind, joints, signal) of `kind:joint[,joint][:signal]`, or of `kind` alone."""
    kind, colon, rest = text.partition(":")
    joints, _, signal = rest.partition(":")
    kind_of(kind, f"effect '{text}': ")
    names = tuple(part.strip() for part in joints.split(",")) if colon else ()
    if colon and not all(names):
        raise MechanismError(f"effect '{text}': a joint's name is missing; write {kind}:joint")
    return kind, names, signal.strip()


def with_values(text: str) -> tuple[str, dict[str, float]]:
    """Return what precedes the values of `kind:joint:name=value,name=value`, and the values."""
    bare, _, last = text.rpartition(":")
    values = {}
    for part in last.split(",") if bare and "=" in last else ():
        name, _, number = part.partition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError:
            raise MechanismError(
                f"effect '{text}': '{part}' is no value; write {bare}:{name or 'name'}=1"
            ) from None
    return (bare if values else text), values


def candidates(
    sites: Sites, present: Sequence[Effect] = (), columns: Collection[str] = ()
) -> list[Effect]:
    """Return every effect of the library that `present` lacks and the `columns` of logs allow."""
    labels = {effect.label for effect in present}
    every = (kind(joints) for kind in KINDS.values() for joints in kind.candidates(sites))
    return [
        each
        for each in every
        if each.label not in labels
        and labels.issuperset(each.required)
        and {*columns}.issuperset(each.reads())
    ]


def separating(kinds: Collection[str]) -> list[str]:
    """Return the experiments that separate kinds which no motion separates, without repetition."""
    texts = [
        text
        for kind in KINDS.values() if kind.kind in kinds
        for rival, text in kind.separated_by.items() if rival in kinds
    ]  # fmt: skip
    return list(dict.fromkeys(texts))
