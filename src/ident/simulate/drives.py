"""Drives of an integrated mechanism: measured torques, or a controller.

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
from ident.information import linear
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import State
from ident.simulate.balance import Actuator
from ident.simulate.plant import InstantTerms, Plant

BANDWIDTH = 2 * np.pi * 5.0  # [rad/s] of a controller whose gains are not given
Gains = tuple[float, float] | Mapping[str, tuple[float, float]]
AnyLog = Log | str | os.PathLike[str]


@dataclass(frozen=True, eq=False)
class Torques:
    """The torques of a log, interpolated by cubic splines.

    Attributes:
        log: with a `tau.` column of every driven joint, or its path.
    """

    log: AnyLog


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


Drive = Torques | PD | ComputedTorque


def actuator_of(drive: Drive | None, plant: Plant, e: State | None) -> Actuator:
    """Return the torques of a drive that plays or follows a completed log; zeros without one."""
    if drive is None or e is None:
        return lambda m, against: np.zeros(len(plant.driven))
    if isinstance(drive, Torques):
        return torque_series(e)
    at, gains = plant.driven, drive.gains
    reference = CubicSpline(e.t, np.hstack([e.y[:, at], e.yd[:, at], e.ydd[:, at]]))
    computed = isinstance(drive, ComputedTorque)
    if gains:
        Kp, Kd = _by_joint(gains, plant.mechanism)
    else:
        inertia = np.ones(len(at)) if computed else _drive_inertia(plant, e)
        Kp, Kd = BANDWIDTH**2 * inertia, 2 * BANDWIDTH * inertia

    def control(m: InstantTerms, against: np.ndarray) -> np.ndarray:
        q, v, a = np.split(reference(m.t), 3)
        feedback = Kp * (q - m.y[at]) + Kd * (v - m.yd[at])
        return inverse_dynamics(m, at, a + feedback, against) if computed else feedback

    return control


def torque_series(e: State) -> Actuator:
    """Return the measured torques of a state as a function of time."""
    spline = CubicSpline(e.t, e.tau)
    return lambda m, against: np.asarray(spline(m.t))


def inverse_dynamics(
    m: InstantTerms, at: list[int], ydd: np.ndarray, against: np.ndarray
) -> np.ndarray:
    """Return torques of the joints `at` for their accelerations, against further forces (nv,).

    Zᵀ Wᵀ τ = Zᵀ (M v̇ + h + against),  W v̇ + drift = ÿ; least squares and the smallest τ where
    there are not as many drives as degrees of freedom.
    """
    back = linear.pinv(m.W[at] @ m.Z, 1e-9)
    a = m.a0 + m.Z @ (back @ (ydd - m.drift[at] - m.W[at] @ m.a0))
    return np.asarray(back.T @ (m.Z.T @ (m.M @ a + m.h + against)))


def _drive_inertia(plant: Plant, e: State) -> np.ndarray:
    """Return (driven,) the inertia [kg m² | kg] at each drive at the start, the others held."""
    m = plant.terms(float(e.t[0]), e.q[0], e.v[0], np.zeros(len(plant.laws.states)))
    lever = m.W[plant.driven] @ m.Z
    return np.diag(linear.pinv(lever @ np.linalg.solve(m.Z.T @ m.M @ m.Z, lever.T), 1e-9)).copy()


def _by_joint(gains: Gains, mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray]:
    """Return Kp, Kd (driven,)."""
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
