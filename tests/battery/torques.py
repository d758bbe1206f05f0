"""Torques that a joint must supply beyond rigid bodies, one small function a kind.

A maker takes the parameters and the step and gives f(t, q, v, a, load, other): the joint's own
position, speed and acceleration, its rigid-body load, and another joint's position. Kinds with
memory keep it in the closure, so a maker is called anew for every run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

Values = Mapping[str, float]
Torque = Callable[[float, float, float, float, float, float], float]
STILL = 5e-3  # [rad/s] sign(v) is smooth below, else explicit steps chatter


def sign(v: float) -> float:
    return math.tanh(v / STILL)


def viscous(p: Values, _: float) -> Torque:
    return lambda t, q, v, a, load, other: p["Fv"] * v


def coulomb(p: Values, _: float) -> Torque:
    return lambda t, q, v, a, load, other: p["Fc"] * sign(v)


def stribeck(p: Values, _: float) -> Torque:
    return lambda t, q, v, a, load, other: p["Fs"] * sign(v) * math.exp(-((v / p["vs"]) ** 2))


def load_friction(p: Values, _: float) -> Torque:
    return lambda t, q, v, a, load, other: p["mu"] * abs(load) * sign(v)


def hysteresis(p: Values, step: float) -> Torque:
    """σ z with ż = v − |v| z/z0, exact over a step of constant speed."""
    z, z0 = 0.0, p["z0"]

    def torque(t: float, q: float, v: float, a: float, load: float, other: float) -> float:
        nonlocal z
        end = math.copysign(z0, v)
        z = end + (z - end) * math.exp(-abs(v) * step / z0)
        return p["sigma"] * z

    return torque


def drag(p: Values, _: float) -> Torque:
    return lambda t, q, v, a, load, other: p["Fd"] * v * abs(v)


def spring(p: Values, _: float) -> Torque:
    return lambda t, q, v, a, load, other: p["k"] * q + p["b"]


def cable(p: Values, _: float) -> Torque:
    return lambda t, q, v, a, load, other: p["k1"] * q + p["k3"] * q**3


def end_stop(p: Values, _: float) -> Torque:
    return lambda t, q, v, a, load, other: p["k"] * max(0.0, q - p["q1"])


def rotor_inertia(p: Values, _: float) -> Torque:
    return lambda t, q, v, a, load, other: p["Ia"] * a


def coupling(p: Values, _: float) -> Torque:
    """Along the sum of two joints."""
    return lambda t, q, v, a, load, other: p["Im"] * a + p["Fvm"] * v + p["Fcm"] * sign(v)


def ripple(p: Values, _: float) -> Torque:
    return lambda t, q, v, a, load, other: (
        p["A"] * math.sin(p["N"] * q) + p["B"] * math.cos(p["N"] * q)
    )


def temperature_friction(p: Values, _: float) -> Torque:
    """Only what warmth changes: the viscous part at T0 = 25 °C is an effect of its own."""
    return lambda t, q, v, a, load, other: p["Fv"] * p["kappa"] * (temperature(t) - 25.0) * v


def temperature(t: float) -> float:
    """A motor that warms up [°C]."""
    return 20.0 + 25.0 * (1 - math.exp(-max(t, 0.0) / 5.0))


# --- not in the library -------------------------------------------------------------------------


def friction_decay(p: Values, _: float) -> Torque:
    """Dry friction that fades while the joint runs in."""
    return lambda t, q, v, a, load, other: p["F"] * math.exp(-max(t, 0.0) / 2.5) * sign(v)


def position_friction(p: Values, _: float) -> Torque:
    """Dry friction that changes around the turn, of both signs about the mean."""
    return lambda t, q, v, a, load, other: p["F"] * math.sin(3 * q + 0.7) * sign(v)


def cross_spring(p: Values, _: float) -> Torque:
    """A cable across two joints, stiffer the further the other is bent."""
    return lambda t, q, v, a, load, other: p["k"] * q * other


def slosh(p: Values, step: float) -> Torque:
    """A flywheel on a spring of its own: 3 Hz, lightly damped, unseen."""
    x, rate, w, zeta = 0.0, 0.0, 2 * math.pi * 3.0, 0.03

    def torque(t: float, q: float, v: float, a: float, load: float, other: float) -> float:
        nonlocal x, rate
        pull = w * w * x + 2 * zeta * w * rate
        rate += step * (-pull - a)
        x += step * rate
        return -p["J"] * pull

    return torque


def disturbance(p: Values, _: float) -> Torque:
    """Something else that shakes, at 1.7 Hz whatever the joint does."""
    return lambda t, q, v, a, load, other: p["A"] * math.sin(2 * math.pi * 1.7 * t + 0.4)


def bump(p: Values, _: float) -> Torque:
    """Friction in one place of the range: a damaged bearing."""
    return lambda t, q, v, a, load, other: p["F"] * v * math.exp(-(((q - p["q1"]) / 0.12) ** 2))


def late_friction(p: Values, step: float) -> Torque:
    """Viscous friction of the speed a while ago: a film that builds up in 0.4 s."""
    film = 0.0

    def torque(t: float, q: float, v: float, a: float, load: float, other: float) -> float:
        nonlocal film
        film += step / 0.4 * (v - film)
        return p["F"] * film

    return torque


TORQUES: Mapping[str, Callable[[Values, float], Torque]] = {
    make.__name__: make
    for make in (
        viscous, coulomb, stribeck, load_friction, hysteresis, drag, spring, cable, end_stop,
        rotor_inertia, coupling, ripple, temperature_friction, friction_decay, position_friction,
        cross_spring, slosh, disturbance, bump, late_friction,
    )
}  # fmt: skip
SENSORS = (
    "torque_offset", "torque_gain", "delay", "encoder_offset", "drift", "elasticity", "saturation",
)  # fmt: skip
OUTSIDE = (
    "friction_decay", "position_friction", "cross_spring", "slosh", "disturbance", "bump",
    "late_friction", "saturation",
)  # fmt: skip
NATIVE = ("viscous", "coulomb", "spring", "rotor_inertia", "coupling")  # MuJoCo's own
