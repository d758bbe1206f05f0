"""Friction in a joint: viscous and Coulomb."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ident.effects.base import Effect, Signals, Unknown

ARMSTRONG = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994"


def direction(v: np.ndarray, still: np.ndarray) -> np.ndarray:
    """sign(v), but v / still within the speeds at which a joint counts as standing still.

    At standstill friction takes any value between −Fc and +Fc, so neither +1 nor −1 would be true.
    """
    return np.clip(v / still, -1.0, 1.0)


class Viscous(Effect):
    """Friction torque in proportion to speed."""

    kind: ClassVar[str] = "viscous"
    unknowns: ClassVar = (
        Unknown("Fv", ("N m s/rad", "N s/m"), "viscous friction coefficient", nonnegative=True),
    )
    equation: ClassVar[str] = "Fv v"
    signature: ClassVar[str] = "the residual against speed is a straight line through zero"
    confused_with: ClassVar = ("drag", "torque_gain", "delay")
    source: ClassVar[str] = ARMSTRONG

    def columns(self, s: Signals) -> np.ndarray:
        """E = v."""
        return s.v[:, :, None]


class Coulomb(Effect):
    """Dry friction: constant against the direction of motion."""

    kind: ClassVar[str] = "coulomb"
    unknowns: ClassVar = (Unknown("Fc", ("N m", "N"), "Coulomb friction", nonnegative=True),)
    equation: ClassVar[str] = "Fc sign(v); a sample at standstill does not inform it"
    signature: ClassVar[str] = "the residual against speed is a step at zero: two level bands"
    confused_with: ClassVar = ("stribeck", "hysteresis", "load_friction", "delay")
    source: ClassVar[str] = ARMSTRONG

    def columns(self, s: Signals) -> np.ndarray:
        """E = sign(v)."""
        return direction(s.v, s.still)[:, :, None]

    def informed(self, s: Signals) -> np.ndarray:
        """False at standstill, where dry friction may have any value up to Fc."""
        return np.abs(s.v) >= s.still
