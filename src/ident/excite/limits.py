"""Limits of a planned motion, the URDF's or others in their place: one box.

low < z(t) < high,    z = (y, ẏ, ÿ of all joints, τ of the drives, ‖K⁺‖)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.errors import MechanismError, one_of
from ident.excite.commands import torque_limit
from ident.mechanism.mechanism import Mechanism
from ident.motion import State

CROSSING = 1.0  # range: [s] in which a joint without a limit of speed may cross its range
TURN = 6.29  # range: [rad] a larger range is more than one turn, however 2 π is rounded in a URDF
EDGE_ROUNDING = 1e-9  # numerics: of the box's width: a joint may stand at its limit
Given = float | Mapping[str, float] | None


@dataclass(frozen=True)
class Limits:
    """Limits in place of the URDF's. A number holds for all driven joints, where the URDF's is not
    lower; a mapping by joint replaces the URDF's.

    Attributes:
        range: by joint, (lower, upper) [rad | m].
        speed: [rad/s | m/s]; acceleration: [rad/s² | m/s²], of which a URDF has none.
        torque: [N m | N].
        reserve: share of the torque that is reserved for unmodelled effects, friction first.
        singular: multiple of its value at home that ‖K⁺‖ may reach: the distance to singularities.

    Raises:
        MechanismError: for a number that is no limit.
    """

    range: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    speed: Given = None
    acceleration: Given = None
    torque: Given = None
    reserve: float = 0.2
    singular: float = 3.0

    def __post_init__(self) -> None:
        for what in ("speed", "acceleration", "torque"):
            given = getattr(self, what)
            for x in given.values() if isinstance(given, Mapping) else [given]:
                if x is not None and not 0 < x < np.inf:
                    raise MechanismError(f"limit of {what}: {x:g}; a number above 0 is expected")
        for name, (low, high) in self.range.items():
            if not -np.inf < low < high < np.inf:
                raise MechanismError(
                    f"limit of range: {name} = {low:g} to {high:g}; two numbers, the lower first"
                )
        if not 0 <= self.reserve < 1:
            raise MechanismError(
                f"reserve of torque: {self.reserve:g}; a share from 0 to below 1 is expected"
            )
        if not self.singular > 1:
            raise MechanismError(
                f"distance to singularities: {self.singular:g} times ‖K⁺‖ at home; a number above "
                "1 is expected"
            )


def _limit(given: Given, name: str, driven: bool, urdf: float) -> float:
    if isinstance(given, Mapping):
        return float(given.get(name, urdf))
    return min(float(given), urdf) if given is not None and driven else urdf


@dataclass(frozen=True)
class LimitUse:
    """The share of one limit that a motion uses."""

    joint: str  # empty for `singularity`
    kind: str  # position, speed, acceleration, torque or singularity
    low: float  # low, high: the extremes reached
    high: float
    lower: float  # lower, upper: the limits, of torque less the reserve
    upper: float
    unit: str  # of these four; of a singularity ‖K⁺‖
    share: float  # of the range that is covered, or of the limit that is reached; 0 without one


Quantity = tuple[str, str, str]
"""Joint, kind (position, speed, …) and unit of one limited quantity."""


@dataclass(frozen=True, eq=False)
class LimitBox:
    """Limits of all quantities z."""

    quantities: tuple[Quantity, ...]  # (Z,)
    # low, high: (Z,) their limits, infinite where there are none
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(
        cls, mechanism: Mechanism, limits: Limits, start: Mapping[str, float], size: float
    ) -> tuple[LimitBox, list[str]]:
        """Return the limits in force, and assumptions.

        The joints in `start` [rad | m] are moved from there; they need a range and a speed. `size`
        is ‖K⁺‖ there. Refuses an unknown joint, or a sliding drive without a range.
        """
        for given in (limits.range, limits.speed, limits.acceleration, limits.torque):
            for name in given if isinstance(given, Mapping) else ():
                mechanism.joint(name)
                if given is limits.torque and name not in mechanism.driven:
                    why = f"'{name}' is passive; {one_of(name, mechanism.driven)}"
                    raise MechanismError(f"{mechanism.name}: limit of torque: {why}")
        rows: dict[Quantity, tuple[float, float]] = {}
        notes = []
        for j in mechanism.joints:
            driven = j.name in mechanism.driven
            low, high = limits.range.get(j.name, (j.lower, j.upper))
            speed = _limit(limits.speed, j.name, driven, j.velocity or np.inf)
            acceleration = _limit(limits.acceleration, j.name, driven, np.inf)
            torque = _limit(limits.torque, j.name, driven, j.effort or np.inf)
            torque = min(torque, torque_limit(mechanism, j.name)) * (1 - limits.reserve)
            in_motion = j.name in start
            if in_motion and j.rotational and high - low > TURN:
                low, high = start[j.name] - np.pi, start[j.name] + np.pi
                notes.append(f"{j.name} may turn on and on: moved by up to half a turn either way")
            if in_motion and not 0 < high - low < np.inf:
                what = "slides without limits"
                if not high > low:
                    what = f"has both limits at {low:g} {j.unit} in its <limit>"
                how = f"--range {j.name}=LOWER:UPPER"
                raise MechanismError(f"joint '{j.name}' {what}; say how far it may move: {how}")
            if in_motion and not np.isfinite(speed):
                speed = (high - low) / CROSSING
                notes.append(f"{j.name} has no limit of speed: {speed:.3g} {j.unit}/s is taken")
            rows[j.name, "position", j.unit] = low, high
            rows[j.name, "speed", f"{j.unit}/s"] = -speed, speed
            rows[j.name, "acceleration", f"{j.unit}/s²"] = -acceleration, acceleration
            if driven:
                rows[j.name, "torque", j.force_unit] = -torque, torque
        if mechanism.closures:
            rows["", "singularity", "1"] = -np.inf, limits.singular * size
        order = [*dict.fromkeys(kind for _, kind, _ in rows)]
        quantities = sorted(rows, key=lambda q: order.index(q[1]))
        return cls(
            tuple(quantities), *np.array([rows[quantity] for quantity in quantities]).T
        ), notes

    def of_joints(self, kind: str, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Return both limits (d,) of one kind of some joints."""
        known = [quantity[:2] for quantity in self.quantities]
        at = [known.index((name, kind)) for name in names]
        return self.low[at], self.high[at]

    def z(self, e: State) -> np.ndarray:
        """Return z (n, Z) of an experiment that has its predicted torques."""
        size = [] if e.loop is None else [np.linalg.norm(e.pinv, axis=(1, 2))[:, None]]
        return np.hstack([e.y, e.yd, e.ydd, e.tau, *size])

    @property
    def closed(self) -> np.ndarray:
        """(Z,) quantities that have both limits."""
        return np.isfinite(self.low) & np.isfinite(self.high)

    @property
    def middle(self) -> np.ndarray:
        """(Z,) centre of both limits; 0 where there are not both."""
        return 0.5 * np.where(self.closed, [self.low, self.high], 0.0).sum(axis=0)

    @property
    def half(self) -> np.ndarray:
        """(Z,) half of the width; the upper limit where there is no lower one, else 1."""
        width = np.where(np.isfinite(self.low), 0.5 * (self.high - self.low), self.high)
        return np.where(np.isfinite(width), np.maximum(np.abs(width), 1e-300), 1.0)

    def tightened(self, moving_joints: tuple[str, ...], between: float, margin: float) -> LimitBox:
        """Return a smaller box for samples.

        The share `between` applies to the positions and rates of the joints that are moved, whose
        series is bounded between samples too, `margin` to everything that follows from them.
        """
        kinds = ("position", "speed", "acceleration")
        applies = [joint in moving_joints and kind in kinds for joint, kind, _ in self.quantities]
        share = np.where(applies, between, margin)
        low, high = (self.middle + share * (x - self.middle) for x in (self.low, self.high))
        return replace(self, low=low, high=high)

    def excess(self, z: np.ndarray) -> np.ndarray:
        """Return (Z,) by how much z (n, Z) exceeds each limit, in half widths; below 0 inside."""
        return np.maximum(self.low - z, z - self.high).max(axis=0) / self.half

    def broken(self, z: np.ndarray) -> int | None:
        """Return the index of the quantity that is farthest outside; None if none is."""
        excess = self.excess(z)
        return int(excess.argmax()) if excess.max() > EDGE_ROUNDING else None

    def uses(self, z: np.ndarray) -> tuple[LimitUse, ...]:
        """Return how z (n, Z) uses each limit."""
        low, high = z.min(axis=0), z.max(axis=0)
        covered = np.where(self.closed, (high - low) / (2 * self.half), 0.0)
        most = np.where(self.high > 0, self.high, np.inf)  # a joint without a drive has no torque
        ranges = [kind == "position" for _, kind, _ in self.quantities]
        share = np.where(ranges, covered, np.maximum(-low, high) / most)
        sizes = np.stack([low, high, self.low, self.high], axis=1).tolist()
        series = zip(self.quantities, sizes, share.tolist(), strict=True)
        return tuple(
            LimitUse(joint, kind, a, b, lower, upper, unit, used)
            for (joint, kind, unit), (a, b, lower, upper), used in series
        )
