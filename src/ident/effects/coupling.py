"""Two joints that share a motor or a gear: what turns with the sum of their rates."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ident.effects.base import Effect, Unknown
from ident.effects.friction import direction
from ident.effects.signals import Signals


class Coupling(Effect):
    """Inertia and friction at the sum of two joints' rates, felt by both joints alike."""

    kind: ClassVar[str] = "coupling"
    arity: ClassVar[int] = 2
    sits: ClassVar[str] = "driven"
    unknowns: ClassVar = (
        Unknown("Im", ("kg m²", "kg"), "inertia of what turns with both", nonnegative=True),
        Unknown("Fvm", ("N m s/rad", "N s/m"), "its viscous friction", nonnegative=True),
        Unknown("Fcm", ("N m", "N"), "its Coulomb friction", nonnegative=True),
    )
    equation: ClassVar[str] = "Im (a1 + a2) + Fvm (v1 + v2) + Fcm sign(v1 + v2), on both joints"
    signature: ClassVar[str] = (
        "the residuals of two joints are alike and step with their speeds' sum"
    )
    confused_with: ClassVar = ("viscous and coulomb of the two joints, if they always move alike",)
    source: ClassVar[str] = (
        "Janot, Vandanjon, Gautier, IEEE Trans. Control Syst. Technol. 22(1), 2014"
    )

    def columns(self, s: Signals) -> np.ndarray:
        """E = [a1 + a2, v1 + v2, sign(v1 + v2)] for both joints."""
        v = s.v.sum(axis=1)
        both = np.stack([s.a.sum(axis=1), v, direction(v, s.still.max())], axis=-1)
        return np.repeat(both[:, None, :], 2, axis=1)

    def informed(self, s: Signals) -> np.ndarray:
        """False where the sum of the rates is at standstill."""
        moving = np.abs(s.v.sum(axis=1)) >= s.still.max()
        return np.repeat(moving[:, None], 2, axis=1)
