"""What URDF, SDF and Drake hold of a machine, and whether the list of what is lost is right.

    python benchmarks/targets.py [--data DIR]… [NAME …]

Machines and effects of `replay_export.py`, and a ripple. The exported file is read by the program
it is for (URDF: MuJoCo; SDF and Drake: Drake, which reads no dry friction), whose inverse dynamics
(of MuJoCo above 0.3 rad/s, where the default softness of its friction has no part in it) are held
against `ident`'s torques along another motion. *Held*: the largest difference over joints with
the effects that the target holds [N m | N], and in mrad at a controller of 5 Hz; of Drake also the
replay of a log in mrad. *Lost*: of each kind of effect that it cannot hold, added alone, the rms
torque that is missing in the program, largest over joints, and what the list of the export says.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from machines import arguments
from replay_export import robots

import ident
from ident import Log, Mechanism
from ident.export.export import Export, export
from ident.export.laws import BANDWIDTH, felt_inertia, nominal_motion
from ident.export.machine import machine_of
from ident.export.rollout import compiled, joint_places, urdf_as_moved
from ident.fit.prediction import predict
from ident.motion import Motion

NAMES = ("arm", "UR5", "Panda")
TARGETS = ("urdf", "sdf", "drake")
UNREAD = {"sdf": ("coulomb",)}  # by the program here, though the target has words for it
SOFT = 0.3  # [rad/s]


def main() -> None:
    names, places = arguments(__doc__, NAMES)
    print(
        "| robot, target | held: torque | position | replay | lost, each alone: missing / listed |"
    )
    print("|---|---|---|---|---|")
    for name, mechanism, model, values in robots(names, places):
        joint = mechanism.driven[-1]
        model = model.with_effect(f"ripple:{joint}")
        size = felt_inertia(machine_of(mechanism))[joint]
        values |= {f"ripple.{joint}.A": 2 * size, f"ripple.{joint}.B": size,
                   f"ripple.{joint}.N": 6.0}  # fmt: skip
        for target in TARGETS:
            print(f"| {name}, {target} | {' | '.join(row(model, values, target))} |", flush=True)


def row(model: Mechanism, values: dict[str, float], target: str) -> list[str]:
    """The cells of one machine and one target."""
    out = Path(f"x.{'sdf' if target == 'sdf' else 'urdf'}")
    words = export(model, target, values=values, fitted=False, out=out)
    lost = {item.label.partition(":")[0] for item in words.lost} | {*UNREAD.get(target, ())}

    def of(kinds: set[str]) -> tuple[Export, np.ndarray, Motion]:
        """The export, and the missing torque (n, joints), of a machine with effects of kinds."""
        part = model
        for effect in model.effects:
            if effect.kind not in kinds:
                part = part.without(effect.label)
        names = {full for effect in part.effects for full in effect.names}
        known = {name: x for name, x in values.items() if name in names}
        motion = motion_of(part, known)
        made = export(part, target, values=known, fitted=False, out=out, log=motion)
        (prediction,) = predict(made.machine.mechanism, motion, made.machine.point)
        e = prediction.scene.e
        torque = by_mujoco if target == "urdf" else by_drake
        missing = torque(made, e.q, e.v, e.a) - prediction.predicted
        slow = np.maximum(e.still[: e.v.shape[1]], SOFT if target == "urdf" else 0.0)
        missing[np.abs(e.v) <= slow] = np.nan
        return made, missing, motion

    kinds = {effect.kind for effect in model.effects}
    made, missing, motion = of(kinds - lost)
    inertia = felt_inertia(made.machine)
    order = {link.joint.name: link.joint.index for link in made.machine.links}
    rms = np.sqrt(np.nanmean(missing**2, axis=0))
    position = max(rms[k] / (BANDWIDTH**2 * inertia[joint]) for joint, k in order.items())
    first, replay = [f"{rms.max():.1g}", f"{1e3 * position:.1g}"], "–"
    if target == "drake":
        mechanism, known = made.machine.mechanism, made.machine.point.values
        names = {full for effect in mechanism.effects for full in effect.names}
        known = {name: x for name, x in known.items() if name in names}
        runs = export(
            mechanism, target, values=known, out=out, log=motion, replayed=True
        ).replays.runs
        replay = f"{1e3 * max(x.rms for x in runs['Drake'][0].errors.values()):.3f}"
    cells = []
    for kind in sorted(lost - {*UNREAD.get(target, ())}):
        made, missing, _ = of((kinds - lost) | {kind})
        rms = np.sqrt(np.nanmean(missing**2, axis=0))
        listed = {item.where: item for item in made.lost}
        worst = max(listed, key=lambda joint: listed[joint].torque)
        item = listed[worst]
        if item.label.startswith("encoder_offset"):
            true = next(x for name, x in values.items() if name.startswith("encoder_offset"))
            cells.append(f"{kind} {1e3 * true:.3g} / {1e3 * item.position:.3g} mrad")
            continue
        ratio = max(abs(rms[order[j]] / listed[j].torque - 1) for j in listed if listed[j].torque)
        cells.append(f"{kind} {rms[order[worst]]:.3g} / {item.torque:.3g} ({100 * ratio:.0f} %)")
    return [*first, replay, ", ".join(cells)]


def motion_of(mechanism: Mechanism, values: dict[str, float]) -> Motion:
    """A motion of the machine, with its torques."""
    (e,) = nominal_motion(mechanism).experiments
    columns = {
        f"{c}.{name}": x[::-1, mechanism.joint_index[name]] * sign
        for c, x, sign in zip("qva", (e.y, e.yd, e.ydd), (1, -1, 1), strict=True)
        for name in mechanism.driven
    }  # fmt: skip
    log, _ = ident.simulate(mechanism, Log.from_arrays("run", e.t, columns), values=values)
    return ident.complete(mechanism, log)


def by_mujoco(made: Export, *state: np.ndarray) -> np.ndarray:
    """Torques (n, joints) of a URDF, by MuJoCo's inverse dynamics."""
    model = compiled(urdf_as_moved(made.text.encode(), made.machine))
    at_q, at_v = joint_places(model, [link.joint.name for link in made.machine.links])
    order = [link.joint.index for link in made.machine.links]
    data, tau = mujoco.MjData(model), np.empty(state[0].shape)
    for i, (q, v, a) in enumerate(zip(*state, strict=True)):
        data.qpos[at_q], data.qvel[at_v], data.qacc[at_v] = q[order], v[order], a[order]
        mujoco.mj_inverse(model, data)
        tau[i, order] = data.qfrc_inverse[at_v]
    return tau


