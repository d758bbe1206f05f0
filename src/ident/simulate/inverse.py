"""The verb `simulate`: the torques that a given motion needs, exactly, then noise."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.effects import KINDS
from ident.effects.effect import SAMPLED
from ident.effects.servo import HOLD
from ident.equations.rows import holding_torques
from ident.equations.unknowns import Point
from ident.errors import LogError, MechanismError, MotionError, check_whole, one_of
from ident.fit.prediction import Prediction, predict
from ident.information.cubic import late
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, State, complete
from ident.motion.closures import independent_joints
from ident.motion.motion import Given, log_of
from ident.simulate.plant import constant_correction

CHANNELS = ("q", "v", "a", "tau")


@dataclass(frozen=True)
class Noise:
    """White noise on the columns that a pattern names.

    Attributes:
        channel: `q`, `v`, `a`, `tau`, or a column's name (`tau.elbow`, wildcards allowed).
        level: standard deviation in the column's unit, or its share of the column's own.
        relative: whether `level` is a share.
    """

    channel: str
    level: float
    relative: bool = False

    def matches(self, column: str) -> bool:
        """Whether a column gets this noise."""
        pattern = f"{self.channel}.*" if self.channel in CHANNELS else self.channel
        return fnmatch.fnmatchcase(column, pattern)


def simulate(
    mechanism: Mechanism,
    motion: Given,
    *,
    values: Mapping[str, float] | None = None,
    pi: np.ndarray | None = None,
    noise: Sequence[Noise] = (),
    seed: int = 0,
    columns: Sequence[str] = CHANNELS,
    joints: Sequence[str] | None = None,
) -> tuple[Log, Prediction]:
    """Return the log that the mechanism would have made on a given motion.

    Args:
        mechanism: with effects; an effect's unknowns need values, from `[[effect]]` or `values`.
        motion: a log, as `complete` takes it: positions (and rates, accelerations) of joints that
            determine the motion; torques are not needed, but wrenches and other columns count.
        values: by full name: effects' unknowns (`viscous.elbow.Fv`) and dynamic parameters
            (`rod.m`, `rod.Ixx` or `rod.Lxx`), the latter in place of the URDF's.
        pi: all dynamic parameters (10 · bodies,) in place of the URDF's.
        noise: added after everything is computed.
        seed: of the noise.
        columns: which of `q`, `v`, `a`, `tau` the log gets.
        joints: of which joints it gets positions and rates; default: those in `motion`.

    Returns:
        The log, and the prediction with the multipliers behind it, free of noise. Samples near
        the ends of a motion that had to be smoothed are left out; `Log.repairs` says so.

    Raises:
        MechanismError: for unknown names, or an effect's unknown without a value.
        MotionError: if the motion cannot be completed, or drives a coordinate that has no drive.
    """
    check_channels(columns)
    motion = log_of(mechanism, motion)
    completed = complete(mechanism, motion, torques=False)
    for name in completed.independent:
        if name not in mechanism.driven:
            raise MotionError(
                f"{mechanism.name}: '{name}' is passive, so no torque can hold it to a given "
                "motion; a kinematic simulation needs as many drives as degrees of freedom"
            )
    point = point_of(mechanism, values, pi)
    e = one_run(completed)
    (prediction,) = predict(mechanism, replace(completed, experiments=(e,)), point)
    if joints is None:
        joints = [joint.name for joint in mechanism.joints if f"q.{joint.name}" in motion]
    torque, tau = prediction.predicted.copy(), {}
    for i, name in enumerate(mechanism.driven):
        if name not in completed.independent:  # it does as the motion's log says, else nothing
            tau[name] = e.tau[:, i]
            torque -= e.leverage[:, mechanism.joint_index[name]] * tau[name][:, None]
    tau |= dict(zip(completed.independent, torque.T, strict=True))
    if taken := sum(constant_correction(x, point).compensated for x in mechanism.effects):
        holding = holding_torques(
            mechanism, e
        )  # a controller subtracts these before they are logged
        tau = {name: tau[name] - taken * holding[:, i] for i, name in enumerate(mechanism.driven)}
    logged = columns_of(mechanism, point, e.t, (e.y, e.yd, e.ydd), tau, columns, joints)
    made = ("tau.", HOLD, SAMPLED)
    extra = {n: x for n, x in e.extra.items() if not n.startswith(made)}
    log = Log.from_arrays(motion.name, e.t, {**with_noise(logged, noise, seed), **extra})
    return replace(log, repairs=(*log.repairs, *completed.notes)), prediction


def one_run(motion: Motion) -> State:
    """Return the state between the ends that its splines lose; refuse a motion with gaps."""
    (e,) = motion.experiments
    runs = list(e.segments())
    if len(runs) != 1:
        raise MotionError(
            f"{e.name}: the motion has {len(runs)} runs with gaps between them: "
            f"{'; '.join(motion.notes)}"
        )
    return e.at_samples(runs[0])


def joint_columns(
    mechanism: Mechanism, series: Mapping[str, np.ndarray], joints: Sequence[str]
) -> dict[str, np.ndarray]:
    """Return columns (n,) of some joints from series (n, J) by channel."""
    names = [mechanism.joint(name).name for name in joints]
    at = mechanism.joint_index
    return {f"{c}.{name}": x[:, at[name]] for c, x in series.items() for name in names}


def columns_of(
    mechanism: Mechanism,
    point: Point,
    t: np.ndarray,
    motion: Sequence[np.ndarray],
    tau: Mapping[str, np.ndarray],
    channels: Sequence[str],
    joints: Sequence[str],
) -> dict[str, np.ndarray]:
    """Return a log's columns (n,) of the coordinates, rates and accelerations (n, J) of joints, and
    of the torques (n,) by drive, which their channels write late: of all drives where these joints
    determine the motion, else of those that are among them.
    """
    series = {c: x for c, x in zip("qva", motion, strict=True) if c in channels}
    logged = joint_columns(mechanism, series, joints)
    if "tau" in channels:
        all_determined = len(independent_joints(mechanism, joints)) == mechanism.degrees_of_freedom
        tau = {name: x for name, x in tau.items() if all_determined or name in joints}
        corrections = [constant_correction(effect, point) for effect in mechanism.effects]
        delays = {name: d for correction in corrections for name, d in correction.delay.items()}
        logged |= {f"tau.{name}": late(t, x, delays.get(name, 0.0)) for name, x in tau.items()}
    return logged


def with_noise(
    columns: Mapping[str, np.ndarray], noise: Sequence[Noise], seed: int
) -> dict[str, np.ndarray]:
    """Return columns (n,) by name with their noise; refuse noise on no column."""
    check_whole("seed", seed)
    random = np.random.default_rng(seed)
    for channel_noise in noise:
        if not any(map(channel_noise.matches, columns)):
            valid = {name.partition(".")[0] for name in columns} | set(columns)
            wanted = channel_noise.channel
            raise MotionError(f"noise: no column '{wanted}'; {one_of(wanted, valid)}")
    noisy = {}
    for name, x in columns.items():
        for channel_noise in (one for one in noise if one.matches(name)):
            sigma = channel_noise.level * (float(np.std(x)) if channel_noise.relative else 1.0)
            x = x + sigma * random.standard_normal(len(x))
        noisy[name] = x
    return noisy


def level(x: np.ndarray, snr: float) -> float:
    """Return the standard deviation σ of the noise of x (n,) at a signal-to-noise ratio [dB].

        σ = rms(x) · 10^(−SNR / 20)

    The signal's power includes its mean, as in MATLAB's awgn(x, snr, 'measured'); the paper gives
    its ratios without a definition.
    """
    power = float(np.mean(x[np.isfinite(x)] ** 2)) if np.isfinite(x).any() else 0.0
    return float(np.sqrt(power) * 10 ** (-snr / 20))


def noisy_columns(log: Log, channels: Sequence[str]) -> tuple[str, ...]:
    """Return the columns of a log that get noise; refuse an unknown channel, or a log of none."""
    valid = (*CHANNELS, "wrench")
    for channel in channels:
        if channel not in valid:
            raise LogError(f"noise on '{channel}'; {one_of(channel, valid)}")
    columns = tuple(name for name in log.columns if name.partition(".")[0] in channels)
    if not columns:
        raise LogError(f"{log.name}: no column of {', '.join(channels)}, so there is no noise")
    return columns


def noisy(log: Log, snr: float, columns: Sequence[str], random: np.random.Generator) -> Log:
    """Return the log with noise on some columns; empty cells stay empty."""
    series = dict(log.columns)
    for name in columns:
        x = series[name]
        series[name] = x + level(x, snr) * random.standard_normal(len(x))
    return Log(log.name, series, log.t, log.repairs)


def random_of(seed: int, snr: float, run: int) -> np.random.Generator:
    """Return the generator of one run's noise, which depends on these three numbers alone."""
    decibels = round(1000 * snr)
    key = (2 * abs(decibels) + (decibels < 0), run)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def check_channels(columns: Sequence[str]) -> None:
    """Refuse a channel that logs do not have."""
    for column in (column for column in columns if column not in CHANNELS):
        raise MotionError(f"columns: '{column}'; {one_of(column, CHANNELS)}")


