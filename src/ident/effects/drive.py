"""Effects of the drive and its torque channel."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ident.effects.base import Bounds, Correcting, Correction, Effect, Unknown
from ident.effects.signals import Signals

LATEST = 0.05  # [s] that a channel may be late or early
KHALIL = "Khalil, Dombre, Modeling, Identification and Control of Robots, ch. 9"
JANOT = "Janot, Vandanjon, Gautier, IEEE Trans. Control Syst. Technol. 22(1), 2014"


class RotorInertia(Effect):
    """The motor rotor's inertia, seen at the joint (gear ratio squared times its own)."""

    kind: ClassVar[str] = "rotor_inertia"
    common: ClassVar[bool] = True
    sits: ClassVar[str] = "driven"
    unknowns: ClassVar = (
        Unknown("Ia", ("kg m²", "kg"), "rotor inertia at the joint", nonnegative=True),
    )
    equation: ClassVar[str] = "Ia a"
    signature: ClassVar[str] = "the residual against acceleration is a straight line"
    confused_with: ClassVar = ("the link's own Lzz on a first joint",)
    source: ClassVar[str] = KHALIL

    def columns(self, s: Signals) -> np.ndarray:
        """E = a."""
        return s.a[:, :, None]


class TorqueOffset(Effect):
    """A constant error of the torque channel, or asymmetric Coulomb friction."""

    kind: ClassVar[str] = "torque_offset"
    common: ClassVar[bool] = True
    sits: ClassVar[str] = "driven"
    unknowns: ClassVar = (Unknown("c", ("N m", "N"), "constant torque"),)
    equation: ClassVar[str] = "c"
    signature: ClassVar[str] = "the residual is shifted by a constant, in both directions of motion"
    confused_with: ClassVar = ("spring", "coulomb that differs with direction")
    nested_in: ClassVar = ("spring", "cable")
    source: ClassVar[str] = JANOT

    def columns(self, s: Signals) -> np.ndarray:
        """E = 1."""
        return np.ones((*s.q.shape, 1))


class TorqueGain(Effect):
    """A torque channel with a wrong scale, such as a motor constant a few percent off."""

    kind: ClassVar[str] = "torque_gain"
    sits: ClassVar[str] = "driven"
    unknowns: ClassVar = (Unknown("g", ("1", "1"), "share of the torque", largest=0.5),)
    equation: ClassVar[str] = "g τ, with the torque τ that the model predicts"
    signature: ClassVar[str] = "the residual against the joint's own torque is a straight line"
    confused_with: ClassVar = ("all inertias at once, where one joint alone shows them", "viscous")
    source: ClassVar[str] = "Gautier, Briot, ASME J. Dyn. Syst. Meas. Control 136(5), 2014"
    implicit: ClassVar[bool] = True

    def columns(self, s: Signals) -> np.ndarray:
        """E = τ."""
        return s.torque[:, :, None]


class Drift(Effect):
    """An offset that grows with time, from the log's beginning."""

    kind: ClassVar[str] = "drift"
    sits: ClassVar[str] = "driven"
    unknowns: ClassVar = (Unknown("c", ("N m/s", "N/s"), "growth of the offset"),)
    equation: ClassVar[str] = "c (t − t0), t0 the log's first sample"
    signature: ClassVar[str] = "the residual against time climbs along a straight line"
    confused_with: ClassVar = ("temperature_friction", "torque_offset")
    source: ClassVar[str] = "Fraden, Handbook of Modern Sensors, ch. 3"
    memory: ClassVar[bool] = True  # it counts from the first sample

    def columns(self, s: Signals) -> np.ndarray:
        """E = t − t0."""
        return np.repeat((s.t - s.t[0])[:, None, None], s.q.shape[1], axis=1)


class Delay(Correcting):
    """A torque channel that is late against the positions."""

    kind: ClassVar[str] = "delay"
    sits: ClassVar[str] = "driven"
    shapes: ClassVar = (Unknown("d", ("s", "s"), "by which the torque is late"),)
    equation: ClassVar[str] = "τ(t) logged at t + d"
    signature: ClassVar[str] = "the residual is large where the torque changes fast, with its slope"
    confused_with: ClassVar = ("viscous", "coulomb", "elasticity")
    source: ClassVar[str] = "Björklund, Ljung, IEEE CDC 2003"

    def correction(self, s: Signals) -> Correction:
        """τ(t) = τ_logged(t + d)."""
        return Correction(delay={self.joints[0]: s.shape["d"]})

    def bounds(self, s: Signals) -> Bounds:
        """Fifty milliseconds either way."""
        return {"d": (-LATEST, LATEST)}
