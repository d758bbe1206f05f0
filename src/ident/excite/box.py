"""All limits as one box: low < z(t) < high, z = (y, ẏ, ÿ of all joints, τ of the drives, ‖K⁺‖).

barrier  B = −1/n Σ log((z − low)/w) + log((high − z)/w)         w: half of the box's width
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ident.excite.limits import Kept
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment

ROUNDING = 1e-9  # of the box's width: a joint may stand at its limit


@dataclass(frozen=True)
class Side:
    """One quantity that is limited: of which joint, which kind, its unit."""

    joint: str
    kind: str  # position | speed | acceleration | torque | singularity
    unit: str


@dataclass(frozen=True, eq=False)
class Box:
    """Limits of every quantity z.

    Attributes:
        sides: (Z,) what z are; low, high: (Z,) their limits, infinite where there are none.
    """

    sides: tuple[Side, ...]
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, mechanism: Mechanism, kept: Kept, size: float) -> Box:
        """From the limits in force and ‖K⁺‖ at home (unused in a tree)."""
        sides, low, high = [], [], []

        def side(joint: str, kind: str, unit: str, at: tuple[float, float]) -> None:
            sides.append(Side(joint, kind, unit))
            low.append(at[0])
            high.append(at[1])

        for j in kept.joints:
            side(j.name, "position", j.unit, (j.lower, j.upper))
        for j in kept.joints:
            side(j.name, "speed", f"{j.unit}/s", (-j.velocity, j.velocity))
        for j, most in zip(kept.joints, kept.acceleration, strict=True):
            side(j.name, "acceleration", f"{j.unit}/s²", (-most, most))
        known = {j.name: j for j in kept.joints}
        for j in (known[name] for name in mechanism.driven):
            most = (1 - kept.reserve) * j.effort
            side(j.name, "torque", j.force_unit, (-most, most))
        if mechanism.closures:
            side("", "singularity", "1", (-np.inf, kept.singular * size))
        return cls(tuple(sides), np.array(low), np.array(high))

    def quantities(self, e: Experiment) -> np.ndarray:
        """z (n, Z) of an experiment that has its predicted torques."""
        parts = [e.y, e.yd, e.ydd, e.tau]
        if e.pinv is not None:
            parts.append(np.linalg.norm(e.pinv, axis=(1, 2))[:, None])
        return np.hstack(parts)

    @cached_property
    def closed(self) -> np.ndarray:
        """(Z,) whether there are both limits."""
        return np.isfinite(self.low) & np.isfinite(self.high)

    @cached_property
    def middle(self) -> np.ndarray:
        """(Z,) of both limits; 0 where there are not both."""
        low, high = (np.where(self.closed, x, 0.0) for x in (self.low, self.high))
        return 0.5 * (low + high)

    @cached_property
    def half(self) -> np.ndarray:
        """(Z,) half of the width; the size of the upper limit where there is no lower, or 1."""
        upper = np.where(np.isfinite(self.high), self.high, 1.0)
        width = upper - np.where(self.closed, self.low, 0.0)
        return np.where(self.closed, 0.5 * width, np.maximum(np.abs(upper), 1e-300))

    def tightened(self, moved: tuple[str, ...], between: float, margin: float) -> Box:
        """A smaller box for samples: by `between` for the rates of the joints that are moved, whose
        series is bounded between samples too, by `margin` for all that follows from them.
        """
        share = np.array([
            between if s.joint in moved and s.kind in ("position", "speed", "acceleration")
            else margin for s in self.sides
        ])  # fmt: skip
        low, high = (self.middle + share * (x - self.middle) for x in (self.low, self.high))
        return Box(self.sides, low, high)

    @property
    def open(self) -> Box:
        """The same quantities without limits."""
        none = np.full(len(self.sides), np.inf)
        return Box(self.sides, -none, none)

    def holds(self, z: np.ndarray) -> bool:
        """Whether all samples are inside."""
        return bool((z > self.low).all() and (z < self.high).all())

    def broken(self, z: np.ndarray) -> Side | None:
        """The quantity that is farthest outside, measured by the box's width; None if none is."""
        over = np.maximum(self.low - z, z - self.high).max(axis=0) / self.half
        worst = int(over.argmax())
        return self.sides[worst] if over[worst] > ROUNDING else None

    def barrier(self, z: np.ndarray) -> tuple[float, np.ndarray]:
        """B and ∂B/∂z (n, Z) of samples inside the box."""
        n, value, slope = len(z), 0.0, np.zeros_like(z)
        for at, sign, wall in (
            (np.isfinite(self.low), 1.0, self.low),
            (np.isfinite(self.high), -1.0, self.high),
        ):
            room = sign * (z[:, at] - wall[at])
            value -= float(np.log(room / self.half[at]).sum()) / n
            slope[:, at] -= sign / room / n
        return value, slope

    def used(self, z: np.ndarray) -> np.ndarray:
        """(Z,) the largest share of each limit, 0 where there is none; of ranges their extent."""
        share = np.abs(z).max(axis=0) / self.high  # of no limit it is 0
        position = np.array([s.kind == "position" for s in self.sides])
        extent = (z.max(axis=0) - z.min(axis=0)) / (2 * self.half)
        return np.where(position, np.where(self.closed, extent, 0.0), share)
