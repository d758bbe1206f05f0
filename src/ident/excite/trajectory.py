"""Periodic motions of the drives within limits: Fourier series, followed through the closures.

Limits, the URDF's or others in their place, are one box:

    low < z(t) < high,    z = (y, ẏ, ÿ of all joints, τ of the drives, ‖K⁺‖)

Motions and their rows:

    y(t) = c + Σ_k a_k sin(kωt) + b_k cos(kωt)          ω = 2π/T, k = 1 … H
    ẏ(0) = 0:  Σ k a_k = 0            ÿ(0) = 0:  Σ k² b_k = 0
    τ̂ = A x₀ − b         rows of the motion, x₀ the prior, b of a motion without torques

Source: Swevers, Ganseman, Tükel, De Schutter, Van Brussel, IEEE Trans. Robot. Autom. 13(5), 1997,
eq. 12. Both conditions are linear, so that the series which satisfy them are a linear space too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import null_space

from ident.equations.rows import Scene, informing, largest_transmission
from ident.equations.unknowns import Columns, Point
from ident.errors import MechanismError, MotionError, one_of
from ident.mechanism.mechanism import Mechanism
from ident.motion import State
from ident.motion.closures import best_conditioned
from ident.motion.motion import prescribed

CROSSING = 1.0  # [s] in which a joint without a limit of speed may cross its range; a convention
ROUNDING = 1e-9  # of the box's width: a joint may stand at its limit
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
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
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
                    raise MechanismError(
                        f"{mechanism.name}: limit of torque: '{name}' is passive; "
                        f"{one_of(name, mechanism.driven)}"
                    )
        rows: dict[Quantity, tuple[float, float]] = {}
        notes = []
        for j in mechanism.joints:
            driven = j.name in mechanism.driven
            low, high = limits.range.get(j.name, (j.lower, j.upper))
            speed = _limit(limits.speed, j.name, driven, j.velocity or np.inf)
            acceleration = _limit(limits.acceleration, j.name, driven, np.inf)
            torque = (1 - limits.reserve) * _limit(
                limits.torque, j.name, driven, j.effort or np.inf
            )
            if j.name in start and j.rotational and high - low > 2 * np.pi:
                low, high = start[j.name] - np.pi, start[j.name] + np.pi
                notes.append(f"{j.name} may turn on and on: moved by up to half a turn either way")
            if j.name in start and not np.isfinite(high - low):
                raise MechanismError(
                    f"joint '{j.name}' slides without limits; say how far: "
                    f"--range {j.name}=LOWER:UPPER"
                )
            if j.name in start and not np.isfinite(speed):
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
        low_, high_ = np.array([rows[each] for each in quantities]).T
        return cls(tuple(quantities), low_, high_), notes

    def of_joints(self, kind: str, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Return both limits (d,) of one kind of some joints."""
        known = [each[:2] for each in self.quantities]
        at = [known.index((name, kind)) for name in names]
        return self.low[at], self.high[at]

    def z(self, e: State) -> np.ndarray:
        """Return z (n, Z) of an experiment that has its predicted torques."""
        parts = [e.y, e.yd, e.ydd, e.tau]
        if e.loop is not None:
            parts.append(np.linalg.norm(e.pinv, axis=(1, 2))[:, None])
        return np.hstack(parts)

    @property
    def middle(self) -> np.ndarray:
        """(Z,) centre of both limits; 0 where there are not both."""
        closed = np.isfinite(self.low) & np.isfinite(self.high)
        return 0.5 * (np.where(closed, self.low, 0.0) + np.where(closed, self.high, 0.0))

    @property
    def half(self) -> np.ndarray:
        """(Z,) half of the width; the upper limit where there is no lower one, else 1."""
        width = np.where(np.isfinite(self.low), 0.5 * (self.high - self.low), self.high)
        return np.where(np.isfinite(width), np.maximum(np.abs(width), 1e-300), 1.0)

    def tightened(self, moved: tuple[str, ...], between: float, margin: float) -> LimitBox:
        """Return a smaller box for samples.

        The share `between` applies to the positions and rates of the joints that are moved, whose
        series is bounded between samples too, `margin` to everything that follows from them.
        """
        kinds = ("position", "speed", "acceleration")
        own = [joint in moved and kind in kinds for joint, kind, _ in self.quantities]
        share = np.where(own, between, margin)
        low, high = (self.middle + share * (x - self.middle) for x in (self.low, self.high))
        return replace(self, low=low, high=high)

    def excess(self, z: np.ndarray) -> np.ndarray:
        """Return (Z,) by how much z (n, Z) exceeds each limit, in half widths; below 0 inside."""
        return np.maximum(self.low - z, z - self.high).max(axis=0) / self.half

    def broken(self, z: np.ndarray) -> int | None:
        """Return the index of the quantity that is farthest outside; None if none is."""
        over = self.excess(z)
        return int(over.argmax()) if over.max() > ROUNDING else None

    def uses(self, z: np.ndarray) -> tuple[LimitUse, ...]:
        """Return how z (n, Z) uses each limit."""
        closed = np.isfinite(self.low) & np.isfinite(self.high)
        low, high = z.min(axis=0), z.max(axis=0)
        covered = np.where(closed, (high - low) / (2 * self.half), 0.0)
        ranges = [kind == "position" for _, kind, _ in self.quantities]
        share = np.where(ranges, covered, np.maximum(-low, high) / self.high)
        numbers = np.stack([low, high, self.low, self.high, share], axis=1).tolist()
        return tuple(
            LimitUse(joint, kind, a, b, lower, upper, unit, used)
            for (joint, kind, unit), (a, b, lower, upper, used) in zip(
                self.quantities, numbers, strict=True
            )
        )


