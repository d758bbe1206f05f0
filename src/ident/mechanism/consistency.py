"""What is known of parameters beforehand: bounds, and the mass of all moving bodies together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ident.effects import KINDS
from ident.errors import MechanismError, one_of
from ident.mechanism.parameters import CENTROIDAL, DYNAMIC, Bodies
from ident.mechanism.settings import HUGE


@dataclass(frozen=True)
class Consistency:
    """Physical consistency asked of a fit: possible bodies, no negative friction, and these limits.

    Args:
        bounds: (lowest, highest) by parameter's name, in its unit; ±inf where there is none.
        total_mass: of all moving bodies [kg].

    Raises:
        MechanismError: for bounds that are no two numbers in order, or a mass that is not positive.
    """

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    total_mass: float | None = None

    def __post_init__(self) -> None:
        for name, (low, high) in self.bounds.items():
            if np.isnan(low) or np.isnan(high) or low > high:
                raise MechanismError(
                    f"bounds of {name}: [{low:g}, {high:g}]; give the lower one first"
                )
        if self.total_mass is not None and not 0 < self.total_mass < HUGE:
            raise MechanismError(f"total_mass = {self.total_mass:g}; give kilograms above 0")

    def __or__(self, other: Consistency) -> Consistency:
        """Both; where they speak of the same, the other's."""
        mass = self.total_mass if other.total_mass is None else other.total_mass
        return Consistency({**self.bounds, **other.bounds}, mass)


def read_consistency(table: Mapping[str, Any], bodies: Bodies, where: str) -> Consistency:
    """`bounds` and `total_mass` of [parameters].

    Raises:
        MechanismError: naming what is wrong, and what would be valid.
    """
    given = table.get("bounds", {})
    if not isinstance(given, dict):
        raise MechanismError(f'{where}: bounds = {given!r}; write {{ "link.m" = [0.4, 0.6] }}')
    bounds = {}
    for name, pair in given.items():
        check_name(name, bodies, f"{where} bounds")
        if not isinstance(pair, list) or len(pair) != 2 or not all(map(_number, pair)):
            raise MechanismError(
                f'{where} bounds: "{name}" = {pair!r}; give two numbers, [lowest, highest]; '
                "-inf and inf are valid"
            )
        bounds[name] = (float(pair[0]), float(pair[1]))
    mass = table.get("total_mass")
    if mass is not None and not _number(mass):
        raise MechanismError(f"{where}: total_mass = {mass!r}; give a number of kilograms")
    try:
        return Consistency(bounds, None if mass is None else float(mass))
    except MechanismError as error:
        raise MechanismError(f"{where}: {error}") from None


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def check_name(name: str, bodies: Bodies, where: str) -> None:
    """Refuse a name that is no body's parameter and can be no effect's.

    Raises:
        MechanismError: with the nearest valid name.
    """
    link, _, word = name.rpartition(".")
    words = [*DYNAMIC, *CENTROIDAL.values()]
    if link in bodies.links and word in words:
        return
    if link in bodies.links:
        raise MechanismError(f"{where}: '{name}': a link has no '{word}'; {one_of(word, words)}")
    if name.count(".") >= 2 or link in KINDS:  # an effect's, which may be added later
        return
    raise MechanismError(
        f"{where}: '{name}' is no parameter of a link or effect: no link '{link}'; "
        f"{one_of(link, bodies.links)}"
    )
