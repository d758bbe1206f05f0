"""Errors of what is taken to be known: encoders, gravity, lengths, stiffness of joints and loops.

These correct the data or the mechanism, not the torque: q → q + δ, g → Rᵀg, …
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ident.effects.effect import Bounds, Correcting, Correction, Signals, Unknown


class EncoderOffset(Correcting):
    """An encoder whose zero is off, at a joint whose position is logged."""

    kind: ClassVar[str] = "encoder_offset"
    tried: ClassVar[str] = "logged"
    watched: ClassVar[str] = "always"
    shapes: ClassVar = (Unknown("delta", ("rad", "m"), "true minus logged coordinate"),)
    equation: ClassVar[str] = "q = q_logged + delta"
    signature: ClassVar[str] = "the residual of all joints follows the slope of gravity with q"
    confused_with: ClassVar = ("gravity_tilt", "the centre of mass of a last link")
    remedy: ClassVar[str] = (
        "put the joint against a reference, or turn the base about a horizontal axis"
    )
    source: ClassVar[str] = "Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, ch. 6"

    def correction(self, s: Signals) -> Correction:
        """q + delta."""
        return Correction(dq={self.joints[0]: s.shape["delta"]})

    def bounds(self, s: Signals) -> Bounds:
        """A fifth of a radian, or of the travel for a sliding joint."""
        low, high = s.travel[0]
        most = 0.35 if self.rotational else max(0.2 * (high - low), 1e-4)
        return {"delta": (-most, most)}


class GravityTilt(Correcting):
    """A base that is not level."""

    kind: ClassVar[str] = "gravity_tilt"
    arity: ClassVar[int] = 0
    sits: ClassVar[str] = "mechanism"
    watched: ClassVar[str] = "always"
    shapes: ClassVar = (
        Unknown("x", ("rad", "rad"), "rotation of the base about its x axis"),
        Unknown("y", ("rad", "rad"), "then about its new y axis"),
    )
    equation: ClassVar[str] = "g → Rᵀ g, R = Rx(x) Ry(y): the base is turned by R"
    signature: ClassVar[str] = "joints that gravity should not feel show it, with their angle"
    confused_with: ClassVar = ("encoder_offset",)
    remedy: ClassVar[str] = "level the base, or turn it about a horizontal axis by a known angle"
    separated_by: ClassVar = {
        "encoder_offset": "repeat it with the first joint turned by a right angle"
    }
    source: ClassVar[str] = "Featherstone, Rigid Body Dynamics Algorithms, ch. 5"

    def correction(self, s: Signals) -> Correction:
        """R = Rx(x) Ry(y)."""
        return Correction(tilt=(s.shape["x"], s.shape["y"]))

    def bounds(self, s: Signals) -> Bounds:
        """Twenty degrees."""
        return {"x": (-0.35, 0.35), "y": (-0.35, 0.35)}


class Elasticity(Correcting):
    """A drive that twists under load: the joint lags behind the motor's encoder."""

    kind: ClassVar[str] = "elasticity"
    watched: ClassVar[str] = "request"
    asks: ClassVar = ("load",)
    rare: ClassVar[bool] = True
    sits: ClassVar[str] = "driven"
    shapes: ClassVar = (
        Unknown("compliance", ("rad/(N m)", "m/N"), "1/K, twist a unit of torque", True),
    )
    equation: ClassVar[str] = (
        "q = q_logged − load/K; load: rigid-body torque, friction is before it"
    )
    signature: ClassVar[str] = "the residual follows the second derivative of the load"
    confused_with: ClassVar = ("delay", "rotor_inertia")
    source: ClassVar[str] = "Spong, ASME J. Dyn. Syst. Meas. Control 109(4), 1987"
    implicit: ClassVar[bool] = True

    def correction(self, s: Signals) -> Correction:
        """q − compliance · load."""
        return Correction(dq={self.joints[0]: -s.shape["compliance"] * s.load[:, 0]})

    def bounds(self, s: Signals) -> Bounds:
        """A twist of up to a tenth of a radian, or of the travel, at the rms load."""
        low, high = s.travel[0]
        most = 0.1 if self.rotational else 0.1 * (high - low)
        return {"compliance": (0.0, most / max(float(np.sqrt(np.mean(s.load**2))), 1e-9))}


