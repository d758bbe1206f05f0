"""Effects in a joint: friction, springs, cables, end stops, ripple; and what a link carries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ident.effects.effect import NOWHERE, SAMPLED, Bounds, Effect, Shape, Signals, Unknown
from ident.errors import MechanismError

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


def direction_in(s: Signals, joints: Sequence[str]) -> np.ndarray:
    """sign(v) (n, joints); where a drive supplies a joint's torque its mean over a sample's time h.

    A command goes on smoothly where friction turns: the jump is in the acceleration, of which a
    spline knows means. sign(v) at the sample would have it up to h/2 early or late, and a friction
    that builds up over |a| h/2 is what a diagnosis then sees. The mean of sign(v + a s), |s| ≤ h/2,
    is v / (|a| h/2) within ±1.
    """
    sign = direction(s.v, s.still)
    for i, joint in enumerate(joints[: s.v.shape[1]]):
        step = s.extra.get(SAMPLED + joint)
        if step is not None:
            half = 0.5 * step * np.abs(s.a[:, i])
            mean = np.clip(s.v[:, i] / np.maximum(half, s.still[i]), -1.0, 1.0)
            sign[:, i] = np.where(half > s.still[i], mean, sign[:, i])
    return sign


class Viscous(Effect):
    """Friction torque in proportion to speed."""

    kind = "viscous"
    smooth = True
    noun = "viscous friction"
    model_words = ("damping",)
    common = True
    nested_in = ("friction_width",)  # its limit where it builds up over all speeds
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

    jumps = True

    def informed(self, s: Signals) -> np.ndarray:
        return np.abs(s.v) >= s.still


class Coulomb(Dry):
    """Dry friction: constant against the direction of motion."""

    kind = "coulomb"
    noun = "dry friction"
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
        return direction_in(s, self.joints)[:, :, None]


class ReversalPulses(Effect):
    """What is left of dry friction that is early or late, or builds up over some speed."""

    # Friction Fc f(v + T a) that differs from Fc sign(v) around a reversal only is, in rows whose
    # filter is slower than that, a pulse with the first moments of the difference; the first one,
    # ∫ (f − sign(v)) dt = 2 T sign(a), is the same at all reversals. So is friction that sticks
    # while a servo's command goes on. A diagnosis has these pulses beside the dry friction of a
    # model, and a fit of drives has them too: delay and damping would take them over.
    kind = "reversal_pulses"
    noun = "dry friction that is early or late"
    candidate_sites = NOWHERE
    in_rows_alone = True
    unknowns = (
        Unknown("I1", ("N m s", "N s"), "torque at reversals times its duration"),
        Unknown("I2", ("N m s²", "N s²"), "its first moment in time"),
    )
    equation = "I1 d/dt sign(v) + I2 d²/dt² sign(v)"
    signature = "the residual has pulses at reversals"
    source = ARMSTRONG

    def columns(self, s: Signals) -> np.ndarray:
        if len(s.t) < 2:  # of one sample no rate is known
            return np.zeros((*s.v.shape, 2))
        first = np.gradient(direction_in(s, self.joints), s.t, axis=0)
        return np.stack([first, np.gradient(first, s.t, axis=0)], axis=-1)


class OverSpeed(Effect):
    """Friction whose only shape parameter is a speed."""

    slow = True

    def bounds(self, s: Signals) -> Bounds:
        # from twice standstill to the top speed
        top = float(np.abs(s.v).max(initial=0.0)) or 1.0
        least = min(max(2 * float(s.still[0]), 0.005 * top), 0.5 * top)
        return {self.shapes[0].name: (least, top)}

    def starts(self, s: Signals) -> list[Shape]:
        # six speeds in equal ratios
        ((name, (low, high)),) = self.bounds(s).items()
        return [{name: float(x)} for x in np.geomspace(2 * low, 0.7 * high, 6)]


class Stribeck(Dry, OverSpeed):
    """Dry friction that is higher at low speed."""

    kind = "stribeck"
    noun = "extra dry friction at low speed"
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
        return (direction_in(s, self.joints) * fade)[:, :, None]


class FrictionWidth(OverSpeed):
    """Dry friction that builds up over some speed instead of jumping at zero."""

    kind = "friction_width"
    noun = "dry friction that builds up over speed"
    needs = ("coulomb",)
    unknowns = (Unknown("Fw", ("N m", "N"), "friction that builds up, about Fc", True, acts="dry"),)
    shapes = (
        Unknown("w", ("rad/s", "m/s"), "speed at which all of it is there", nonnegative=True),
    )
    equation = "Fw (sat(v/w) − sign(v)), sat within ±1, beside `coulomb`"
    signature = "the residual against speed has a jump at zero that slopes back on either side"
    confused_with = ("stribeck", "viscous", "hysteresis")
    separated_by: ClassVar = {"stribeck": "move the joint slowly, to and fro"}
    source = "Todorov, Convex and analytically-invertible dynamics, IEEE ICRA 2014 (MuJoCo)"

    def columns(self, s: Signals) -> np.ndarray:
        part = np.clip(s.v / s.shape["w"], -1.0, 1.0)
        return (part - direction_in(s, self.joints))[:, :, None]


class DirectionFriction(Effect):
    """Friction whose level and slope differ by the direction of motion."""

    # forward Fc + dFc and Fv + dFv, backward Fc − dFc and Fv − dFv; at rest the limits of friction
    # are these levels too, so that dFc is a constant, which `torque_offset` is by itself

    kind = "direction_friction"
    by_direction = True
    noun = "friction that differs by direction"
    unknowns = (
        Unknown("dFc", ("N m", "N"), "half of the difference of the levels", acts="linear"),
        Unknown("dFv", ("N m s/rad", "N s/m"), "half of the difference of the slopes"),
    )
    equation = "dFc + dFv |v|, beside `coulomb` and `viscous`"
    signature = "the two bands of the residual against speed differ in height and in slope"
    confused_with = ("torque_offset", "drag", "load_friction")
    separated_by: ClassVar = {
        "torque_offset": "move the joint at two speeds, to and fro: an offset is the same at both"
    }
    source = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994, sect. 2"

    def columns(self, s: Signals) -> np.ndarray:
        return np.stack([np.ones_like(s.v), np.abs(s.v)], axis=-1)


class PositionFriction(Dry):
    """Dry friction that changes along the joint's way: a cable, a seal, a rod that tightens."""

    kind = "position_friction"
    noun = "dry friction that changes along the way"
    candidate_sites = "commanded"  # where a torque is measured, formulas name more forms of it
    unknowns = (
        Unknown("F1", ("N m/rad", "N/m"), "slope of dry friction over position", acts="dry"),
        Unknown("F2", ("N m/rad²", "N/m²"), "half of its curvature", acts="dry"),
    )
    equation = "(F1 q + F2 q²) sign(v), beside `coulomb`"
    signature = "the two bands of the residual against position are not parallel"
    confused_with = ("load_friction", "coulomb")
    separated_by: ClassVar = {
        "load_friction": "repeat the motion with a known payload: load friction grows"
    }
    source = "Bittencourt, Wernholt, Sander-Tavallaey, Brogårdh, IEEE/RSJ IROS 2010"

    def columns(self, s: Signals) -> np.ndarray:
        return np.stack([s.q, s.q**2], axis=-1) * direction_in(s, self.joints)[:, :, None]


