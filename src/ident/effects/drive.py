"""Effects of drives, and errors of what is taken to be known.

The latter (encoders, gravity, lengths, stiffness of joints and loops) correct the data or the
mechanism, not the torque: q → q + δ, g → Rᵀg, …
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ident.effects.effect import Bounds, Correcting, Correction, Effect, Signals, Sites, Unknown
from ident.effects.joint import direction

LATEST = 0.05  # range: [s] that a channel may be late or early
KHALIL = "Khalil, Dombre, Modeling, Identification and Control of Robots, ch. 9"
JANOT = "Janot, Vandanjon, Gautier, IEEE Trans. Control Syst. Technol. 22(1), 2014"
BJORKLUND = "Björklund, Ljung, IEEE CDC 2003"
TWO_FREQUENCIES = "log a motion of two frequencies, the higher at least three times the lower"


def lateness_of(channel: str) -> tuple[Unknown, ...]:
    """Return the time [s] by which a `channel`, in words, is late, as the shape of an effect."""
    late, early = f"by which the {channel} is late", f"the {channel} is early"
    return (Unknown("d", ("s", "s"), late, range=(-LATEST, LATEST), negative=early),)


class RotorInertia(Effect):
    """The motor rotor's inertia, seen at the joint (gear ratio squared times its own)."""

    kind = "rotor_inertia"
    smooth = True
    model_words = ("armature",)
    watched = "request"
    common = True
    sits = "driven"
    unknowns = (Unknown("Ia", ("kg m²", "kg"), "rotor inertia at the joint", True, acts="inertia"),)
    equation = "Ia a"
    signature = "the residual against acceleration is a straight line"
    confused_with = ("the link's own Lzz on a first joint",)
    remedy = "say the inertia of {joint} from a drawing, or log once more with a known load"
    source = KHALIL

    def columns(self, s: Signals) -> np.ndarray:
        return s.a[:, :, None]


class Coupling(Effect):
    """Inertia and friction at the sum of two joints' rates, felt by both joints alike."""

    kind = "coupling"
    noun = "mechanical coupling"
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

    @classmethod
    def candidates(cls, sites: Sites) -> list[tuple[str, ...]]:
        return [*sites.geared]

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
    smooth = True
    common = True
    sits = "driven"
    watched = "always"
    unknowns = (Unknown("c", ("N m", "N"), "constant torque", acts="linear"),)
    equation = "c"
    signature = "the residual is shifted by a constant, in both directions of motion"
    confused_with = ("spring", "direction_friction")
    remedy = "read the torque with the drive unloaded, or tilt the base"
    nested_in = ("spring", "cable", "direction_friction")
    source = JANOT

    def columns(self, s: Signals) -> np.ndarray:
        return np.ones((*s.q.shape, 1))


class TorqueGain(Effect):
    """A torque channel with a wrong scale, such as a motor constant a few percent off."""

    kind = "torque_gain"
    noun = "wrong scale of the torque"
    watched = "always"
    sits = "driven"
    candidate_sites = "sensed"
    unknowns = (Unknown("g", ("1", "1"), "share of the torque that is read too much", largest=0.5),)
    equation = "g τ, with the torque τ that the model predicts: 1 + g times τ is read"
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
    noun = "torque drift"
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
    noun = "torque delay"
    shared = True
    watched = "request"
    fault = "delay"
    margin = LATEST
    sits = "driven"
    candidate_sites = "sensed"
    shapes = lateness_of("torque")
    equation = "τ(t) logged at t + d"
    signature = "the residual is large where the torque changes fast, with its slope"
    confused_with = ("viscous", "coulomb", "elasticity")
    remedy = TWO_FREQUENCIES
    source = BJORKLUND

    @property
    def rare(self) -> bool:  # type: ignore[override]
        """Return whether one channel alone is late: presliding friction looks like that."""
        return not self.joined

    def correction(self, s: Signals) -> Correction:
        return Correction(delay=dict.fromkeys(self.joints, s.shape["d"]))


class PositionDelay(Correcting):
    """An encoder that is read late against the other channels, with its rates."""

    kind = "position_delay"
    noun = "late encoder"
    candidate_sites = "logged"
    shifts_in_time = True
    margin = LATEST
    shapes = lateness_of("position")
    equation = "q(t) logged at t + d"
    signature = "the residuals of all joints follow the rate of what this joint makes them feel"
    confused_with = ("delay",)
    remedy = TWO_FREQUENCIES
    source = BJORKLUND

    @classmethod
    def candidates(cls, sites: Sites) -> list[tuple[str, ...]]:
        # what a drive supplies follows its position, and has a delay of its own
        return [
            (name,) for name in sites.logged if name in sites.sensed or name not in sites.driven
        ]

    def correction(self, s: Signals) -> Correction:
        return Correction(position_delay={self.joints[0]: s.shape["d"]})


TILT = 0.35  # range: [rad] 20° of a base that is not level, or of an encoder's zero
SUBTRACTED = 0.5  # range: share of gravity from which it is a controller that subtracts it
OVERCOMPENSATED = 1.5  # range: share of gravity that a controller with heavier bodies subtracts
DISPLACED = 0.05  # range: [m] of an error of a drawing
SOFTEST = 1e-4  # range: [m/N] of a closure: a millimetre at ten newtons


