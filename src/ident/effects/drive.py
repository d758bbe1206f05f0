"""Effects of the drive: the rotor's inertia, an offset of the torque channel."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ident.effects.base import Effect, Signals, Unknown


class RotorInertia(Effect):
    """The motor rotor's inertia, seen at the joint (gear ratio squared times its own)."""

    kind: ClassVar[str] = "rotor_inertia"
    unknowns: ClassVar = (
        Unknown("Ia", ("kg m²", "kg"), "rotor inertia at the joint", nonnegative=True),
    )
    equation: ClassVar[str] = "Ia a"
    signature: ClassVar[str] = "the residual against acceleration is a straight line"
    confused_with: ClassVar = ("the link's own Lzz on a first joint",)
    source: ClassVar[str] = "Khalil, Dombre, Modeling, Identification and Control of Robots, ch. 9"

    def columns(self, s: Signals) -> np.ndarray:
        """E = a."""
        return s.a[:, :, None]


class TorqueOffset(Effect):
    """A constant error of the torque channel, or asymmetric Coulomb friction."""

    kind: ClassVar[str] = "torque_offset"
    unknowns: ClassVar = (Unknown("c", ("N m", "N"), "constant torque"),)
    equation: ClassVar[str] = "c"
    signature: ClassVar[str] = "the residual is shifted by a constant, in both directions of motion"
    confused_with: ClassVar = ("spring", "coulomb that differs with direction")
    source: ClassVar[str] = "Khalil, Dombre, Modeling, Identification and Control of Robots, ch. 9"

    def columns(self, s: Signals) -> np.ndarray:
        """E = 1."""
        return np.ones((*s.q.shape, 1))
