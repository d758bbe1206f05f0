"""Torques that depend on position: springs, cables, end stops, ripple; what a link carries."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ident.effects.effect import Bounds, Effect, Shape, Signals, Unknown
from ident.errors import MechanismError

RAISED = ("⁰", "", "²", "³", "⁴", "⁵", "⁶", "⁷")  # powers of a cable's polynomial
PART = 0.8  # of a wave in the travel: the least that a search may end at; it begins at one


class Spring(Effect):
    """A linear spring across a joint, with its preload."""

    kind = "spring"
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
        upper = [{"q1": float(high - x * (high - low)), "side": 1.0} for x in share]
        lower = [{"q1": float(low + x * (high - low)), "side": -1.0} for x in share]
        return [*upper, *lower]


class Ripple(Effect):
    """A torque that repeats with position: cogging, gear teeth, an eccentric gear."""

    kind = "ripple"
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


WORDS = ("m", "mx", "my", "mz", "Lxx", "Lxy", "Lyy", "Lxz", "Lyz", "Lzz")


class Payload(Effect):
    """A body on a link, with ten parameters about the frame of the link's joint."""

    kind = "payload"
    sits = "link"
    watched = "always"
    unknowns = tuple(
        Unknown(word, (unit, unit), meaning, acts="body")  # a load put down has a negative mass
        for word, unit, meaning in zip(
            WORDS,
            ("kg", *["kg m"] * 3, *["kg m²"] * 6),
            ("mass", *["first moment"] * 3, *["moment about the joint frame's origin"] * 6),
            strict=True,
        )
    )
    equation = "Γ_link p, the link's own columns once more"
    signature = "all joints below the link show one more load, in proportion to it"
    confused_with = ("the link's own parameters, as long as these are unknown",)
    remedy = "log the same motion with the load and without it"
    source = "Khalil, Gautier, Lemoine, IEEE ICRA 2007"

    def columns(self, s: Signals) -> np.ndarray:
        return np.zeros((*s.q.shape, len(self.unknowns)))