class Drag(Effect):
    """Resistance of a fluid: with the square of speed."""

    kind = "drag"
    noun = "fluid drag"
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
    noun = "dry friction that grows with load"
    candidate_sites = "loaded"
    watched = "request"
    unknowns = (
        Unknown("mu", ("1", "1"), "share of the load (closures: a lever in m)", True, acts="dry"),
    )
    equation = "mu |load| sign(v); load: torque of all bodies, in closures |λ|"
    signature = "the two bands of the residual against speed widen with the load"
    confused_with = ("coulomb", "torque_gain")
    source = "Dohring, Lee, Newman, IEEE ICRA 1993; Hamon, Gautier, Garrec, IROS 2010"
    implicit = True
    asks = ("load",)

    def columns(self, s: Signals) -> np.ndarray:
        return (np.abs(s.load) * direction_in(s, self.joints))[:, :, None]


class Hysteresis(Effect):
    """Presliding friction: a spring of small reach that yields (Dahl)."""

    kind = "hysteresis"
    noun = "presliding friction"
    slow = True
    at_reversals = True
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
        for j, q in enumerate(s.q.T):
            way = np.sign(np.diff(q, append=q[-1:]))[: max(n - 1, 1)]
            # z is one exponential between two reversals
            ends = np.concatenate([[0], np.flatnonzero(np.diff(way)) + 1, [n - 1]])
            first, goal = q[ends[:-1]], z0 * way[ends[:-1]]
            fading, at_reversals = np.exp(-np.abs(q[ends[1:]] - first) / z0), [0.0]
            for end, share in zip(goal.tolist(), fading.tolist(), strict=True):
                at_reversals.append(end + (at_reversals[-1] - end) * share)
            stretch = np.repeat(np.arange(len(goal)), np.diff(ends))  # of each sample but the first
            start, goal = np.array(at_reversals)[stretch], goal[stretch]
            z[1:, j] = goal + (start - goal) * np.exp(-np.abs(q[1:] - first[stretch]) / z0)
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
    noun = "friction that changes with temperature"
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