def point_of(
    mechanism: Mechanism, values: Mapping[str, float] | None, pi: np.ndarray | None
) -> Point:
    """Return the point of the URDF's values and those given by name; refuse unknown names, and an
    effect's unknown without a value.
    """
    given = dict(values or {})
    bodies = mechanism.bodies
    parameters = bodies.with_values(mechanism.prior if pi is None else pi, given)
    of_effects: dict[str, float] = {}
    for effect in mechanism.effects:
        for name, unknown in zip(effect.names, effect.parameters, strict=True):
            value = given.pop(name, effect.values.get(unknown.name))
            if value is None:
                raise MechanismError(
                    f"effect '{effect.label}': give {name} a value to simulate it: --set {name}=…, "
                    f"or {unknown.name} = … in its [[effect]]"
                )
            of_effects[name] = float(value)
    for name in given:
        place, hint = name.rpartition(".")[0], one_of(name, [*bodies.names, *of_effects])
        kind, _, site = (place or name).partition(".")
        if kind in KINDS and place not in {
            name_of_value.rpartition(".")[0] for name_of_value in of_effects
        }:
            label = f"{kind}:{site}" if site else kind
            hint = (
                f"the model has no effect '{label}'; add it: --with {label}, or an [[effect]] in "
            )
            hint += "mechanism.toml"
        raise MechanismError(f"{mechanism.name}: no parameter '{name}'; {hint}")
    return Point(parameters, of_effects)
