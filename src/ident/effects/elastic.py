"""Torques that depend on position: springs."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ident.effects.base import Effect, Signals, Unknown


class Spring(Effect):
    """A linear spring across a joint, with its preload."""

    kind: ClassVar[str] = "spring"
    unknowns: ClassVar = (
        Unknown("k", ("N m/rad", "N/m"), "stiffness", nonnegative=True),
        Unknown("b", ("N m", "N"), "torque at q = 0"),
    )
    equation: ClassVar[str] = "k q + b"
    signature: ClassVar[str] = "the residual against position is a straight line, at rest as well"
    confused_with: ClassVar = ("gravity over a small range", "torque_offset", "cable")
    source: ClassVar[str] = "Hooke's law"

    def columns(self, s: Signals) -> np.ndarray:
        """E = [q, 1]."""
        return np.stack([s.q, np.ones_like(s.q)], axis=-1)