RAISED = ("⁰", "", "²", "³", "⁴", "⁵", "⁶", "⁷")  # powers of a cable's polynomial
PART = 0.8  # range: of a wave in the travel: the least that a search may end at; it begins at one


class Spring(Effect):
    """A linear spring across a joint, with its preload."""

    kind = "spring"
    smooth = True
    of_position = True
    model_words = ("stiffness", "spring_stiffness")
    watched = "request"
    unknowns = (
        Unknown("k", ("N m/rad", "N/m"), "stiffness", True, acts="linear"),
        Unknown("b", ("N m", "N"), "torque at q = 0", acts="linear"),
    )
    equation = "k q + b"
    signature = "the residual against position is a straight line, at rest as well"
    confused_with = ("gravity over a small range", "torque_offset", "cable")
    remedy = "tilt the base by a known angle, so that gravity changes and springs do not"
    separated_by: ClassVar = {
        "gravity_tilt": "repeat the motion with the base tilted by a known angle",
        "encoder_offset": "repeat the motion with the base tilted by a known angle",
    }
    nested_in = ("cable",)
    source = "Hooke, De Potentia Restitutiva, 1678"

    def columns(self, s: Signals) -> np.ndarray:
        return np.stack([s.q, np.ones_like(s.q)], axis=-1)


class Cable(Effect):
    """Hoses and cables along a joint: a smooth curve over position."""

    kind = "cable"
    smooth = True
    noun = "pull of hoses and cables"
    of_position = True
    descriptive = True
    settings: ClassVar = {"degree": 3.0}
    equation = "k0 + k1 q + … + kd q^d, degree d ≤ 7 (default 3)"
    signature = "the residual against position is a smooth curve, at rest as well"
    confused_with = ("spring", "gravity over a small range", "end_stop")
    remedy = "tilt the base by a known angle, so that gravity changes and cables do not"
    source = "Lin, Hui, Wang, Deguet, Kazanzides, Au, IEEE Robot. Autom. Lett. 4(4), 2019"

    def __post_init__(self) -> None:
        degree = self.setting("degree")
        if degree not in range(1, len(RAISED)):
            raise MechanismError(f"effect '{self.label}': degree = {degree:g}; valid: 1 to 7")
        super().__post_init__()

    @property
    def unknowns(self) -> tuple[Unknown, ...]:  # type: ignore[override]
        pairs = (("N m", "rad"), ("N", "m"))
        return tuple(
            Unknown(
                f"k{i}", tuple(f"{f}/{q}{raised}" if i else f for f, q in pairs), f"of q{raised}"
            )
            for i, raised in enumerate(RAISED[: int(self.setting("degree")) + 1])
        )

    def columns(self, s: Signals) -> np.ndarray:
        return s.q[:, :, None] ** np.arange(len(self.unknowns))


