"""Drake's motion of a written URDF under the torques of a log: a tree, in continuous time."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from ident.equations.rows import Scene
from ident.equations.unknowns import NOTHING
from ident.errors import IdentError
from ident.export.machine import Machine
from ident.export.rollout import urdf_as_moved
from ident.motion import Motion, State
from ident.simulate.replay import ReplayedLog, tree_columns

STEP = 1e-3  # numerics: [s] of the method of order 4


def replayed_in_drake(
    text: bytes | Path, machine: Machine, motion: Motion, window: float
) -> list[ReplayedLog]:
    """Return the motion of Drake's plant on every log, as `ident.replay` does.

    Raises:
        IdentError: without Drake, or for a machine with loops.
    """
    try:
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import MultibodyPlant
    except ImportError:
        raise IdentError('replaying in Drake needs Drake: pip install "ident[drake]"') from None
    if machine.drawing.closures:
        raise IdentError("--replay: Drake closes loops in its discrete solver only; use mjcf")
    plant = MultibodyPlant(time_step=0.0)
    data = text.read_bytes() if isinstance(text, Path) else text
    bare = urdf_as_moved(data, machine).decode()
    log = logging.getLogger("drake")  # warns of every tag that it has no use for
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        model = Parser(plant).AddModelsFromString(bare, "urdf")[0]
    finally:
        log.setLevel(before)
    root = machine.mechanism.model.frames[1].name
    links = {plant.get_body(i).name() for i in plant.GetBodyIndices(model)}
    if root in links and plant.GetBodiesWeldedTo(plant.world_body()) == [plant.world_body()]:
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(root, model))
    gravity: Any = machine.gravity
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    plant.Finalize()
    return [_replayed(plant, model, machine, motion, e, window) for e in motion.experiments]


def _replayed(
    plant: Any, model: Any, machine: Machine, motion: Motion, bare: State, window: float
) -> ReplayedLog:
    mechanism = machine.mechanism
    scene = Scene.of(mechanism, NOTHING, bare, machine.point, motion.band.cutoff)
    e = scene.e
    joints = [plant.GetJointByName(link.joint.name, model) for link in machine.links]
    at_q, at_v = [j.position_start() for j in joints], [j.velocity_start() for j in joints]
    columns = [link.joint.index for link in machine.links]
    context, n = plant.CreateDefaultContext(), plant.num_positions()
    force = np.zeros((plant.num_velocities(), len(mechanism.driven)))
    for k, name in enumerate(mechanism.driven):
        force[plant.GetJointByName(name, model).velocity_start(), k] = 1.0
    spline = CubicSpline(e.t, e.tau)
    port = plant.get_applied_generalized_force_input_port()

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        plant.SetPositionsAndVelocities(context, x)
        port.FixValue(context, force @ spline(t))
        return np.asarray(plant.EvalTimeDerivatives(context).CopyToVector())

    result, starts = np.full(e.y.shape, np.nan), list[int]()
    tree = [mechanism.joint_index[link.joint.name] for link in machine.links]
    length = max(2, round(window * e.rate))
    for segment in e.segments():
        for a in range(segment.start, segment.stop - 1, length):
            starts.append(a)
            x = np.zeros(n + plant.num_velocities())
            x[at_q], x[n + np.array(at_v)] = e.q[a, columns], e.v[a, columns]
            for k in range(a, min(a + length, segment.stop - 1)):
                count = max(1, int(np.ceil((e.t[k + 1] - e.t[k]) / STEP)))
                h = float(e.t[k + 1] - e.t[k]) / count
                for i in range(count):
                    t = float(e.t[k]) + i * h
                    k1 = rate(t, x)
                    k2 = rate(t + h / 2, x + h / 2 * k1)
                    k3 = rate(t + h / 2, x + h / 2 * k2)
                    x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(t + h, x + h * k3))
                result[k + 1, tree] = x[at_q]
    logged = [mechanism.joint_index[name] for name in e.logged]
    return ReplayedLog(
        e.name, e.t, tuple(e.logged), tuple(mechanism.joints[i].unit for i in logged),
        np.where(e.usable[:, None], e.y[:, logged], np.nan), result[:, logged], tuple(starts),
        (), result[:, tree_columns(mechanism)],
    )  # fmt: skip
