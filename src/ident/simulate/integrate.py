"""The verb `integrate`: forward simulation of a mechanism, free, driven by a log, or controlled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from scipy.interpolate import interp1d

from ident.equations.point import Point
from ident.equations.scene import Scene, check_needs
from ident.errors import MotionError
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment, Motion, complete
from ident.motion.independent import best_conditioned
from ident.motion.spectrum import noise_share
from ident.progress import Told
from ident.residual.predict import NOTHING
from ident.simulate.drives import Drive, Still, Torques
from ident.simulate.dynamics import Dynamics
from ident.simulate.instant import Actuator, Surroundings
from ident.simulate.inverse import one_run
from ident.simulate.march import March
from ident.simulate.noise import CHANNELS, Noise, check_channels, noisy
from ident.simulate.plant import Plant, corrected_mechanism
from ident.simulate.run import Run, columns_of, run_of
from ident.simulate.start import started
from ident.simulate.trace import State
from ident.simulate.values import point_of

DURATION, RATE = 10.0, 250.0  # [s], [Hz] where no log says
TOLERANCE = 1e-10
ROUGH = 1e-6  # share of noise above which torques are integrated sample by sample
STEPS = 5  # samples of a log that one step of the integration may pass over


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
    progress: Told | None = None,
) -> Run:
    """The motion that forces make: the equations of motion, integrated.

    Args:
        mechanism: with effects; an effect's unknowns need values, from `[[effect]]` or `values`.
        drive: `Torques(log)`, `PD(log)` or `ComputedTorque(log)`; None: no torque.
        duration: [s]; default: the log's, else 10 s.
        rate: of the log that is made [Hz]; default: the log's, else 250 Hz.
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
    _check_numbers(duration, rate, tolerance)
    point = point_of(mechanism, values, pi)
    e = None if drive is None else _experiment(mechanism, drive, point)
    if drive is None or e is None:
        right = corrected_mechanism(mechanism, point)
        q, v = started(right, start or {})
        t = _times(0.0, DURATION if duration is None else duration, RATE if rate is None else rate)
        plant, around = Plant.of(right, point), Surroundings()
        check_needs(right, nothing_logged(mechanism.name))
        actuator: Actuator = Still(len(right.driven))
        name, longest, knots = "simulated", np.inf, None
    else:
        right, bare = e
        q, v = started(right, start or {}, bare.q[0], bare.v[0])
        span = float(bare.t[-1] - bare.t[0])
        if duration is not None and duration > span * (1 + 1e-9):
            raise MotionError(
                f"{bare.name}: lasts {span:.4g} s, so nothing is known for {duration:g} s; give a "
                "--duration of at most that"
            )
        t = bare.t
        if duration is not None or rate is not None:
            t = _times(float(t[0]), span if duration is None else duration, rate or bare.rate)
        plant, around = Plant.of(right, point), surroundings(right, bare)
        actuator = drive.actuator(right, plant, bare)
        name, longest = bare.name, STEPS / bare.rate
        knots = rough(bare) if isinstance(drive, Torques) else None
    independent = best_conditioned(right, q[None]) if right.closures else ()
    dynamics = Dynamics(plant, actuator, around, independent)
    march = March(dynamics, tolerance, longest, knots)
    z = np.zeros(len(plant.laws.presliding))
    trace = march.run(State(q, v, z), t, progress)
    run = run_of(right, trace, Log.from_arrays(name, t, {}), march.names)
    made = columns_of(run, point, columns, joints)
    made = noisy(made, noise, np.random.default_rng(seed))
    extra = {key: np.array([f(x) for x in t]) for key, f in around.extra.items()}
    return replace(run, log=Log.from_arrays(name, t, {**made, **extra}))


def _check_numbers(duration: float | None, rate: float | None, tolerance: float) -> None:
    for what, value, unit in (("duration", duration, " s"), ("rate", rate, " Hz")):
        if value is not None and not 0 < value < np.inf:
            raise MotionError(f"{what} {value:g}{unit}; give a number above 0")
    if not 1e-13 <= tolerance <= 1e-3:
        raise MotionError(f"tolerance {tolerance:g}; valid: 1e-13 to 1e-3, as 1e-10")


def _times(since: float, duration: float, rate: float) -> np.ndarray:
    count = int(np.floor(duration * rate * (1 + 1e-12))) + 1
    if count < 2:
        raise MotionError(
            f"duration {duration:g} s at {rate:g} Hz is less than one step; simulate longer "
            "or give a higher rate"
        )
    return since + np.arange(count) / rate


def _experiment(mechanism: Mechanism, drive: Drive, point: Point) -> tuple[Mechanism, Experiment]:
    """The corrected mechanism and the log's one run, corrected too."""
    log = drive.log if isinstance(drive, Torques) else drive.reference
    motion = complete(mechanism, log, torques=isinstance(drive, Torques))
    return seen_run(mechanism, motion, point)


def seen_run(mechanism: Mechanism, motion: Motion, point: Point) -> tuple[Mechanism, Experiment]:
    """Mechanism and the one run of a motion, as correcting effects make them.

    Raises:
        MotionError: if samples are missing in between, so that there is no one run.
    """
    (bare,) = motion.experiments
    scene = Scene.of(mechanism, NOTHING, bare, point, motion.band.cutoff)
    return scene.mechanism, one_run(replace(motion, experiments=(scene.e,)))


def surroundings(mechanism: Mechanism, e: Experiment) -> Surroundings:
    """A log's wrenches and other columns, linear between samples."""
    extra = {
        name: interp1d(e.t, x, bounds_error=False, fill_value=(x[0], x[-1]))
        for name, x in e.extra.items()
        if not name.startswith("tau.")
    }
    frames: dict[str, np.ndarray] = {}
    for column, x in e.extra.items():
        if column.startswith("wrench."):
            frame, _, part = column[len("wrench.") :].rpartition(".")
            wrench = frames.setdefault(frame, np.zeros((len(e), 6)))
            wrench[:, ("fx", "fy", "fz", "mx", "my", "mz").index(part)] = x
    wrenches = tuple(
        (mechanism.model.getFrameId(frame, pin.FrameType.BODY), interp1d(e.t, wrench, axis=0))
        for frame, wrench in frames.items()
    )
    return Surroundings(float(e.t[0]), extra, wrenches)


def rough(e: Experiment) -> np.ndarray | None:
    """Times of the samples (n,) if torques are noisy: a spline through noise is not smooth."""
    return e.t if any(noise_share(x) > ROUGH for x in e.tau.T) else None


def nothing_logged(name: str) -> Experiment:
    """An experiment without samples or columns."""
    none = np.empty(0)
    return Experiment(name, none, *(none,) * 7, None, None, None, none, none)