class EncoderOffset(Correcting):
    """An encoder whose zero is off, at a joint whose position is logged."""

    kind = "encoder_offset"
    candidate_sites = "logged"
    watched = "always"
    shapes = (Unknown("delta", ("rad", "m"), "true minus logged coordinate"),)
    equation = "q = q_logged + delta"
    signature = "the residual of all joints follows the slope of gravity with q"
    confused_with = ("gravity_tilt", "the centre of mass of a last link")
    remedy = "put {joint} against a reference, or turn the base about a horizontal axis"
    source = "Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, ch. 6"

    def correction(self, s: Signals) -> Correction:
        return Correction(dq={self.joints[0]: s.shape["delta"]})

    def bounds(self, s: Signals) -> Bounds:
        # up to a fifth of the travel for a sliding joint
        low, high = s.travel[0]
        most = TILT if self.rotational else max(0.2 * (high - low), 1e-4)
        return {"delta": (-most, most)}


class GravityTilt(Correcting):
    """A base that is not level."""

    kind = "gravity_tilt"
    noun = "tilted base"
    arity = 0
    sits = "mechanism"
    watched = "always"
    shapes = (
        Unknown("x", ("rad", "rad"), "rotation of the base about its x axis", range=(-TILT, TILT)),
        Unknown("y", ("rad", "rad"), "then about its new y axis", range=(-TILT, TILT)),
    )
    equation = "g → Rᵀ g, R = Rx(x) Ry(y): the base is turned by R"
    signature = "joints that gravity should not feel show it, with their angle"
    confused_with = ("encoder_offset",)
    remedy = "level the base, or turn it about a horizontal axis by a known angle"
    separated_by: ClassVar = {
        "encoder_offset": "repeat it with the first joint turned by a right angle"
    }
    source = "Featherstone, Rigid Body Dynamics Algorithms, ch. 5"

    def correction(self, s: Signals) -> Correction:
        return Correction(tilt=(s.shape["x"], s.shape["y"]))


class GravityCompensation(Correcting):
    """A controller that has subtracted the gravity of the bodies as given, as robots deliver it."""

    kind = "gravity_compensation"
    noun = "gravity that was subtracted from the torques"
    rare = True
    arity = 0
    sits = "mechanism"
    watched = "request"
    fault = "compensated"
    shapes = (
        Unknown(
            "k", ("1", "1"), "share of gravity that the torques lack", nonnegative=True,
            range=(0.0, OVERCOMPENSATED), smallest=SUBTRACTED,
        ),
    )  # fmt: skip
    equation = "τ + k g(q), with the gravity g of the bodies as given"
    signature = "torques feel the bodies' inertia, and hardly their weight"
    confused_with = ("gravity_tilt", "rotor_inertia")
    remedy = "hold the machine in two postures: torques that hardly differ lack gravity"
    not_integrable = "the log's torques lack gravity, which no simulated drive does"
    source = "Haddadin et al., IEEE Robot. Autom. Mag. 29(2), 2022: the Panda's interface"

    @classmethod
    def candidates(cls, sites: Sites) -> list[tuple[str, ...]]:
        # no controller holds a body that flies, or subtracts from a torque that nobody measures
        return [()] if sites.sensed and not sites.flying else []

    def correction(self, s: Signals) -> Correction:
        return Correction(compensated=s.shape["k"])


class Geometry(Correcting):
    """A length that differs from the URDF's."""

    kind = "geometry"
    noun = "another length"
    rare = True
    sits = "place"
    candidate_sites = "length"
    watched = "request"
    shapes = (
        Unknown("Delta", ("m", "m"), "displacement along the axis", range=(-DISPLACED, DISPLACED)),
    )
    equation = "place <joint>.<x|y|z> or <closure>.<a|b>.<x|y|z> moved by Delta"
    signature = "coupling and gravity terms are wrong in proportion"
    confused_with = ("inertias and centres of mass", "encoder_offset")
    remedy = "measure this length, or log passive joints' angles too"
    source = "Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, ch. 6"

    def correction(self, s: Signals) -> Correction:
        return Correction(displaced={self.joints[0]: s.shape["Delta"]})


class ClosureCompliance(Correcting):
    """A closure that yields under its force."""

    kind = "closure_compliance"
    rare = True
    sits = "closure"
    candidate_sites = "loop"
    watched = "always"
    not_integrable = (
        "a closure that yields would vibrate, and this effect has no inertia to do it with"
    )
    shapes = (Unknown("C", ("m/N", "m/N"), "compliance", nonnegative=True, range=(0.0, SOFTEST)),)
    equation = "Φ = C λ, in the directions in which λ is a force"
    signature = "dependent joints leave the closure, and inertias act, as λ changes"
    confused_with = ("geometry",)
    remedy = "log passive joints' angles too, under a known load"
    source = "Pashkevich, Chablat, Wenger, Mech. Mach. Theory 44(5), 2009"
    implicit = True

    def correction(self, s: Signals) -> Correction:
        return Correction(gap={self.joints[0]: s.shape["C"]})