class Backlash(Correcting):
    """Play between motor and joint."""

    kind: ClassVar[str] = "backlash"
    watched: ClassVar[str] = "request"
    slow: ClassVar[bool] = True
    whole_log: ClassVar[bool] = True  # the rms of its load
    asks: ClassVar = ("load",)
    rare: ClassVar[bool] = True
    sits: ClassVar[str] = "driven"
    shapes: ClassVar = (Unknown("width", ("rad", "m"), "of the play", nonnegative=True),)
    equation: ClassVar[str] = "q = q_logged − width/2 · sign(load)"
    signature: ClassVar[str] = "the residual jumps or spikes where the torque changes its sign"
    confused_with: ClassVar = ("coulomb", "delay", "elasticity")
    source: ClassVar[str] = "Nordin, Gutman, Automatica 38(10), 2002"
    implicit: ClassVar[bool] = True

    def correction(self, s: Signals) -> Correction:
        """q − width/2 · sign(load), rounded off below a twentieth of its rms."""
        load = s.load[:, 0]
        side = np.tanh(load / max(0.05 * float(np.sqrt(np.mean(load**2))), 1e-12))
        return Correction(dq={self.joints[0]: -0.5 * s.shape["width"] * side})

    def bounds(self, s: Signals) -> Bounds:
        """Up to a tenth of the travel."""
        low, high = s.travel[0]
        return {"width": (0.0, max(0.1 * (high - low), 1e-6))}


class Geometry(Correcting):
    """A length that differs from the URDF's."""

    kind: ClassVar[str] = "geometry"
    rare: ClassVar[bool] = True
    sits: ClassVar[str] = "place"
    tried: ClassVar[str] = "length"
    watched: ClassVar[str] = "request"
    shapes: ClassVar = (Unknown("Delta", ("m", "m"), "displacement along the axis"),)
    equation: ClassVar[str] = "place <joint>.<x|y|z> or <closure>.<a|b>.<x|y|z> moved by Delta"
    signature: ClassVar[str] = "coupling and gravity terms are wrong in proportion"
    confused_with: ClassVar = ("inertias and centres of mass", "encoder_offset")
    remedy: ClassVar[str] = "measure this length, or log passive joints' angles too"
    source: ClassVar[str] = "Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, ch. 6"

    def correction(self, s: Signals) -> Correction:
        """The place moved by Delta."""
        return Correction(moved={self.joints[0]: s.shape["Delta"]})

    def bounds(self, s: Signals) -> Bounds:
        """Five centimetres either way."""
        return {"Delta": (-0.05, 0.05)}


class ClosureCompliance(Correcting):
    """A closure that yields under its force."""

    kind: ClassVar[str] = "closure_compliance"
    rare: ClassVar[bool] = True
    sits: ClassVar[str] = "closure"
    tried: ClassVar[str] = "loop"
    watched: ClassVar[str] = "always"
    not_integrable: ClassVar[str] = (
        "a closure that yields would vibrate, and this effect has no inertia to do it with"
    )
    shapes: ClassVar = (Unknown("C", ("m/N", "m/N"), "compliance", nonnegative=True),)
    equation: ClassVar[str] = "Φ = C λ, in the directions in which λ is a force"
    signature: ClassVar[str] = "dependent joints leave the closure, and inertias act, as λ changes"
    confused_with: ClassVar = ("geometry",)
    remedy: ClassVar[str] = "log passive joints' angles too, under a known load"
    source: ClassVar[str] = "Pashkevich, Chablat, Wenger, Mech. Mach. Theory 44(5), 2009"
    implicit: ClassVar[bool] = True

    def correction(self, s: Signals) -> Correction:
        """Φ = C λ."""
        return Correction(gap={self.joints[0]: s.shape["C"]})

    def bounds(self, s: Signals) -> Bounds:
        """Up to a millimetre at ten newtons."""
        return {"C": (0.0, 1e-4)}
