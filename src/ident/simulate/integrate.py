"""The verb `integrate`: forward simulation of a mechanism, free, driven by a log, or controlled.

Its drives are measured torques, or a controller:

    PD                τ = Kp (q_ref − q) + Kd (q̇_ref − q̇)
    computed torque   τ = inverse dynamics of q̈_ref + Kd (q̇_ref − q̇) + Kp (q_ref − q)

Both act continuously, on the joints' true coordinates. Computed torque knows the bodies and all
effects but dry friction, which is left to the feedback (Spong, Hutchinson, Vidyasagar, Robot
Modeling and Control, ch. 8); in closed loops it works in the directions that the loops leave.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline, interp1d

from ident.display import Displayed, Progress
from ident.equations.rows import Scene, check_needs
from ident.equations.unknowns import NOTHING, Point
from ident.errors import MotionError, one_of
from ident.information import linear
from ident.information.cubic import late
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import State, complete
from ident.motion.closures import LoopSolver, best_conditioned, independent_joints
from ident.motion.spline import noise_share
from ident.motion.state import joint_coordinates
from ident.simulate.commands import command_laws, commanded, steps_of
from ident.simulate.dynamics import STICK, Actuator, Dynamics
from ident.simulate.events import Integration, Transition
from ident.simulate.inverse import (
    CHANNELS,
    Noise,
    check_channels,
    columns_of,
    one_run,
    point_of,
    with_noise,
)
from ident.simulate.plant import InstantTerms, Plant, constant_correction
from ident.simulate.twisting import twisting

BANDWIDTH = 2 * np.pi * 5.0  # range: [rad/s] of a controller whose gains are not given
Gains = tuple[float, float] | Mapping[str, tuple[float, float]]
AnyLog = Log | str | os.PathLike[str]


@dataclass(frozen=True, eq=False)
class Torques:
    """The torques of a log, interpolated by cubic splines; of drives, its commands.

    Attributes:
        log: with a `tau.` column of every driven joint, or the commands of its drive; or its path.
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


class ComputedTorque(PD):
    """Computed-torque control that follows the positions of a log, the `reference`.

    Its `gains` are (Kp, Kd) in 1/s² and 1/s; without them, those of a bandwidth of 5 Hz.
    """


Drive = Torques | PD


def actuator_of(drive: Drive | None, plant: Plant, point: Point, e: State | None) -> Actuator:
    """Return the torques of a drive that plays or follows a completed log; zeros without one."""
    if drive is None or e is None:
        return lambda m, against: np.zeros(len(plant.driven))
    if isinstance(drive, Torques):
        return commanded(command_laws(plant.mechanism, point, e), torque_series(e))
    at, gains = plant.driven, drive.gains
    reference = cubic_at_instants(e.t, np.hstack([e.y[:, at], e.yd[:, at], e.ydd[:, at]]))
    computed = isinstance(drive, ComputedTorque)
    _, W, _ = plant.joints(e.q[0], e.v[0])
    fixed = None if plant.mechanism.closures else linear.pinv(W[at], 1e-9)
    if gains:
        Kp, Kd = _by_joint(gains, plant.mechanism)
    else:
        inertia = np.ones(len(at))
        if not computed:  # [kg m² | kg] at each drive at the start, the others held
            m = plant.terms(float(e.t[0]), e.q[0], e.v[0], np.zeros(len(plant.laws.states)))
            lever = m.W[at] @ m.Z
            mobility = lever @ np.linalg.solve(m.Z.T @ m.M @ m.Z, lever.T)
            inertia = np.diag(linear.pinv(mobility, 1e-9))
        Kp, Kd = BANDWIDTH**2 * inertia, 2 * BANDWIDTH * inertia

    def control(m: InstantTerms, against: np.ndarray) -> np.ndarray:
        q, v, a = reference(m.t).reshape(3, -1)
        feedback = Kp * (q - m.y[at]) + Kd * (v - m.yd[at])
        if not computed:
            return feedback
        back = linear.pinv(m.W[at] @ m.Z, 1e-9) if fixed is None else fixed
        # Zᵀ Wᵀ τ = Zᵀ (M v̇ + h + against), W v̇ + drift = ÿ, `back` (d, driven) is (W Z)⁺: least
        # squares and the smallest τ where there are not as many drives as degrees of freedom
        further = a + feedback - m.drift[at] - m.W[at] @ m.a0
        vdot = m.a0 + m.Z @ (back @ further)
        return np.asarray(back.T @ (m.Z.T @ (m.M @ vdot + m.h + against)))

    return control


