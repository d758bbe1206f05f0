"""Errors of what is taken to be known: encoders, gravity, lengths, stiffness of joints and loops.

These correct the data or the mechanism, not the torque: q → q + δ, g → Rᵀg, …
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ident.effects.effect import Bounds, Correcting, Correction, Signals, Unknown

TILT = 0.35  # [rad] 20° of a base that is not level, or of an encoder's zero
DISPLACED = 0.05  # [m] of an error of a drawing
SOFTEST = 1e-4  # [m/N] of a closure: a millimetre at ten newtons


class EncoderOffset(Correcting):
    """An encoder whose zero is off, at a joint whose position is logged."""

    kind = "encoder_offset"
    tried = "logged"
    watched = "always"
    shapes = (Unknown("delta", ("rad", "m"), "true minus logged coordinate"),)
    equation = "q = q_logged + delta"
    signature = "the residual of all joints follows the slope of gravity with q"
    confused_with = ("gravity_tilt", "the centre of mass of a last link")
    remedy = "put the joint against a reference, or turn the base about a horizontal axis"
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


class Elasticity(Correcting):
    """A drive that twists under load: the joint lags behind the motor's encoder."""

    kind = "elasticity"
    watched = "request"
    asks = ("load",)
    rare = True
    sits = "driven"
    shapes = (Unknown("compliance", ("rad/(N m)", "m/N"), "1/K, twist a unit of torque", True),)
    equation = "q = q_logged − load/K; load: rigid-body torque, friction is before it"
    signature = "the residual follows the second derivative of the load"
    confused_with = ("delay", "rotor_inertia")
    source = "Spong, ASME J. Dyn. Syst. Meas. Control 109(4), 1987"
    implicit = True

    def correction(self, s: Signals) -> Correction:
        return Correction(dq={self.joints[0]: -s.shape["compliance"] * s.load[:, 0]})

    def bounds(self, s: Signals) -> Bounds:
        # a twist of up to a tenth of a radian, or of the travel, at the rms load
        low, high = s.travel[0]
        most = 0.1 if self.rotational else 0.1 * (high - low)
        return {"compliance": (0.0, most / max(float(np.sqrt(np.mean(s.load**2))), 1e-9))}


class Backlash(Correcting):
    """Play between motor and joint."""

    kind = "backlash"
    watched = "request"
    slow = True
    whole_log = True  # the rms of its load
    asks = ("load",)
    rare = True
    sits = "driven"
    shapes = (Unknown("width", ("rad", "m"), "of the play", nonnegative=True),)
    equation = "q = q_logged − width/2 · sign(load)"
    signature = "the residual jumps or spikes where the torque changes its sign"
    confused_with = ("coulomb", "delay", "elasticity")
    source = "Nordin, Gutman, Automatica 38(10), 2002"
    implicit = True

    def correction(self, s: Signals) -> Correction:
        load = s.load[:, 0]
        side = np.tanh(load / max(0.05 * float(np.sqrt(np.mean(load**2))), 1e-12))
        return Correction(dq={self.joints[0]: -0.5 * s.shape["width"] * side})

    def bounds(self, s: Signals) -> Bounds:
        # up to a tenth of the travel
        low, high = s.travel[0]
        return {"width": (0.0, max(0.1 * (high - low), 1e-6))}


class Geometry(Correcting):
    """A length that differs from the URDF's."""

    kind = "geometry"
    rare = True
    sits = "place"
    tried = "length"
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
        return Correction(moved={self.joints[0]: s.shape["Delta"]})


class ClosureCompliance(Correcting):
    """A closure that yields under its force."""

    kind = "closure_compliance"
    rare = True
    sits = "closure"
    tried = "loop"
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