class EndStop(Effect):
    """A bumper that a joint runs into at one end of its travel."""

    kind = "end_stop"
    of_position = True
    rare = True  # whatever bends over position looks like one
    unknowns = (Unknown("k", ("N m/rad", "N/m"), "stiffness", nonnegative=True),)
    shapes = (
        Unknown("q1", ("rad", "m"), "where it begins"),
        Unknown("side", ("1", "1"), "+1: beyond q1, −1: below q1", discrete=True),
    )
    equation = "k max(0, q − q1) for side +1, k min(0, q − q1) for side −1"
    signature = "the residual against position is flat, then rises at one end"
    confused_with = ("spring", "cable")
    source = "Flores, Lankarani, Contact Force Models for Multibody Dynamics, ch. 2"

    def columns(self, s: Signals) -> np.ndarray:
        side = np.sign(s.shape["side"]) or 1.0
        return (side * np.maximum(side * (s.q - s.shape["q1"]), 0.0))[:, :, None]

    def bounds(self, s: Signals) -> Bounds:
        # within the travel, but for its last hundredth
        low, high = s.travel[0]
        margin = 0.01 * (high - low)
        return {"q1": (low + margin, high - margin), "side": (-1.0, 1.0)}

    def starts(self, s: Signals) -> list[Shape]:
        # the outer thirds, in steps of a twentieth of the travel
        low, high = s.travel[0]
        share = np.linspace(0.05, 0.4, 8)
        ends = ((1.0, high, low), (-1.0, low, high))
        return [{"q1": float(a + x * (b - a)), "side": side} for side, a, b in ends for x in share]

    def possible(self, s: Signals) -> bool:
        # a joint does not pass through a stop: it is nearer to its end of the travel than to the
        # other, or the joint is in it for less than half of the time
        side, middles = np.sign(s.shape["side"]), (s.travel[0].mean(), np.median(s.q))
        return any(side * (s.shape["q1"] - middle) >= 0 for middle in middles)


class Ripple(Effect):
    """A torque that repeats with position: cogging, gear teeth, an eccentric gear."""

    kind = "ripple"
    noun = "torque ripple"
    of_position = True
    waves = "N"
    unknowns = (
        Unknown("A", ("N m", "N"), "of the sine"),
        Unknown("B", ("N m", "N"), "of the cosine"),
    )
    shapes = (Unknown("N", ("1", "rad/m"), "waves a turn (radians a metre)"),)
    equation = "A sin(N q) + B cos(N q)"
    signature = "the residual against position is a wave"
    confused_with = ("gravity, for N = 1", "cable, for less than a wave")
    source = "Piccoli, Yim, Int. J. Robotics Research 35(1-3), 2016"

    def columns(self, s: Signals) -> np.ndarray:
        angle = s.shape["N"] * s.q
        return np.stack([np.sin(angle), np.cos(angle)], axis=-1)

    def bounds(self, s: Signals) -> Bounds:
        # from nearly one wave in the travel to what the samples still resolve
        low, high = s.travel[0]
        lowest = 2 * np.pi / max(high - low, 1e-9)
        step = float(np.quantile(np.abs(np.diff(s.q[:, 0])), 0.9)) if len(s.q) > 1 else 0.0
        finest = np.pi / (4 * max(step, 1e-9))
        return {"N": (PART * lowest, min(max(finest, 2 * lowest), 64 * lowest))}

    def starts(self, s: Signals) -> list[Shape]:
        # steps of a third of what two waves must differ by over the travel to be told apart
        low, high = self.bounds(s)["N"]
        low /= PART
        step = 2 * low / 3
        return [{"N": float(N)} for N in np.arange(low, min(high, low + 96 * step), step)]


class Payload(Effect):
    """A body on a link, with ten parameters about the frame of the link's joint."""

    kind = "payload"
    sits = "link"
    watched = "always"
    unknowns = tuple(
        Unknown(name, (unit, unit), meaning, acts="body")  # a load put down has a negative mass
        for names, unit, meaning in (
            ("m", "kg", "mass"),
            ("mx my mz", "kg m", "first moment"),
            ("Lxx Lxy Lyy Lxz Lyz Lzz", "kg m²", "moment about the joint frame's origin"),
        )
        for name in names.split()
    )
    equation = "Γ_link p: what one more body on the link, with ten parameters p, needs"
    signature = "all joints below the link show one more load, in proportion to it"
    confused_with = ("the link's own parameters, as long as these are unknown",)
    remedy = "log the same motion with the load and without it"
    source = "Khalil, Gautier, Lemoine, IEEE ICRA 2007"

    def columns(self, s: Signals) -> np.ndarray:
        return np.zeros((*s.q.shape, len(self.unknowns)))
