"""Logs of machines with position servos, by MuJoCo: commands and positions, no torques.

A joint may have a spring or play between its motor, whose encoder is logged, and its link, which
is a hinge of its own; its friction may grow with its load.
"""

from dataclasses import dataclass, field

import mujoco
import numpy as np

from helpers import ROOT

URDF = ROOT / "robots" / "servo_arm" / "servo_arm.urdf"
STEP = 2e-4  # [s]
SETTLING = 3.0  # [s] before a log, in which links come to rest on their springs
TWIST = "_twist"  # ends the name of a hinge between a motor and its link
MIDDLE = np.array([0.0, -0.6, 1.0])  # [rad]


@dataclass(frozen=True)
class Servos:
    """Planted values of the three servos and joints."""

    kp: tuple = (20.0, 25.0, 14.0)  # [N m/rad]
    kd: tuple = (0.4, 0.5, 0.25)  # [N m s/rad]
    Fc: tuple = (0.12, 0.15, 0.08)  # [N m]
    Fv: tuple = (0.1, 0.12, 0.06)  # [N m s/rad]
    Ia: tuple = (0.012, 0.014, 0.008)  # [kg m²]
    delay: float = 0.008  # [s]
    later: dict = field(default_factory=dict)  # by joint, beyond that [s]
    springs: dict = field(
        default_factory=dict
    )  # by joint, stiffness [N m/rad], damping [N m s/rad]
    plays: dict = field(default_factory=dict)  # by joint, width [rad]
    loaded: dict = field(default_factory=dict)  # by joint, friction as a share of the load


def servo_log(
    truth=Servos(), seed=0, seconds=20.0, rate=200.0, bits=14, off=None, held=(), top=1.6,
    sensed=(), twisted=False, straight=False, step=STEP,
):  # fmt: skip
    """Columns of a log; `off`: a stretch of time [s] in which the drives have no torque; `held`:
    places of joints whose command stays; `top`: highest frequency of the commands [Hz]; `sensed`:
    joints whose motors have a torque sensor; `twisted`: whether the twist of links is a column;
    `straight`: whether commands go straight on between samples, or are held; `step` [s] of MuJoCo.
    """
    random = np.random.default_rng(seed)
    model = model_of(truth, step)
    names = [model.joint(j).name for j in range(model.njnt)]
    motors = [j for j, name in enumerate(names) if not name.endswith(TWIST)]
    n, names = len(motors), [names[j] for j in motors]
    loaded = [(motors[names.index(joint)], mu) for joint, mu in truth.loaded.items()]
    data, kp, kd = mujoco.MjData(model), np.array(truth.kp), np.array(truth.kd)
    t, hold = np.arange(seconds * rate) / rate, round(1 / rate / step)
    late = np.array([round((truth.delay + truth.later.get(name, 0.0)) / step) for name in names])
    f, phase = random.uniform(0.15, top, (n, 4)), random.uniform(0, 2 * np.pi, (n, 4))
    size = random.uniform(0.1, 0.3, (n, 4)) / np.sqrt(1 + f) / np.maximum(1, f / 1.6)
    size[list(held)] = 0.0
    ref = MIDDLE + (size * np.sin(2 * np.pi * f * t[:, None, None] + phase)).sum(axis=2)
    q, tau, on = np.empty_like(ref), np.empty_like(ref), np.ones(len(t))
    if off:
        on[(t >= off[0]) & (t < off[1])] = 0.0
    twists = [j for j in range(model.njnt) if j not in motors]
    twist = np.empty((len(t), len(twists)))
    data.qpos[motors] = ref[0]
    for _ in range(round(SETTLING / step) if twists else 0):
        data.qfrc_applied[motors] = kp * (ref[0] - data.qpos[motors]) - kd * data.qvel[motors]
        mujoco.mj_step(model, data)
    load, at = np.zeros(model.nv), np.arange(n)
    since, part = np.divmod(np.maximum(0, np.arange(len(t) * hold)[:, None] - late), hold)
    commands = ref[since, at]
    if straight:
        after = ref[np.minimum(since + 1, len(ref) - 1), at]
        commands = commands + part / hold * (after - commands)
    places, qpos, qvel, applied = np.array(motors), data.qpos, data.qvel, data.qfrc_applied
    for i, command in enumerate(commands):
        angles, k = qpos[places], i // hold
        torque = on[k] * (kp * (command - angles) - kd * qvel[places])
        if i % hold == 0:
            q[k], tau[k], twist[k] = angles, torque, qpos[twists]
        applied[places] = torque
        if loaded and i:
            mujoco.mj_rne(model, data, 1, load)
            for j, mu in loaded:  # rne has no armature: what the bodies need
                model.dof_frictionloss[j] = truth.Fc[motors.index(j)] + mu * abs(load[j])
        mujoco.mj_step(model, data)
    step = 2 * np.pi / 2**bits
    columns = {"t": t}
    for j, name in enumerate(names):
        columns |= {f"q.{name}": np.round(q[:, j] / step) * step, f"ref.{name}": ref[:, j]}
        columns |= {f"tau.{name}": tau[:, j]} if name in sensed else {}
    for j, x in zip(twists, twist.T, strict=True):
        columns |= {f"twist.{model.joint(j).name.removesuffix(TWIST)}": x} if twisted else {}
    return columns | ({f"on.{name}": on for name in names} if off else {})


def model_of(truth, step=STEP):
    """The arm, with a hinge for the link of each joint that has a spring or play."""
    spec = mujoco.MjSpec.from_file(str(URDF))
    spec.option.timestep, spec.option.integrator = step, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for joint, Ia in zip(list(spec.joints), truth.Ia, strict=True):
        joint.armature = Ia
        if joint.name not in {*truth.springs, *truth.plays}:
            continue
        joint.parent.add_joint(
            name=joint.name + TWIST,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=joint.axis,
            pos=joint.pos,
        )
    model = spec.compile()
    model.jnt_limited[:] = model.geom_contype[:] = model.geom_conaffinity[:] = 0
    place = 0
    for j in range(model.njnt):
        name = model.joint(j).name
        model.dof_solref[j] = 2 * step, 1.0
        if name.endswith(TWIST):
            joint = name.removesuffix(TWIST)
            if joint in truth.springs:
                model.jnt_stiffness[j], model.dof_damping[j] = truth.springs[joint]
            else:
                half = truth.plays[joint] / 2
                model.jnt_limited[j], model.jnt_range[j] = 1, (-half, half)
                model.jnt_solref[j], model.jnt_solimp[j, :2] = (2 * step, 1.0), (0.99, 0.999)
            continue
        model.dof_damping[j], model.dof_frictionloss[j] = truth.Fv[place], truth.Fc[place]
        place += 1
    return model
