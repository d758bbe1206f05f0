"""Kinematically driven simulation: the torques that a given motion needs, exactly, then noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from ident.effects.drive import Delay
from ident.equations.correct import late
from ident.errors import MotionError
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment, Motion, complete
from ident.residual.predict import Prediction, predict
from ident.simulate.noise import CHANNELS, Noise, check_channels, noisy
from ident.simulate.values import point_of


def simulate(
    mechanism: Mechanism,
    motion: Log,
    *,
    values: Mapping[str, float] | None = None,
    pi: np.ndarray | None = None,
    noise: Sequence[Noise] = (),
    seed: int = 0,
    columns: Sequence[str] = CHANNELS,
    joints: Sequence[str] | None = None,
) -> tuple[Log, Prediction]:
    """A log as the mechanism would have made it on a given motion.

    Args:
        mechanism: with effects; an effect's unknowns need values, from `[[effect]]` or `values`.
        motion: positions (and rates, accelerations) of joints that determine the motion; torques
            are not needed, but wrenches and other columns of it count.
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
        MechanismError: for names that are not there, or an effect's unknown without a value.
        MotionError: if the motion cannot be completed, or drives a coordinate that has no drive.
    """
    check_channels(columns)
    completed = complete(mechanism, motion, torques=False)
    _check_driven(mechanism, completed)
    point = point_of(mechanism, values, pi)
    e = one_run(completed)
    completed = replace(completed, experiments=(e,))
    (prediction,) = predict(mechanism, completed, point)
    if joints is None:
        joints = [joint.name for joint in mechanism.joints if f"q.{joint.name}" in motion]
    found = _columns(mechanism, completed, e, prediction, columns, joints)
    for effect in mechanism.effects:
        if isinstance(effect, Delay) and f"tau.{effect.joints[0]}" in found:
            (d,) = point.of(effect)[1].values()
            channel = f"tau.{effect.joints[0]}"
            found[channel] = late(e.t, found[channel], d)
    extra = {name: x for name, x in e.extra.items() if not name.startswith("tau.")}
    found = noisy(found, noise, np.random.default_rng(seed))
    made = Log.from_arrays(motion.name, e.t, {**found, **extra})
    return replace(made, repairs=(*made.repairs, *completed.notes)), prediction


def one_run(motion: Motion) -> Experiment:
    """The experiment between the ends that its splines lose.

    Raises:
        MotionError: if samples are missing in between, so that there is no one motion to follow.
    """
    (e,) = motion.experiments
    runs = list(e.segments())
    if len(runs) != 1:
        said = "; ".join(motion.notes)
        raise MotionError(
            f"{e.name}: the motion has {len(runs)} runs with gaps between them: {said}"
        )
    cut: dict[str, Any] = {
        field.name: value[runs[0]]
        for field in fields(e)
        if field.name != "still" and isinstance(value := getattr(e, field.name), np.ndarray)
    }
    return replace(e, **cut, extra={name: x[runs[0]] for name, x in e.extra.items()})


def _check_driven(mechanism: Mechanism, motion: Motion) -> None:
    for name in motion.independent:
        if name not in mechanism.driven:
            raise MotionError(
                f"{mechanism.name}: '{name}' is passive, so no torque can hold it to a given "
                "motion; a kinematic simulation needs as many drives as degrees of freedom"
            )


def _columns(
    mechanism: Mechanism,
    motion: Motion,
    e: Experiment,
    prediction: Prediction,
    wanted: Sequence[str],
    joints: Sequence[str],
) -> dict[str, np.ndarray]:
    found = {}
    for channel, series in (("q", e.y), ("v", e.yd), ("a", e.ydd)):
        if channel in wanted:
            for name in joints:
                mechanism.joint(name)
                found[f"{channel}.{name}"] = series[:, mechanism.joint_index[name]]
    if "tau" not in wanted:
        return found
    others = [name for name in mechanism.driven if name not in motion.independent]
    torque = prediction.predicted.copy()
    for name in others:  # a surplus drive does what the motion's log says of it, else nothing
        tau = e.tau[:, mechanism.driven.index(name)]
        found[f"tau.{name}"] = tau
        assert e.leverage is not None
        torque -= e.leverage[:, mechanism.joint_index[name]] * tau[:, None]
    for i, name in enumerate(motion.independent):
        found[f"tau.{name}"] = torque[:, i]
    return found
