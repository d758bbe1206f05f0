"""Periodic motions of the drives: Fourier series, followed through the closures, and their rows.

    y(t) = c + Σ_k a_k sin(kωt) + b_k cos(kωt)          ω = 2π/T, k = 1 … H
    ẏ(0) = 0:  Σ k a_k = 0            ÿ(0) = 0:  Σ k² b_k = 0
    τ̂ = A x₀ − b         rows of the motion, x₀ the prior, b of a motion without torques

Source: Swevers, Ganseman, Tükel, De Schutter, Van Brussel, IEEE Trans. Robot. Autom. 13(5), 1997,
eq. 12. Both conditions are linear, so that the series which satisfy them are a linear space too.

The rows of a sample depend on its own y, ẏ, ÿ alone, unless an effect has a memory. So their slopes
by the d (2 H − 1) numbers x of a motion follow from 3 d differences, all samples at once:

    ∂A_i/∂x = Σ ∂A_i/∂(y, ẏ, ÿ)_i ∂(y, ẏ, ÿ)_i/∂x
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import null_space

from ident.equations.rows import Scene, informing, largest_transmission
from ident.equations.unknowns import Columns, Point
from ident.errors import MotionError
from ident.excite.limits import LimitBox
from ident.mechanism.mechanism import Mechanism
from ident.motion import State
from ident.motion.closures import best_conditioned
from ident.motion.motion import prescribed

STEP = 1e-5  # numerics: of a number of x, a usual position or rate, for differences
TOGETHER = 1024  # work: samples of neighbours of a motion that are worked at once
LEAP = 0.4  # numerics: [rad | m] by which a drive may move in one step along the branch
SLIP, GAIN = 0.05, 2.0  # numerics: [rad | m] and times ‖K⁺‖ of that step, by which the others may
HALVINGS = 4  # work: of the last step along a line
INSIDE = 0.97  # range: of the drives' limits that a random motion reaches
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

    @property
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
        waves = np.zeros((3, len(t), 2 * self.harmonics + 1))
        waves[0, :, 0] = 1.0
        a, b = [sin, w * cos, -(w**2) * sin], [cos, -w * sin, -(w**2) * cos]
        waves[:, :, 1:] = np.concatenate([a, b], axis=2)
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
    terms = scene.terms(EVERY)
    torque = terms.A @ point.unknowns(columns) - terms.b
    drives = [mechanism.joint_index[name] for name in mechanism.driven]
    if mechanism.driven != e.independent:  # surplus drives share the torque
        torque = e.drive_torques(torque, drives)
    e = replace(e, tau=torque)
    if any(effect.corrects for effect in mechanism.effects):  # these depend on torques
        scene = Scene.of(mechanism, columns, e, point)
        terms = scene.terms(EVERY)
    informed = informing(scene.samples.reduced(EVERY), largest_transmission(scene.e))
    return MotionRows(e, terms.A, informed)


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

    @cached_property
    def _local(self) -> bool:
        """Whether the rows of a sample depend on its own y, ẏ, ÿ alone."""
        return not any(effect.memory or effect.corrects for effect in self.mechanism.effects)

    @cached_property
    def _nudges(self) -> np.ndarray:
        """(3, d) steps of y, ẏ, ÿ for differences [rad | m, …]."""
        w = 2 * np.pi * self.series.harmonics / self.series.period
        rate = np.minimum(self.series.speed, self.series.half * w)
        return STEP * np.stack([rate / w, rate, rate * w])

    def perturbed(self, e: State) -> Iterator[tuple[int, MotionRows | None]]:
        """Yield neighbours of a motion, m at a time, as m and their rows at m n samples.

        They differ from it in one of y, ẏ, ÿ of one drive, at all samples; where rows depend on the
        past, in one number of x. None where a closure cannot be followed.
        """
        n, states = len(e), self.states(e)
        d = states.shape[2]
        if self._local:
            moves = np.einsum("cu,ck,uj->cukj", self._nudges, np.eye(3), np.eye(d))
            moves, most = moves.reshape(-1, 3, 1, d), max(TOGETHER // n, 1)
        else:
            moves = STEP * np.einsum("cnup,uj->upcnj", self.basis, np.eye(d))
            moves, most = moves.reshape(-1, 3, n, d), 1
        for first in range(0, len(moves), most):
            goal = states + moves[first : first + most]
            m = len(goal)
            near = e.at_samples(np.tile(np.arange(n), m))
            near_states = self.follow(near, goal.transpose(1, 0, 2, 3).reshape(3, -1, d))
            yield m, None if near_states is None else self.rows(near_states)

    def by_x(self, changes: np.ndarray) -> np.ndarray:
        """Return slopes (n, c, d P) by x from the changes (m, n, c) of all neighbours."""
        if not self._local:
            return changes.transpose(1, 2, 0) / STEP
        _, n, d, P = self.basis.shape
        slopes = changes.reshape(3, d, n, -1) / self._nudges[:, :, None, None]
        by_coordinate = [
            np.einsum("cnz,cnp->nzp", slopes[:, u], self.basis[:, :, u]) for u in range(d)
        ]
        return np.stack(by_coordinate, axis=2).reshape(n, -1, d * P)

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
        joints = self.mechanism.joint_index
        middle = box.middle[[joints[name] for name in self.rest.independent]]
        low, high = (y - series.home).min(axis=0), (y - series.home).max(axis=0)
        of_rates = np.minimum(series.speed / abs(v).max(0), series.acceleration / abs(a).max(0))
        size = INSIDE * np.minimum(2 * series.half / (high - low), of_rates)
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
    names = best_conditioned(mechanism, mechanism.assembled[None])
    if free := [name for name in names if name not in mechanism.driven]:
        raise MotionError(
            f"{mechanism.name}: {', '.join(free)} moves freely, without a drive, so no motion can "
            "be asked of it; `excite` needs as many drives as degrees of freedom"
        )
    return names
