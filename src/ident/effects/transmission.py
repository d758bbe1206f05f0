"""Joints that are not rigid: a spring, or play, between a motor and its link.

The encoder is on the motor, and the link moves on its own, with the load L that the logged motion
would need of it (torque of all bodies) for its force, and M, what it carries, for its inertia:

    link = motor − δ,        M δ̈ + D δ̇ + K δ = L,       or  M δ̈ = L between two stops

to first order in δ, with which L changes too: its slopes along q and v join K and D.

Friction and rotor of the joint are those of its motor, the bodies move with the link.
"""

from __future__ import annotations

import numpy as np

from ident.effects.effect import Bounds, Correcting, Correction, Shape, Signals, Unknown
from ident.errors import MechanismError
from ident.information.oscillator import sprung, with_play

WIDTHS = 10  # work: from which a search of a play starts
SLIGHT = 0.05  # range: damping ratio from which a search starts, and 1 to which it goes
STRONG, EVERY = 0.3, 4  # range: another one, from every fourth resonance: it hides no lower one
LONGEST_TWIST = 0.1  # range: [rad], or of a sliding joint's travel, at the rms load
HOLDS = 0.7  # range: of the softest spring that holds a link which gravity pulls to one side
RATIO = 1.15  # work: of the resonances from which a search starts
MOST_STARTS = 24  # work
ABOVE = 6.0  # range: times the frequency of the acceleration, up to which resonances are searched
WIDE = 8.0  # range: times the lowest resonance, up to which they are searched at least
SETTLED, LONGEST_SETTLED = 0.05, 1.0  # range: share of a log, and [s], until it swings as it is
# driven, whatever it did before the log
SOFTEST_SWING = 0.3  # range: [Hz] below which a joint swings that nobody calls stiff


def _step(s: Signals) -> float:
    return float(s.t[1] - s.t[0]) if len(s.t) > 1 else 1.0


def _at_rest(s: Signals) -> bool:
    """Return whether nothing moves, as in a table of poses: their order is no time."""
    return not (s.v.any() or s.a.any())


def _inertia(s: Signals) -> np.ndarray:
    """Inertia (n,) of the link, nowhere below a hundredth of its median."""
    M = np.abs(s.load_slopes[2, :, 0])
    return np.asarray(np.maximum(M, max(1e-2 * float(np.median(M)), 1e-12)))


