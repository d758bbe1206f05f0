"""Logs of machines with position servos, by MuJoCo: commands and positions, no torques."""

from dataclasses import dataclass

import mujoco
import numpy as np

from helpers import ROOT

URDF = ROOT / "robots" / "servo_arm" / "servo_arm.urdf"
STEP = 2e-4  # [s]
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


def servo_log(truth=Servos(), seed=0, seconds=20.0, rate=200.0, bits=14, off=None, held=()):
    """Columns of a log; `off`: a stretch of time [s] in which the drives have no torque; `held`:
    places of joints whose command stays.
    """
    random, spec = np.random.default_rng(seed), mujoco.MjSpec.from_file(str(URDF))
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = spec.compile()
    n = model.nv
    model.dof_armature[:], model.dof_damping[:] = truth.Ia, truth.Fv
    model.dof_frictionloss[:], model.dof_solref[:] = truth.Fc, (2 * STEP, 1.0)
    model.jnt_limited[:] = model.geom_contype[:] = model.geom_conaffinity[:] = 0
    data, kp, kd = mujoco.MjData(model), np.array(truth.kp), np.array(truth.kd)
    t, hold, late = np.arange(seconds * rate) / rate, round(1 / rate / STEP), truth.delay / STEP
    f, phase = random.uniform(0.15, 1.6, (n, 4)), random.uniform(0, 2 * np.pi, (n, 4))
    size = random.uniform(0.1, 0.3, (n, 4)) / np.sqrt(1 + f)
    size[list(held)] = 0.0
    ref = MIDDLE + (size * np.sin(2 * np.pi * f * t[:, None, None] + phase)).sum(axis=2)
    q, on = np.empty_like(ref), np.ones(len(t))
    if off:
        on[(t >= off[0]) & (t < off[1])] = 0.0
    data.qpos[:] = ref[0]
    for i in range(len(t) * hold):
        if i % hold == 0:
            q[i // hold] = data.qpos
        command = ref[max(0, int((i - round(late)) // hold))]
        torque = kp * (command - data.qpos) - kd * data.qvel
        data.qfrc_applied[:] = on[i // hold] * torque
        mujoco.mj_step(model, data)
    step = 2 * np.pi / 2**bits
    columns = {"t": t}
    for j in range(n):
        name = model.joint(j).name
        columns |= {f"q.{name}": np.round(q[:, j] / step) * step, f"ref.{name}": ref[:, j]}
    return columns | ({f"on.{model.joint(j).name}": on for j in range(n)} if off else {})