def torque_series(e: State) -> Actuator:
    """Return the measured torques of a state as a function of time."""
    spline = cubic_at_instants(e.t, e.tau)
    return lambda m, against: spline(m.t)


def cubic_at_instants(t: np.ndarray, x: np.ndarray) -> Callable[[float], np.ndarray]:
    """Return the cubic spline through x (n, c) at t (n,) as a function of one instant [s]: a fifth
    of the time that SciPy's takes, which looks at its argument for longer.
    """
    spline, times = CubicSpline(t, x), t.tolist()
    pieces = np.ascontiguousarray(spline.c.swapaxes(0, 1))  # (n - 1, 4, c)

    def at(instant: float) -> np.ndarray:
        i = min(max(bisect_right(times, instant) - 1, 0), len(pieces) - 1)
        a, b, c, d = pieces[i]
        s = instant - times[i]
        return np.asarray(((a * s + b) * s + c) * s + d)

    return at


def _by_joint(gains: Gains, mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray]:
    """Return Kp, Kd (driven,)."""
    names = mechanism.driven
    table = gains if isinstance(gains, Mapping) else dict.fromkeys(names, gains)
    for name in dict.fromkeys((*table, *names)):
        if name not in names:
            raise MotionError(f"gains of '{name}', which has no drive; {one_of(name, names)}")
        if name not in table:
            raise MotionError(f"gains: none for '{name}'; give every driven joint (Kp, Kd)")
        if not all(0 <= x < np.inf for x in table[name]):
            raise MotionError(f"gains of '{name}': {table[name]}; give Kp, Kd of 0 or more")
    Kp, Kd = np.array([table[name] for name in names], dtype=float).reshape(-1, 2).T
    return Kp, Kd


DURATION, RATE = 10.0, 250.0  # range: [s], [Hz] without a log
TOLERANCE = 1e-10  # numerics
ROUGH = 1e-6  # numerics: share of noise above which torques are integrated sample by sample
STEPS = 5  # work: samples of a log that one step of the integration may pass over


@dataclass(frozen=True, eq=False, repr=False)
class Run(Displayed):
    """An integrated motion with n samples. Made by `ident.integrate`.

    Attributes:
        mechanism: that was integrated, as its effects correct it.
        log: as the machine would have written it, with offsets, delays and noise.
        t: (n,) [s]; q, v, a: (n, nq), (n, nv), (n, nv).
        y, yd, ydd: (n, J) of the mechanism's joints.
        tau: (n, driven) torques that acted [N m | N].
        multipliers: (n, m) λ [N | N m], the smallest where closures repeat each other.
        friction: (n,) by joint, torque of dry friction; stuck: (n,) by joint.
        transitions: when joints stopped and broke away.
        closure_error: largest |Φ| [m | rad].
        evaluations: of the right side.
    """

    mechanism: Mechanism
    log: Log
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    y: np.ndarray
    yd: np.ndarray
    ydd: np.ndarray
    tau: np.ndarray
    multipliers: np.ndarray
    friction: Mapping[str, np.ndarray]
    stuck: Mapping[str, np.ndarray]
    transitions: tuple[Transition, ...]
    closure_error: float
    evaluations: int


