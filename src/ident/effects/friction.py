"""Friction in a joint, from the classic sum of terms to presliding."""

from __future__ import annotations

from itertools import pairwise
from typing import ClassVar

import numpy as np

from ident.effects.effect import Bounds, Effect, Shape, Signals, Unknown

ARMSTRONG = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994"


def direction(v: np.ndarray, still: np.ndarray) -> np.ndarray:
    """sign(v), but smooth within the speeds at which a joint counts as standing still.

    At standstill friction takes any value between −Fc and +Fc, so neither +1 nor −1 would be true.
    A filtered row sees how a reversal differs from that of sign(v) by ∫ (sign(v) − f(v)) t dt. Of
    f = 9/4 x − 5/4 x³, x = v / still, that is zero: Fc does not depend on `still`. It would by 3e-4
    with f = x, which is three standard errors after an hour at 1 kHz.
    """
    x = np.clip(v / still, -1.0, 1.0)
    return np.asarray(x * (2.25 - 1.25 * x**2))


class Viscous(Effect):
    """Friction torque in proportion to speed."""

    kind = "viscous"
    model_words = ("damping",)
    common = True
    companions = ("coulomb",)
    watched = "always"
    unknowns = (
        Unknown("Fv", ("N m s/rad", "N s/m"), "viscous friction coefficient", True, acts="linear"),
    )
    equation = "Fv v"
    signature = "the residual against speed is a straight line through zero"
    confused_with = ("drag", "torque_gain", "delay")
    separated_by: ClassVar = {
        "torque_gain": "repeat the motion with a known mass on the last link",
        "delay": "log two frequencies, the higher at least three times the lower",
    }
    source = ARMSTRONG

    def columns(self, s: Signals) -> np.ndarray:
        return s.v[:, :, None]


class Dry(Effect):
    """Friction that has the sign of the speed: at standstill it may be anything."""

    def informed(self, s: Signals) -> np.ndarray:
        return np.abs(s.v) >= s.still


class Coulomb(Dry):
    """Dry friction: constant against the direction of motion."""

    kind = "coulomb"
    model_words = ("frictionloss", "friction")
    common = True
    companions = ("viscous",)
    watched = "always"
    unknowns = (Unknown("Fc", ("N m", "N"), "Coulomb friction", True, acts="level"),)
    equation = "Fc sign(v); a sample at standstill does not inform it"
    signature = "the residual against speed is a step at zero: two level bands"
    confused_with = ("stribeck", "hysteresis", "load_friction", "delay")
    separated_by: ClassVar = {
        "load_friction": "repeat the motion with a known payload: load friction grows"
    }
    nested_in = ("stribeck", "hysteresis")  # their limits for large vs, small z0
    source = ARMSTRONG

    def columns(self, s: Signals) -> np.ndarray:
        return direction(s.v, s.still)[:, :, None]


class Stribeck(Dry):
    """Dry friction that is higher at low speed."""

    kind = "stribeck"
    slow = True
    unknowns = (
        Unknown("Fs", ("N m", "N"), "friction at the least speed beyond Coulomb", True, acts="dry"),
    )
    shapes = (
        Unknown("vs", ("rad/s", "m/s"), "speed at which it has fallen to 1/e", nonnegative=True),
    )
    equation = "Fs sign(v) exp(−(v/vs)²)"
    signature = "the residual against speed has a hump on either side of zero"
    confused_with = ("coulomb", "hysteresis", "delay")
    source = ARMSTRONG

    def columns(self, s: Signals) -> np.ndarray:
        fade = np.exp(-((s.v / s.shape["vs"]) ** 2))
        return (direction(s.v, s.still) * fade)[:, :, None]

    def bounds(self, s: Signals) -> Bounds:
        # from twice standstill to the top speed
        top = float(np.abs(s.v).max(initial=0.0)) or 1.0
        return {"vs": (min(max(2 * float(s.still[0]), 0.005 * top), 0.5 * top), top)}

    def starts(self, s: Signals) -> list[Shape]:
        # six speeds in equal ratios
        low, high = self.bounds(s)["vs"]
        return [{"vs": float(vs)} for vs in np.geomspace(2 * low, 0.7 * high, 6)]


class Drag(Effect):
    """Resistance of a fluid: with the square of speed."""

    kind = "drag"
    watched = "request"
    unknowns = (Unknown("Fd", ("N m s²/rad²", "N s²/m²"), "drag coefficient", nonnegative=True),)
    equation = "Fd v |v|"
    signature = "the residual against speed is a parabola, turned over below zero"
    confused_with = ("viscous", "coulomb")
    source = "Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, ch. 6"

    def columns(self, s: Signals) -> np.ndarray:
        return (s.v * np.abs(s.v))[:, :, None]