def by_drake(made: Export, *state: np.ndarray) -> np.ndarray:
    """Torques (n, joints) of a URDF or SDF, by Drake's inverse dynamics."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import MultibodyForces

    plant = MultibodyPlant(time_step=0.0)
    kind = next(iter(made.files)).rpartition(".")[2]
    text = made.text.encode()
    bare = (urdf_as_moved(text, made.machine) if kind == "urdf" else text).decode()
    model = Parser(plant).AddModelsFromString(bare, kind)[0]
    root = made.machine.mechanism.model.frames[1].name
    links = {plant.get_body(i).name() for i in plant.GetBodyIndices(model)}
    if root in links and plant.GetBodiesWeldedTo(plant.world_body()) == [plant.world_body()]:
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(root, model))
    plant.mutable_gravity_field().set_gravity_vector(made.machine.gravity)
    plant.Finalize()
    links_of = made.machine.links
    joints = [plant.GetJointByName(link.joint.name, model) for link in links_of]
    at_q, at_v = [j.position_start() for j in joints], [j.velocity_start() for j in joints]
    order = [link.joint.index for link in links_of]
    context, tau = plant.CreateDefaultContext(), np.empty(state[0].shape)
    for i, (q, v, a) in enumerate(zip(*state, strict=True)):
        x = np.zeros((3, plant.num_positions()))
        x[0, at_q], x[1, at_v], x[2, at_v] = q[order], v[order], a[order]
        plant.SetPositionsAndVelocities(context, np.concatenate(x[:2]))
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        tau[i, order] = plant.CalcInverseDynamics(context, x[2], forces)[at_v]
    return tau


if __name__ == "__main__":
    main()