def integrate(
    mechanism: Mechanism,
    drive: Drive | None = None,
    *,
    duration: float | None = None,
    rate: float | None = None,
    start: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
    pi: np.ndarray | None = None,
    noise: Sequence[Noise] = (),
    seed: int = 0,
    columns: Sequence[str] = CHANNELS,
    joints: Sequence[str] | None = None,
    tolerance: float = TOLERANCE,
    progress: Progress | None = None,
) -> Run:
    """Integrate the equations of motion: the motion of given forces.

    Args:
        mechanism: with effects; an effect's unknowns need values, from `[[effect]]` or `values`.
        drive: `Torques(log)`, `PD(log)` or `ComputedTorque(log)`; None: no torque.
        duration: [s]; default: the log's, else 10 s.
        rate: of the log that results [Hz]; default: the log's, else 250 Hz.
        start: `q.<joint>` or `v.<joint>` [rad | m | …/s] of some joints; others: as the log begins,
            else assembled near [joints] start and at rest.
        values: by full name: effects' unknowns and dynamic parameters, in place of the URDF's.
        pi: all dynamic parameters (10 · bodies,) in place of the URDF's.
        noise: on the log, after everything is computed.
        seed: of the noise.
        columns: which of `q`, `v`, `a`, `tau` the log gets.
        joints: of which joints it gets positions and rates; default: the drives, or all joints of
            the tree where drives are fewer than degrees of freedom.
        tolerance: relative error of a step.
        progress: called with (what is being done, share done).

    Raises:
        MechanismError: for an effect that cannot be integrated or has no value, or parameters with
            which forces do not determine the motion.
        MotionError: if the log does not fit the mechanism, or the motion cannot go on.
    """
    check_channels(columns)
    for what, value, unit in (("duration", duration, " s"), ("rate", rate, " Hz")):
        if value is not None and not 0 < value < np.inf:
            raise MotionError(f"{what} {value:g}{unit}; give a number above 0")
    if not 1e-13 <= tolerance <= 1e-3:
        raise MotionError(f"tolerance {tolerance:g}; valid: 1e-13 to 1e-3, as 1e-10")
    point = point_of(mechanism, values, pi)
    e = knots = None
    played = isinstance(drive, Torques)
    name, longest, extra = "simulated", np.inf, dict[str, interp1d]()
    if drive is None:
        model = mechanism
        for effect in mechanism.effects:
            model = model.corrected(constant_correction(effect, point))
        check_needs(model, model.name, ())
        logging = model
        model, point, _ = twisting(model, point, None)
        q, v = model.assembled, np.zeros(model.model.nv)
        t = _times(0.0, DURATION if duration is None else duration, RATE if rate is None else rate)
    else:
        given = drive.log if isinstance(drive, Torques) else drive.reference
        motion = complete(mechanism, given, torques=played)
        scene = Scene.of(mechanism, NOTHING, motion.experiments[0], point, motion.band.cutoff)
        e = one_run(replace(motion, experiments=(scene.e,)))
        logging = scene.mechanism
        model, point, e = twisting(logging, point, e)
        assert e is not None
        q, v, t, span = e.q[0], e.v[0], e.t, float(e.t[-1] - e.t[0])
        if duration is not None and duration > span * (1 + 1e-9):
            raise MotionError(
                f"{e.name}: lasts {span:.4g} s, so nothing is known for {duration:g} s; give a "
                "--duration of at most that"
            )
        if duration is not None or rate is not None:
            t = _times(float(t[0]), span if duration is None else duration, rate or e.rate)
        extra, name, longest = interpolated(e), e.name, STEPS / e.rate
        knots = rough_times(e) if played else None
    q, v = start_state(model, start or {}, q, v)
    plant = Plant(model, point)
    independent = best_conditioned(model, q[None]) if model.closures else ()
    dynamics = Dynamics(
        plant,
        actuator_of(drive, plant, point, e),
        independent,
        extra,
        0.0 if e is None else float(e.t[0]),
    )
    jumps = None if e is None or not played else steps_of(command_laws(model, point, e))
    integration = Integration(dynamics, tolerance, longest, knots, jumps=jumps)
    integration.run((q, v, np.zeros(len(plant.laws.states))), t, progress)
    series = [
        (m.q, m.v, b.a, b.tau, b.multipliers, b.friction, x) for m, b, x in integration.samples
    ]
    q, v, a, tau, forces, friction, modes = (
        np.array(values).reshape(len(t), -1) for values in zip(*series, strict=True)
    )
    y, yd, ydd = joint_coordinates(model, q, v, a, {})
    encoders = [x[:, : len(logging.joints)] for x in (y, yd, ydd)]  # of motors, not of links
    logged = _columns(logging, point, t, encoders, tau, columns, joints)
    logged = with_noise(logged, noise, seed) | {key: x(t) for key, x in extra.items()}
    return Run(
        model, Log.from_arrays(name, t, logged), t, q, v, a, y, yd, ydd, tau, forces,
        dict(zip(integration.names, friction.T, strict=True)),
        dict(zip(integration.names, modes.T == STICK, strict=True)),
        tuple(integration.transitions),
        float(np.abs(model.kinematics.closure_rows(q).value).max(initial=0.0)),
        integration.evaluations,
    )  # fmt: skip