class LoadFriction(Dry):
    """Dry friction that grows with the load that the joint passes on."""

    kind = "load_friction"
    tried = "loaded"
    watched = "request"
    unknowns = (
        Unknown("mu", ("1", "1"), "share of the load (closures: a lever in m)", True, acts="dry"),
    )
    equation = "mu |load| sign(v); load: rigid-body torque, in closures |λ|"
    signature = "the two bands of the residual against speed widen with the load"
    confused_with = ("coulomb", "torque_gain")
    source = "Dohring, Lee, Newman, IEEE ICRA 1993; Hamon, Gautier, Garrec, IROS 2010"
    implicit = True
    asks = ("load",)

    def columns(self, s: Signals) -> np.ndarray:
        return (np.abs(s.load) * direction(s.v, s.still))[:, :, None]


class Hysteresis(Effect):
    """Presliding friction: a spring of small reach that yields (Dahl)."""

    kind = "hysteresis"
    slow = True
    unknowns = (
        Unknown("sigma", ("N m/rad", "N/m"), "stiffness before sliding", True, acts="state"),
    )
    shapes = (Unknown("z0", ("rad", "m"), "reach of the spring", nonnegative=True),)
    equation = "sigma z, ż = v − |v| z/z0"
    signature = "the residual against position makes a loop after every reversal"
    confused_with = ("coulomb", "stribeck", "spring")
    source = "Dahl, A Solid Friction Model, Aerospace Corp. TOR-0158(3107-18)-1, 1968"
    memory = True
    fades = True

    def state_rate(self, z: np.ndarray, v: np.ndarray, shape: Shape) -> np.ndarray:
        return v - np.abs(v) * z / shape["z0"]

    def columns(self, s: Signals) -> np.ndarray:
        """E = z; between reversals exact: z → ±z0 + (z ∓ z0) exp(−|Δq|/z0)."""
        z0, n = s.shape["z0"], len(s.q)
        z = np.zeros_like(s.q)
        for j in range(s.q.shape[1]):
            way = np.sign(np.diff(s.q[:, j], append=s.q[-1:, j]))[: max(n - 1, 1)]
            turns = np.flatnonzero(np.diff(way)) + 1  # z is one exponential between two reversals
            for a, b in pairwise([0, *turns, n - 1]):
                goal = z0 * way[a]
                path = np.abs(s.q[a + 1 : b + 1, j] - s.q[a, j])
                z[a + 1 : b + 1, j] = goal + (z[a, j] - goal) * np.exp(-path / z0)
        return z[:, :, None]

    def bounds(self, s: Signals) -> Bounds:
        # from a two-thousandth of the travel to a quarter of it
        low, high = s.travel[0]
        return {"z0": (max((high - low) / 2000, 1e-9), max((high - low) / 4, 1e-8))}

    def starts(self, s: Signals) -> list[Shape]:
        # six reaches in equal ratios
        low, high = self.bounds(s)["z0"]
        return [{"z0": float(z0)} for z0 in np.geomspace(4 * low, 0.7 * high, 6)]


class TemperatureFriction(Effect):
    """Viscous friction that changes with temperature."""

    kind = "temperature_friction"
    unknowns = (Unknown("kappa", ("1/K", "1/K"), "relative change a degree"),)
    settings: ClassVar = {"T0": 25.0}
    equation = "Fv v kappa (T − T0), Fv of `viscous`; T: temperature.<joint>; T0 25"
    signature = "the slope of the residual against speed changes with temperature"
    confused_with = ("drift", "viscous at constant temperature")
    separated_by: ClassVar = {"drift": "log the motors' temperatures, `temperature.<joint>`"}
    source = "Bittencourt, Wernholt, Sander-Tavallaey, Brogårdh, IROS 2010"
    needs = ("viscous",)
    implicit = True

    def reads(self) -> tuple[str, ...]:
        return (f"temperature.{self.joints[0]}",)

    def columns(self, s: Signals) -> np.ndarray:
        Fv = s.present.get(f"viscous.{self.joints[0]}.Fv", 1.0)
        (T,) = (s.extra[name] for name in self.reads())
        return (Fv * s.v * (T[:, None] - self.setting("T0")))[:, :, None]
