"""What drives a mechanism in an integration: measured torques, or a controller.

    PD                τ = Kp (q_ref − q) + Kd (q̇_ref − q̇)
    computed torque   τ = inverse dynamics of q̈_ref + Kd (q̇_ref − q̇) + Kp (q_ref − q)

Both act continuously, on the joints' true coordinates. Computed torque knows the bodies and all
effects but dry friction, which is left to the feedback (Spong, Hutchinson, Vidyasagar, Robot
Modeling and Control, ch. 8); in closed loops it works in the directions that the loops leave.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ident.errors import MotionError, one_of
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment
from ident.simulate.instant import Actuator
from ident.simulate.plant import Moment, Plant

BANDWIDTH = 5.0  # [Hz] of a controller whose gains are not given
Gains = tuple[float, float] | Mapping[str, tuple[float, float]]
AnyLog = Log | str | os.PathLike[str]


@dataclass(frozen=True, eq=False)
class Torques:
    """The torques of a log, interpolated by cubic splines.

    Attributes:
        log: with a `tau.` column of every driven joint, or its path.
    """

    log: AnyLog

    def actuator(self, mechanism: Mechanism, plant: Plant, e: Experiment) -> Actuator:
        """Of the completed log.

        Args:
            mechanism: whose drives it acts on.
            plant: its inertias as they are at the start.
            e: the log, completed.
        """
        return Series(CubicSpline(e.t, e.tau))


@dataclass(frozen=True, eq=False)
class PD:
    """A PD controller at every driven joint that follows the positions of a log.

    Attributes:
        reference: a log whose positions are the motion to follow, or its path.
        gains: (Kp, Kd) of all driven joints, or by joint [N m/rad, N m s/rad | N/m, N s/m].
            Default: a bandwidth of 5 Hz, critically damped, for the inertia at the start.
    """

    reference: AnyLog
    gains: Gains | None = None

    def actuator(self, mechanism: Mechanism, plant: Plant, e: Experiment) -> Actuator:
        """Of the completed reference.

        Args:
            mechanism: whose drives it acts on.
            plant: its inertias as they are at the start.
            e: what is followed, completed.
        """
        w = 2 * np.pi * BANDWIDTH
        if self.gains is None:
            inertia = felt_inertia(plant, e)
            Kp, Kd = w**2 * inertia, 2 * w * inertia
        else:
            Kp, Kd = _by_joint(self.gains, mechanism)
        return Follower(_reference(mechanism, e), Kp, Kd, computed=False)


@dataclass(frozen=True, eq=False)
class ComputedTorque:
    """Computed-torque control that follows the positions of a log.

    Attributes:
        reference: a log whose positions are the motion to follow, or its path.
        gains: (Kp, Kd) of all driven joints, or by joint [1/s², 1/s]. Default: a bandwidth of 5 Hz,
            critically damped.
    """

    reference: AnyLog
    gains: Gains | None = None

    def actuator(self, mechanism: Mechanism, plant: Plant, e: Experiment) -> Actuator:
        """Of the completed reference.

        Args:
            mechanism: whose drives it acts on.
            plant: its inertias as they are at the start.
            e: what is followed, completed.
        """
        w = 2 * np.pi * BANDWIDTH
        Kp, Kd = _by_joint((w**2, 2 * w) if self.gains is None else self.gains, mechanism)
        return Follower(_reference(mechanism, e), Kp, Kd, computed=True)


Drive = Torques | PD | ComputedTorque


@dataclass(frozen=True, eq=False)
class Still:
    """No torque."""

    count: int

    def torque(self, m: Moment, plant: Plant, against: np.ndarray) -> np.ndarray:
        """Zeros (driven,)."""
        return np.zeros(self.count)


@dataclass(frozen=True, eq=False)
class Series:
    """Torques as a function of time."""

    spline: CubicSpline

    def torque(self, m: Moment, plant: Plant, against: np.ndarray) -> np.ndarray:
        """τ(t) (driven,)."""
        return np.asarray(self.spline(m.t))


@dataclass(frozen=True, eq=False)
class Follower:
    """A controller of the driven joints.

    Attributes:
        reference: of time, (3 · driven,): q, q̇, q̈.
        Kp, Kd: (driven,).
        computed: whether they are accelerations for the inverse dynamics, or torques.
    """

    reference: CubicSpline
    Kp: np.ndarray
    Kd: np.ndarray
    computed: bool

    def torque(self, m: Moment, plant: Plant, against: np.ndarray) -> np.ndarray:
        """τ (driven,)."""
        q, v, a = np.split(self.reference(m.t), 3)
        at = plant.driven
        back = self.Kp * (q - m.y[at]) + self.Kd * (v - m.yd[at])
        return plant.inverse(m, at, a + back, against) if self.computed else back


def felt_inertia(plant: Plant, e: Experiment) -> np.ndarray:
    """(driven,) inertia [kg m² | kg] that each drive feels at the start, the others held."""
    m = plant.moment(float(e.t[0]), e.q[0], e.v[0], np.zeros(len(plant.laws.presliding)))
    reach = m.W[plant.driven] @ m.Z
    return np.diag(np.linalg.pinv(reach @ np.linalg.solve(m.Z.T @ m.M @ m.Z, reach.T), 1e-9)).copy()


def _by_joint(gains: Gains, mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray]:
    """Kp, Kd (driven,).

    Raises:
        MotionError: for a joint without a drive, one without gains, or a negative gain.
    """
    names = mechanism.driven
    table = gains if isinstance(gains, Mapping) else dict.fromkeys(names, gains)
    for name in table:
        if name not in names:
            raise MotionError(f"gains of '{name}', which has no drive; {one_of(name, names)}")
    for name in names:
        if name not in table:
            raise MotionError(f"gains: none for '{name}'; give every driven joint (Kp, Kd)")
        if not all(np.isfinite(x) and x >= 0 for x in table[name]):
            raise MotionError(f"gains of '{name}': {table[name]}; give Kp, Kd of 0 or more")
    Kp, Kd = np.array([table[name] for name in names], dtype=float).reshape(-1, 2).T
    return Kp, Kd


def _reference(mechanism: Mechanism, e: Experiment) -> CubicSpline:
    at = [mechanism.joint_index[name] for name in mechanism.driven]
    return CubicSpline(e.t, np.hstack([e.y[:, at], e.yd[:, at], e.ydd[:, at]]))