def _times(since: float, duration: float, rate: float) -> np.ndarray:
    count = int(np.floor(duration * rate * (1 + 1e-12))) + 1
    if count < 2:
        raise MotionError(
            f"duration {duration:g} s at {rate:g} Hz is less than one step; simulate longer "
            "or give a higher rate"
        )
    return since + np.arange(count) / rate


def interpolated(e: State) -> dict[str, interp1d]:
    """Return a log's columns beside the motion and the torques, linear between samples."""
    return {
        name: interp1d(e.t, x, bounds_error=False, fill_value=(x[0], x[-1]))
        for name, x in e.extra.items()
        if not name.startswith("tau.")
    }


def rough_times(e: State) -> np.ndarray | None:
    """Return times of the samples (n,) if torques are noisy: a spline through noise is rough."""
    return e.t if any(noise_share(x) > ROUGH for x in e.tau.T) else None


def start_state(
    mechanism: Mechanism, given: Mapping[str, float], q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return q (nq,) and v (nv,) with some joints at given values; the closures place the others.

    Values are given by `q.<joint>` or `v.<joint>` [rad | m | …/s]; `<joint>` alone means q.
    """
    wanted = {key if key[:2] in ("q.", "v.") else f"q.{key}": x for key, x in given.items()}
    names = [joint.name for joint in mechanism.joints]
    for key, value in wanted.items():
        if key[2:] not in names:
            raise MotionError(f"start: {key} is of no joint; {one_of(key[2:], names)}")
        if not np.isfinite(value):
            raise MotionError(f"start: {key} = {value}; give a finite number")
    if not wanted:
        return q, v
    asked = list(dict.fromkeys(key[2:] for key in wanted))
    chosen = independent_joints(mechanism, [*asked, *mechanism.driven, *names])
    if surplus := [name for name in asked if name not in chosen]:
        raise MotionError(
            f"start: {mechanism.name} has {mechanism.degrees_of_freedom} degrees of freedom, so "
            f"{', '.join(asked)} cannot all be chosen; leave out {', '.join(surplus)}"
        )
    solver = LoopSolver(mechanism, chosen)
    now = solver.coordinates(q[None], v[None])
    y, yd = now.value[0], now.rate[0] @ v
    goal = np.array([wanted.get(f"q.{name}", x) for name, x in zip(chosen, y, strict=True)])
    rate = np.array([wanted.get(f"v.{name}", x) for name, x in zip(chosen, yd, strict=True)])
    if not mechanism.closures:
        q = q.copy()
        q[[mechanism.joint(name).index for name in chosen]] = goal
        return q, rate
    q = solver.follow(goal[None], np.zeros(1))[0]
    v, _ = solver.rates(q[None], rate[None], np.zeros((1, len(chosen))))
    return q, v[0]


def _columns(
    mechanism: Mechanism,
    point: Point,
    t: np.ndarray,
    true: Sequence[np.ndarray],
    torques: np.ndarray,
    channels: Sequence[str],
    joints: Sequence[str] | None,
) -> dict[str, np.ndarray]:
    """Return the log's columns (n,) by name, with the errors of its sensors, without noise."""
    # a machine with drives has no torque sensor
    both = zip(mechanism.driven, torques.T, strict=True)
    tau = {name: x for name, x in both if name not in mechanism.drives}
    sensed, names = [x.copy() for x in true], mechanism.driven
    if len(independent_joints(mechanism, names)) < mechanism.degrees_of_freedom:
        tree = tuple(joint.name for joint in mechanism.joints if joint.in_tree)
        names = tree or tuple(joint.name for joint in mechanism.joints)
    for effect in mechanism.effects:
        what = constant_correction(effect, point)
        for name, d in what.position_delay.items():
            for x in sensed:
                x[:, mechanism.joint_index[name]] = late(t, x[:, mechanism.joint_index[name]], d)
        for name, dq in what.dq.items():
            i = mechanism.joint_index[name]
            dq = np.broadcast_to(np.asarray(dq, dtype=float), t.shape)
            dv = np.gradient(dq, t)
            for x, offset in zip(sensed, (dq, dv, np.gradient(dv, t)), strict=True):
                x[:, i] -= offset
    names = names if joints is None else tuple(joints)
    return columns_of(mechanism, point, t, sensed, tau, channels, names)