LEAP = 0.4  # [rad | m] by which a drive may move in one step along the branch
SLIP, GAIN = 0.05, 2.0  # [rad | m] and times ‖K⁺‖ of that step, by which the others may
HALVINGS = 4  # of the last step along a line
INSIDE = 0.97  # of the drives' limits that a random motion reaches
EVERY = slice(None)


@dataclass(frozen=True, eq=False)
class Fourier:
    """Series of d joints about their home positions: y = home + basis(t) x."""

    period: float  # T [s]
    harmonics: int  # H, 2 or more
    home: np.ndarray  # (d,) [rad | m], the positions at x = 0
    half: np.ndarray  # (d,) half of the joints' ranges
    # speed, acceleration: (d,) the largest allowed
    speed: np.ndarray
    acceleration: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of x: d joints, 2 H − 1 numbers each, of which the first moves the centre c."""
        return len(self.home), 2 * self.harmonics - 1

    @cached_property
    def _frequencies(self) -> np.ndarray:
        """k ω (H,) [rad/s]."""
        return 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)

    @cached_property
    def _free(self) -> np.ndarray:
        """(d, 2 H + 1, 2 H − 1): c, a, b of every joint from its x.

        The unit of an amplitude is the largest that the limits allow its harmonic alone, so that
        all x have the same scale.
        """
        H, w = self.harmonics, self._frequencies
        free = np.zeros((len(self.home), 2 * H + 1, 2 * H - 1))
        for u, out in enumerate(free):
            largest = np.minimum(self.half[u], self.speed[u] / w)
            largest = np.minimum(largest, self.acceleration[u] / w**2)
            out[0, 0] = self.half[u]
            for rows, power, at in ((slice(1, H + 1), 1, 1), (slice(H + 1, None), 2, H)):
                condition = (w**power * largest)[None]
                out[rows, at : at + H - 1] = largest[:, None] * null_space(condition)
        return free

    def coefficients(self, x: np.ndarray) -> np.ndarray:
        """Return c, a_1 … a_H, b_1 … b_H (d, 2 H + 1) of the series x (d, 2 H − 1) [rad | m]."""
        series = np.einsum("dkp,dp->dk", self._free, x)
        series[:, 0] += self.home
        return series

    def basis(self, t: np.ndarray) -> np.ndarray:
        """Return (3, n, d, 2 H − 1): ∂(y, ẏ, ÿ)/∂x at the times t (n,) [s]."""
        w = self._frequencies
        sin, cos = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
        one, none = np.ones((len(t), 1)), np.zeros((len(t), 1))
        waves = np.stack(
            [
                np.hstack([one, sin, cos]),
                np.hstack([none, w * cos, -w * sin]),
                np.hstack([none, -(w**2) * sin, -(w**2) * cos]),
            ]
        )
        return np.einsum("cnk,dkp->cndp", waves, self._free)

    def states(self, x: np.ndarray, basis: np.ndarray) -> np.ndarray:
        """Return y, ẏ, ÿ (3, n, d) of the series x (d, 2 H − 1) on a basis (3, n, d, 2 H − 1)."""
        states = np.einsum("cndp,dp->cnd", basis, x)
        states[0] += self.home
        return states

    def between(self, n: int) -> float:
        """Share of a bound that n even samples a period may reach, so that nothing between them
        exceeds it: cos(π H / n) (Ehlich, Zeller, Math. Z. 86, 1964).
        """
        return float(np.cos(np.pi * self.harmonics / n))


@dataclass(frozen=True, eq=False)
class MotionRows:
    """Rows of the equations at n samples of a motion."""

    e: State  # with the torques that the model predicts
    A: np.ndarray  # (n, d, k) rows
    informed: np.ndarray  # (n, d), false where dry friction leaves the torque open


def motion_rows(mechanism: Mechanism, columns: Columns, point: Point, e: State) -> MotionRows:
    """Return the rows of a state, with the torques that the model predicts at a point."""
    e = replace(e, tau=np.zeros((len(e), len(mechanism.driven))))
    scene = Scene.of(mechanism, columns, e, point)
    found = scene.terms(EVERY)
    torque = found.A @ columns.prior_at(point.values) - found.b
    drives = [mechanism.joint_index[name] for name in mechanism.driven]
    if mechanism.driven != e.independent:  # surplus drives share the torque
        torque = e.drive_torques(torque, drives)
    e = replace(e, tau=torque)
    if any(effect.corrects for effect in mechanism.effects):  # these depend on torques
        scene = Scene.of(mechanism, columns, e, point)
        found = scene.terms(EVERY)
    informed = informing(scene.samples(EVERY), found.informative, largest_transmission(scene.e))
    return MotionRows(e, found.A, informed)


@dataclass(frozen=True, eq=False)
class Family:
    """All series of one mechanism at the n samples of a period, with their equations."""

    mechanism: Mechanism
    columns: Columns
    point: Point
    series: Fourier
    rest: State  # the mechanism at home, at the samples
    basis: np.ndarray  # (3, n, d, P) of the series there

    def at(self, t: np.ndarray) -> Family:
        """Return the same family at other times t (n,) [s]."""
        rest = at_rest(self.mechanism, self.rest.independent, self.series.home, t)
        return replace(self, rest=rest, basis=self.series.basis(t))

    def rows(self, e: State) -> MotionRows:
        """Return the rows and predicted torques of a state."""
        return motion_rows(self.mechanism, self.columns, self.point, e)

    def states(self, e: State) -> np.ndarray:
        """Return y, ẏ, ÿ (3, n, d) of the drives that are moved."""
        at = [self.mechanism.joint_index[name] for name in e.independent]
        return np.stack([x[:, at] for x in (e.y, e.yd, e.ydd)])

    def follow(self, near: State, states: np.ndarray) -> State | None:
        """Return the state at y, ẏ, ÿ (3, n, d) of its drives, on the branch of a near one.

        None where the closures cannot be satisfied, or another branch was reached: the joints
        moved by more than K⁺ predicts. Speeds of standstill do not change.
        """
        step = states - self.states(near)
        if self.mechanism.closures and np.abs(step[0]).max() > LEAP:
            return None
        known = near.known(self.mechanism)
        known[:, :, [near.logged.index(name) for name in near.independent]] += step
        try:
            with np.errstate(all="ignore"):
                e = near.at(self.mechanism, known)
        except (MotionError, np.linalg.LinAlgError):
            return None
        if not e.usable.all():
            return None
        if near.loop is not None:
            size = np.linalg.norm(near.pinv, axis=(1, 2)) * np.linalg.norm(step[0], axis=1)
            if (np.abs(e.q - near.q).max(axis=1) > SLIP + GAIN * size).any():
                return None
        return e

    def steps(self, way: float) -> int:
        """Return in how many steps a way [rad | m] can be followed along the branch."""
        return max(int(np.ceil(way / (0.9 * LEAP))), 1) if self.mechanism.closures else 1

    def motion(self, x: np.ndarray, near: State) -> MotionRows | None:
        """Return the rows of the motion x (d, P), along the straight line from a motion near it.

        None where the closures cannot be followed.
        """
        goal, start = self.series.states(x, self.basis), self.states(near)
        count = self.steps(np.abs(goal[0] - start[0]).max())
        e: State | None = near
        for share in np.arange(1, count + 1) / count:
            e = e and self.follow(e, start + share * (goal - start))
        return None if e is None else self.rows(e)

    def draw(
        self, box: LimitBox, random: np.random.Generator
    ) -> tuple[np.ndarray, MotionRows] | None:
        """Return a random motion x (d, P) inside a box, with its rows.

        Each drive's series is as large as its own limits allow and lies anywhere in its range;
        then the motion is grown from home.
        """
        series = self.series
        x = random.standard_normal(series.shape)
        shift = random.uniform(-1.0, 1.0, len(x))
        x[:, 0] = 0.0
        y, v, a = series.states(x, self.basis)
        y = y - series.home
        joints = self.mechanism.joint_index
        middle = box.middle[[joints[name] for name in self.rest.independent]]
        low, high = y.min(axis=0), y.max(axis=0)
        rates = np.minimum(
            series.speed / np.abs(v).max(axis=0), series.acceleration / np.abs(a).max(axis=0)
        )
        size = INSIDE * np.minimum(2 * series.half / (high - low), rates)
        x *= size[:, None]
        free = INSIDE * series.half - 0.5 * size * (high - low)
        x[:, 0] = (middle - series.home - 0.5 * size * (high + low) + shift * free) / series.half
        return self.grow(x, lambda rows: box.excess(box.z(rows.e)).max() < 0)

    def grow(
        self, x: np.ndarray, allowed: Callable[[MotionRows], bool]
    ) -> tuple[np.ndarray, MotionRows] | None:
        """Return the largest share of x (d, P), from home outward, whose motions are all allowed.

        So every sample is on the branch of home, and no loop passes a singular position on its way.
        """
        far = np.abs(self.series.states(x, self.basis)[0] - self.series.home).max()
        near, best, share, step, halved = self.rest, None, 0.0, 1.0 / self.steps(far), 0
        while share < 1.0 - 1e-12 and halved <= HALVINGS:
            rows = self.motion((share + step) * x, near)
            if rows is not None and allowed(rows):
                share, near = share + step, rows.e
                best = share * x, rows
                if not halved:
                    continue
            step, halved = 0.5 * step, halved + 1
        return best


def at_rest(mechanism: Mechanism, names: tuple[str, ...], home: np.ndarray, t: np.ndarray) -> State:
    """Return a state in which the drives `names` stay at home (d,), at the times t (n,) [s]."""
    known = np.zeros((3, len(t), len(home)))
    known[0] = home
    (e,) = prescribed(mechanism, f"a motion of {mechanism.name}", t, names, known).experiments
    return e if e.independent == names else e.transmitted(mechanism, names)


def moved_joints(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the drives whose positions determine the motion; refuse fewer than freedoms."""
    if mechanism.closures:
        names = best_conditioned(mechanism, mechanism.assembled[None])
    else:
        names = tuple(joint.name for joint in mechanism.joints)
    free = [name for name in names if name not in mechanism.driven]
    if free:
        raise MotionError(
            f"{mechanism.name}: {', '.join(free)} moves freely, without a drive, so no motion can "
            "be asked of it; `excite` needs as many drives as degrees of freedom"
        )
    return names