class Elasticity(Correcting):
    """A spring between motor and link, with damping: the link swings behind the motor's encoder."""

    kind = "elasticity"
    watched = "request"
    asks = ("load",)
    rare = True
    sits = "driven"
    extent = "compliance"
    whole_log = True  # the link swings on
    shapes = (
        Unknown("compliance", ("rad/(N m)", "m/N"), "1/K, twist a unit of torque", True),
        Unknown("damping", ("N m s/rad", "N s/m"), "D, between motor and link", True),
    )
    equation = "q = q_logged − δ, M δ̈ + D δ̇ + δ/compliance = load; friction is before it"
    signature = "the residual is large near one frequency, with the load's second derivative below"
    confused_with = ("delay", "rotor_inertia")
    remedy = "log a motion that reaches to the frequency at which {joint} swings on its spring"
    source = "Spong, ASME J. Dyn. Syst. Meas. Control 109(4), 1987"
    implicit = True
    by_load = True

    def correction(self, s: Signals) -> Correction:
        rest = s.load_at_rest
        twist = -self.twists(s, s.load, None if rest is None else rest[:1])[:, :, 0]
        if _at_rest(s):
            return Correction(twist={self.joints[0]: twist})
        since = min(SETTLED * float(s.t[-1] - s.t[0]), LONGEST_SETTLED)
        return Correction(twist={self.joints[0]: twist}, since=since)

    def twists(
        self, s: Signals, loads: np.ndarray, at_rest: np.ndarray | None = None
    ) -> np.ndarray:
        compliance, damping = s.shape["compliance"], s.shape["damping"]
        stiffness, damps, _ = s.load_slopes[:, :, 0]
        gravity = float(stiffness.min(initial=0.0))
        if 1 + compliance * gravity <= 0:
            raise MechanismError(
                f"effect '{self.label}': compliance = {compliance:.3g}: so soft a spring does not "
                f"hold the link, which pulls with {-gravity:.3g} a unit; give less than "
                f"{-1 / gravity:.3g}"
            )
        if _at_rest(s):
            twists = compliance * loads / (1 + compliance * stiffness[:, None])
            return np.stack([twists, *np.zeros((2, *loads.shape))])
        carried = _inertia(s), damps, stiffness
        if at_rest is not None:
            at_rest = compliance * at_rest / (1 + compliance * stiffness[0])
        return sprung(_step(s), loads, carried, compliance, max(damping, 0.0), at_rest, s.finest)

    def frequency(self, s: Signals) -> float:
        compliance, M = s.shape["compliance"], float(np.median(_inertia(s)))
        return 1 / (2 * np.pi * np.sqrt(compliance * M)) if compliance > 0 else 0.0

    def bounds(self, s: Signals) -> Bounds:
        softest = self._softest(s)
        compliance = abs(s.shape.get("compliance", 0.0)) or softest
        most = 2 * np.sqrt(float(np.median(_inertia(s))) / compliance)  # no overshoot
        return {"compliance": (0.0, softest), "damping": (0.0, float(most))}

    def starts(self, s: Signals) -> list[Shape]:
        # resonances in equal ratios from the softest spring to above the motion
        M, softest = float(np.median(_inertia(s))), self._softest(s)
        jerk, a = np.gradient(s.a[:, 0], _step(s)) if len(s.t) > 1 else s.a[:, 0], s.a[:, 0]
        rms = [float(np.sqrt(np.mean(x**2))) for x in (jerk, a)]
        low = max(1 / np.sqrt(softest * M), 2 * np.pi * SOFTEST_SWING)  # [rad/s]
        top = max(ABOVE * rms[0] / max(rms[1], 1e-12), WIDE * low)
        top = min(top, np.pi / (2 * _step(s)))
        count = int(np.clip(np.log(max(top / low, 1.0)) / np.log(RATIO), 2, MOST_STARTS))
        swings = np.geomspace(low, max(top, 1.5 * low), count)
        ratios = [(w, SLIGHT) for w in swings] + [(w, STRONG) for w in swings[::-EVERY]]
        every = [(float(1 / (M * w**2)), float(2 * ratio * M * w)) for w, ratio in ratios]
        return [{"compliance": c, "damping": D} for c, D in every]

    def _softest(self, s: Signals) -> float:
        """Compliance that twists by so much at the rms load, and with which it holds the link."""
        low, high = s.travel[0]
        most = LONGEST_TWIST * (1.0 if self.rotational else float(high - low))
        softest = most / max(float(np.sqrt(np.mean(s.load**2))), 1e-9)
        gravity = -float(s.load_slopes[0, :, 0].min(initial=0.0))
        return min(softest, HOLDS / gravity) if gravity > 0 else softest


class Backlash(Correcting):
    """Play between motor and link: the link flies from one side to the other."""

    kind = "backlash"
    noun = "play"
    watched = "request"
    slow = True
    at_reversals = True
    whole_log = True
    asks = ("load",)
    rare = True
    sits = "driven"
    extent = "width"
    shapes = (Unknown("width", ("rad", "m"), "of the play", nonnegative=True),)
    equation = "q = q_logged − δ, |δ| ≤ width/2, and M δ̈ = load between the two sides"
    signature = "the residual jumps or spikes where the torque changes its sign"
    confused_with = ("coulomb", "delay", "elasticity")
    source = "Nordin, Gutman, Automatica 38(10), 2002"
    implicit = True

    def correction(self, s: Signals) -> Correction:
        width = max(s.shape["width"], 0.0)
        if _at_rest(s):
            twist = 0.5 * width * np.sign(s.load[:, 0])
        else:
            twist = with_play(_step(s), s.load[:, 0], _inertia(s), width)
        position = twist if twist.ndim == 1 else twist[0]
        if not position.min(initial=0.0) < 0.0 < position.max(initial=0.0):
            return Correction()  # on one side throughout it is a zero of the encoder
        return Correction(twist={self.joints[0]: -twist})

    def bounds(self, s: Signals) -> Bounds:
        # up to a tenth of the travel, of a joint that turns round no more than a twist is
        low, high = s.travel[0]
        most = min(0.1 * (high - low), LONGEST_TWIST if self.rotational else np.inf)
        return {"width": (0.0, max(float(most), 1e-6))}

    def starts(self, s: Signals) -> list[Shape]:
        # from a two-thousandth of the travel to a fifteenth, in equal ratios
        most = self.bounds(s)["width"][1]
        return [{"width": float(width)} for width in np.geomspace(0.005, 0.7, WIDTHS) * most]
