"""Values of all parameters for a simulation: the URDF's, a fit's, and those given by name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.effects import KINDS, Effect
from ident.equations.point import Point
from ident.errors import MechanismError, one_of
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import CENTROIDAL, DYNAMIC, about_origin, split


def point_of(
    mechanism: Mechanism, values: Mapping[str, float] | None, pi: np.ndarray | None
) -> Point:
    """The working point of a simulation.

    Args:
        mechanism: with effects; an effect's unknowns need values, from `[[effect]]` or `values`.
        values: by full name: effects' unknowns and dynamic parameters, in place of the URDF's.
        pi: all dynamic parameters (10 · bodies,) in place of the URDF's.

    Raises:
        MechanismError: for names that are not there, or an effect's unknown without a value.
    """
    given = dict(values or {})
    point = Point(_parameters(mechanism, given, pi), {})
    for effect in mechanism.effects:
        point = point.with_values(_effect_values(effect, given))
    if given:
        name = next(iter(given))
        if wanted := _effect_of(mechanism, name):
            raise MechanismError(
                f"{mechanism.name}: no parameter '{name}': the model has no effect '{wanted}'; "
                f"add it: --with {wanted}, or an [[effect]] in mechanism.toml"
            )
        valid = [*mechanism.bodies.names, *(n for e in mechanism.effects for n in e.names)]
        raise MechanismError(f"{mechanism.name}: no parameter '{name}'; {one_of(name, valid)}")
    return point


def _effect_of(mechanism: Mechanism, name: str) -> str:
    """The effect, not of the model, that a parameter of this name belongs to; "" if none does."""
    kind, _, rest = name.partition(".")
    site = rest.rpartition(".")[0]
    if kind not in KINDS:
        return ""
    label = f"{kind}:{site}" if site else kind
    try:
        grown = mechanism.with_effect(label)
    except MechanismError:  # nothing it could sit on
        return ""
    return label if any(name in effect.names for effect in grown.effects) else ""


def _parameters(mechanism: Mechanism, given: dict[str, float], pi: np.ndarray | None) -> np.ndarray:
    parameters = (mechanism.prior if pi is None else pi).copy()
    for i, name in enumerate(mechanism.bodies.names):
        if name in given:
            parameters[i] = given.pop(name)
    for link in mechanism.bodies.links:  # moments about the centre of mass, as a URDF has them
        at = mechanism.bodies.columns(link)
        shift = about_origin(*split(parameters[at])[:2])
        for k, word in enumerate(DYNAMIC):
            name = f"{link}.{CENTROIDAL.get(word)}"
            if word in CENTROIDAL and name in given:
                row, column = ("xyz".index(letter) for letter in word[1:])
                parameters[at.start + k] = given.pop(name) + shift[row, column]
    return parameters


def _effect_values(effect: Effect, given: dict[str, float]) -> dict[str, float]:
    values = {}
    for name, unknown in zip(effect.names, effect.parameters, strict=True):
        value = given.pop(name, effect.values.get(unknown.name))
        if value is None:
            raise MechanismError(
                f"effect '{effect.label}': give {name} a value to simulate it: --set {name}=…, or "
                f"{unknown.name} = … in its [[effect]]"
            )
        values[name] = float(value)
    return values
