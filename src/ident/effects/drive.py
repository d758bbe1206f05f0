"""Effects of the drive and its torque channel."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ident.effects.effect import Correcting, Correction, Effect, Signals, Unknown
from ident.effects.friction import direction

LATEST = 0.05  # [s] that a channel may be late or early
KHALIL = "Khalil, Dombre, Modeling, Identification and Control of Robots, ch. 9"
JANOT = "Janot, Vandanjon, Gautier, IEEE Trans. Control Syst. Technol. 22(1), 2014"


class RotorInertia(Effect):
    """The motor rotor's inertia, seen at the joint (gear ratio squared times its own)."""

    kind = "rotor_inertia"
    model_words = ("armature",)
    watched = "request"
    common = True
    sits = "driven"
    unknowns = (Unknown("Ia", ("kg m²", "kg"), "rotor inertia at the joint", True, acts="inertia"),)
    equation = "Ia a"
    signature = "the residual against acceleration is a straight line"
    confused_with = ("the link's own Lzz on a first joint",)
    remedy = "give its link's inertia from the drawing, or log once more with a known load"
    source = KHALIL

    def columns(self, s: Signals) -> np.ndarray:
        return s.a[:, :, None]


class Coupling(Effect):
    """Inertia and friction at the sum of two joints' rates, felt by both joints alike."""

    kind = "coupling"
    arity = 2
    sits = "driven"
    watched = "request"
    unknowns = (
        Unknown("Im", ("kg m²", "kg"), "inertia of what turns with both", True, acts="inertia"),
        Unknown("Fvm", ("N m s/rad", "N s/m"), "its viscous friction", True, acts="linear"),
        Unknown("Fcm", ("N m", "N"), "its Coulomb friction", True, acts="level"),
    )
    equation = "Im (a1 + a2) + Fvm (v1 + v2) + Fcm sign(v1 + v2), on both joints"
    signature = "the residuals of two joints are alike and step with their speeds' sum"
    confused_with = ("viscous and coulomb of the two joints, if they always move alike",)
    source = JANOT

    def columns(self, s: Signals) -> np.ndarray:
        v = s.v.sum(axis=1)
        both = np.stack([s.a.sum(axis=1), v, direction(v, s.still.max())], axis=-1)
        return np.repeat(both[:, None, :], 2, axis=1)

    def informed(self, s: Signals) -> np.ndarray:
        moving = np.abs(s.v.sum(axis=1)) >= s.still.max()
        return np.repeat(moving[:, None], 2, axis=1)


class TorqueOffset(Effect):
    """A constant error of the torque channel, or asymmetric Coulomb friction."""

    kind = "torque_offset"
    common = True
    sits = "driven"
    watched = "always"
    unknowns = (Unknown("c", ("N m", "N"), "constant torque", acts="linear"),)
    equation = "c"
    signature = "the residual is shifted by a constant, in both directions of motion"
    confused_with = ("spring", "coulomb that differs with direction")
    remedy = "read the torque with the drive unloaded, or tilt the base"
    nested_in = ("spring", "cable")
    source = JANOT

    def columns(self, s: Signals) -> np.ndarray:
        return np.ones((*s.q.shape, 1))


class TorqueGain(Effect):
    """A torque channel with a wrong scale, such as a motor constant a few percent off."""

    kind = "torque_gain"
    watched = "always"
    sits = "driven"
    unknowns = (Unknown("g", ("1", "1"), "share of the torque", largest=0.5),)
    equation = "g τ, with the torque τ that the model predicts"
    signature = "the residual against the joint's own torque is a straight line"
    confused_with = ("all inertias at once, where one joint alone shows them", "viscous")
    remedy = "log once more with a known mass on the last link"
    separated_by: ClassVar = {
        "rotor_inertia": "repeat the motion with a known mass on the last link"
    }
    source = "Gautier, Briot, ASME J. Dyn. Syst. Meas. Control 136(5), 2014"
    implicit = True
    asks = ("torque",)

    def columns(self, s: Signals) -> np.ndarray:
        return s.torque[:, :, None]


class Drift(Effect):
    """An offset that grows with time, from the log's beginning."""

    kind = "drift"
    sits = "driven"
    unknowns = (Unknown("c", ("N m/s", "N/s"), "growth of the offset"),)
    equation = "c (t − t0), t0 the log's first sample"
    signature = "the residual against time climbs along a straight line"
    confused_with = ("temperature_friction", "torque_offset")
    source = "Fraden, Handbook of Modern Sensors, ch. 3"
    memory = True  # it counts from the first sample
    not_integrable = ""  # its state is the time

    def columns(self, s: Signals) -> np.ndarray:
        return np.repeat((s.t - s.t[0])[:, None, None], s.q.shape[1], axis=1)


class Delay(Correcting):
    """A torque channel that is late against the positions, or several by the same time."""

    kind = "delay"
    shared = True
    watched = "request"
    fault = "delay"
    margin = LATEST
    sits = "driven"
    shapes = (Unknown("d", ("s", "s"), "by which the torque is late", range=(-LATEST, LATEST)),)
    equation = "τ(t) logged at t + d"
    signature = "the residual is large where the torque changes fast, with its slope"
    confused_with = ("viscous", "coulomb", "elasticity")
    remedy = "log a motion of two frequencies, the higher at least three times the lower"
    source = "Björklund, Ljung, IEEE CDC 2003"

    @property
    def rare(self) -> bool:  # type: ignore[override]
        """Return whether one channel alone is late: presliding friction looks like that."""
        return not self.joined

    def correction(self, s: Signals) -> Correction:
        return Correction(delay=dict.fromkeys(self.joints, s.shape["d"]))
