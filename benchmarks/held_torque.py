"""A Panda in MuJoCo under PD control with torques held between cycles: what does a diagnosis say?

    python benchmarks/held_torque.py [--seeds 20] [--hold 0.002]

MuJoCo integrates at 0.5 ms; a PD controller follows a random periodic motion and computes its
torques every `hold` seconds, which stay constant until the next cycle, as a robot's interface does.
Joints have damping, dry friction (frictionloss) and armature, all of them in the model that is
diagnosed. Each log has positions, velocities and torques at the controller's rate. Nothing is
missing but the time by which a held torque is early, half a cycle: the diagnosis should say
`nothing`, or name a delay. Needs mujoco and the package example-robot-data.
"""

from __future__ import annotations

import argparse
import re

import mujoco
import numpy as np
from robots import urdfs

import ident

STEP = 0.0005  # of the integration [s]
ARM = [f"panda_joint{k}" for k in range(1, 8)]
HOME = np.array([0.0, -0.4, 0.0, -1.8, 0.0, 1.6, 0.6])  # [rad]
HALF = np.array([0.9, 0.6, 0.9, 0.7, 0.9, 0.7, 0.9])  # half of the range of motion [rad]
DAMPING = np.array([1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5])  # [N m s/rad]
FRICTION = np.array([0.8, 0.8, 0.8, 0.8, 0.4, 0.4, 0.4])  # [N m]
ARMATURE = np.array([0.2, 0.2, 0.2, 0.2, 0.1, 0.1, 0.1])  # [kg m²]
STIFFNESS = np.array([600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0])  # [N m/rad]
VISCOUS = np.array([50.0, 50.0, 50.0, 20.0, 20.0, 20.0, 10.0])  # [N m s/rad]
HARMONICS, PERIOD, CYCLES = 4, 10.0, 2


def panda() -> mujoco.MjModel:
    """Return the arm with its fingers fixed."""
    path = next(p for p in urdfs() if p.name == "panda.urdf")
    text = re.sub(r"<(visual|collision)\b.*?</\1>", "", path.read_text(), flags=re.S)
    text = re.sub(r'(<joint name="panda_finger_joint\d" type=)"prismatic"', r'\1"fixed"', text)
    model = mujoco.MjModel.from_xml_string(re.sub(r"<mimic.*?/>", "", text))
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_damping[:], model.dof_frictionloss[:] = DAMPING, FRICTION
    model.dof_armature[:] = ARMATURE
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def motion(seed: int, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return q, v (n, 7) of a random sum of sines within the range."""
    random = np.random.default_rng(seed)
    a = random.uniform(-1, 1, (HARMONICS, 7))
    phase = random.uniform(0, 2 * np.pi, (HARMONICS, 7))
    w = 2 * np.pi / PERIOD * np.arange(1, HARMONICS + 1)[:, None]
    size = HALF / np.abs(a).sum(axis=0)
    z = w * t[:, None, None] + phase
    return HOME + size * (a * np.sin(z)).sum(axis=1), size * (a * w * np.cos(z)).sum(axis=1)


def simulated(seed: int, hold: float) -> ident.Log:
    """Return the log of one motion, after a period to settle."""
    model, every = panda(), round(hold / STEP)
    data = mujoco.MjData(model)
    t = np.arange(round((CYCLES + 0.5) * PERIOD / STEP)) * STEP
    q_ref, v_ref = motion(seed, t)
    data.qpos[:], data.qvel[:] = q_ref[0], v_ref[0]
    rows = []
    for k in range(len(t)):
        if k % every == 0:
            tau = STIFFNESS * (q_ref[k] - data.qpos) + VISCOUS * (v_ref[k] - data.qvel)
            mujoco.mj_forward(model, data)
            tau += data.qfrc_bias  # as the robot's own interface adds gravity
            data.qfrc_applied[:] = tau
            if t[k] >= 0.5 * PERIOD:
                rows.append([t[k], *data.qpos, *data.qvel, *tau])
        mujoco.mj_step(model, data)
    values = np.array(rows)
    values[:, 0] -= values[0, 0]
    random = np.random.default_rng([seed, 1])
    values[:, 15:] += 0.005 * values[:, 15:].std(axis=0) * random.standard_normal((len(rows), 7))
    names = [f"{c}.{j}" for c in ("q", "v", "tau") for j in ARM]
    return ident.Log.from_arrays(
        f"panda_{seed}", values[:, 0], dict(zip(names, values[:, 1:].T, strict=True))
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--hold", type=float, default=0.002)
    given = parser.parse_args()
    path = next(p for p in urdfs() if p.name == "panda.urdf")
    mechanism = ident.load(path, locked={"panda_finger_joint1": None})
    for kind in ("viscous", "coulomb", "rotor_inertia"):
        mechanism = mechanism.with_effect(kind)
    right = 0
    for seed in range(given.first, given.first + given.seeds):
        fit = ident.identify(mechanism, ident.complete(mechanism, simulated(seed, given.hold)))
        diagnosis = ident.diagnose(fit)
        named = [] if diagnosis.best is None else [diagnosis.best, *diagnosis.rivals]
        good = diagnosis.verdict == "nothing" or (bool(named) and named[0].kind == "delay")
        right += good
        words = " or ".join(each.label for each in named)
        further = ", ".join(each.label for each in diagnosis.together)
        print(
            f"{seed:3d} {'ok' if good else '--'} {diagnosis.verdict:11s} {words}"
            + (f"; beside it: {further}" if further else ""),
            flush=True,
        )
    print(f"{right} of {given.seeds}")


if __name__ == "__main__":
    main()
