"""`ident` against MuJoCo's own system identification on the same logs of servos: errors and time.

    python benchmarks/servo_mujoco.py [LOGS]

Needs MuJoCo's extra: pip install 'mujoco[sysid]'. LOGS (default 3) logs of three servos, and one
of twelve (four of these arms on one base), 20 s at 200 Hz, 14 bit encoders, no delay, made by
`tests/truth/servo_logs.py` with seeds from 3000 on, at steps of 0.05 ms: MuJoCo's torque is half a
step late, and at 0.2 ms this alone is 0.4 % of the damping and 0.07 mrad. Both are given the
bodies, and find armature, frictionloss, damping with kd, and kp of each joint. `mujoco.sysid`
starts 30 % off, with its default optimiser, `x_scale="jac"`, one thread and steps of 1 ms; `ident`
has no start. Held out: other commands, 10 s, played by MuJoCo at 0.05 ms with the values of each,
from the start to the end, against the exact motion. Processor time is that of one process with all
its threads.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import polars as pl

import ident

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "truth")]
from servo_logs import URDF, Servos, servo_log  # noqa: E402

JOINTS = ("yaw", "shoulder", "elbow")
STEP = 5e-5  # [s] of the machine
COARSE = 1e-3  # [s] of MuJoCo's rollouts
RATE, HELD_OUT = 200.0, 10.0  # [Hz], [s]
SPREAD, OFF = 0.3, 1.3  # of planted values; of the start over the truth
QUANTITIES = ("Ia", "Fc", "Fv", "kp")  # Fv with kd
EFFECTS = ("coulomb", "rotor_inertia")


@dataclass(frozen=True)
class Trial:
    """Logs of some arms on one base: planted values (arms · 3, 4) and columns by joint."""

    planted: np.ndarray
    log: dict[str, np.ndarray]
    other: dict[str, np.ndarray]  # commands and exact positions, held out
    joints: tuple[str, ...]

    @property
    def arms(self) -> int:
        """How many arms there are."""
        return len(self.joints) // 3


def trial(seed: int, arms: int) -> Trial:
    """Return logs of arms that share nothing but their clock."""
    planted, log, other, joints = [], {}, {}, []
    for arm in range(arms):
        rng, usual = np.random.default_rng([seed, arm]), Servos()
        names = ("kp", "kd", "Fc", "Fv", "Ia")
        draw = {
            name: tuple(np.array(getattr(usual, name)) * rng.uniform(1 - SPREAD, 1 + SPREAD, 3))
            for name in names
        }
        truth = Servos(**draw, delay=0.0)
        run = servo_log(truth, seed + 100 * arm, bits=14, step=STEP)
        exact = servo_log(truth, seed + 100 * arm + 50, seconds=HELD_OUT, bits=40, step=STEP)
        for columns, made in ((log, run), (other, exact)):
            columns["t"] = made["t"]
            for joint in JOINTS:
                for kind in ("q", "ref"):
                    columns[f"{kind}.arm{arm}_{joint}"] = made[f"{kind}.{joint}"]
        both = np.array(truth.Fv) + np.array(truth.kd)
        planted.append(np.stack([truth.Ia, truth.Fc, both, truth.kp], axis=1))
        joints += [f"arm{arm}_{joint}" for joint in JOINTS]
    return Trial(np.concatenate(planted), log, other, tuple(joints))


def machine(arms: int) -> mujoco.MjSpec:
    """Return arms on one base, without actuators."""
    spec = mujoco.MjSpec()
    for arm in range(arms):
        frame = spec.worldbody.add_frame()
        one = mujoco.MjSpec.from_file(str(URDF))
        spec.attach(one, frame=frame, prefix=f"arm{arm}_")
    spec.compile()
    return mujoco.MjSpec.from_string(spec.to_xml())


def with_values(spec: mujoco.MjSpec, x: np.ndarray, joints: tuple[str, ...], step: float) -> None:
    """Set values x (joints, 4) and the step, with friction that is as stiff as the step allows."""
    spec.option.timestep, spec.option.integrator = step, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    for name, values in zip(joints, x, strict=True):
        set_joint(spec, name, values)
        joint = spec.joint(name)
        joint.limited, joint.solref_friction = False, [2 * step, 1.0]


def set_joint(spec: mujoco.MjSpec, name: str, values: np.ndarray) -> None:
    """Set armature, frictionloss, damping and the stiffness of a joint's position servo."""
    joint, servo = spec.joint(name), spec.actuator(name)
    joint.armature, joint.frictionloss, damping, kp = (float(value) for value in values)
    joint.damping = [damping, 0.0, 0.0]
    servo.gainprm[0], servo.biasprm[1] = kp, -kp


def served(arms: int, joints: tuple[str, ...]) -> mujoco.MjSpec:
    """Return the machine with a position servo a joint."""
    spec = machine(arms)
    for name in joints:
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        spec.add_sensor(
            name=f"{name}_pos", type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name,
        )  # fmt: skip
    return spec


def replayed(trial: Trial, x: np.ndarray) -> np.ndarray:
    """Return the rms error [mrad] of held-out commands by joint with values x (joints, 4)."""
    spec = served(trial.arms, trial.joints)
    with_values(spec, x, trial.joints, STEP)
    model = spec.compile()
    q, ref = (
        np.stack([trial.other[f"{kind}.{name}"] for name in trial.joints], axis=1)
        for kind in ("q", "ref")
    )
    data, hold, errors = mujoco.MjData(model), round(1 / RATE / STEP), np.zeros(q.shape)
    data.qpos[:] = q[0]
    for i in range(len(q)):
        errors[i] = data.qpos - q[i]
        data.ctrl[:] = ref[i]
        for _ in range(hold):
            mujoco.mj_step(model, data)
    return 1e3 * np.sqrt((errors**2).mean(axis=0))


def by_ident(trial: Trial, folder: Path) -> tuple[np.ndarray, float]:
    """Return values (joints, 4) and processor time [s]."""
    path = folder / f"arms_{trial.arms}.xml"
    path.write_text(machine(trial.arms).to_xml())
    mechanism = ident.load(path).with_calibration("exact")
    known = replace(mechanism, unknown=mechanism.bodies.select([], "benchmark"))
    mechanism = known.with_drives("servo", "delay=0")
    for effect in EFFECTS:
        mechanism = mechanism.with_effect(effect)
    log = pl.DataFrame(trial.log)
    begin = time.process_time()
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    seconds = time.process_time() - begin
    names = ("rotor_inertia.{}.Ia", "coulomb.{}.Fc", "servo.{}.kd", "servo.{}.kp")
    values = fit.point.values
    return np.array([[values[n.format(j)] for n in names] for j in trial.joints]), seconds


def by_mujoco(trial: Trial) -> tuple[np.ndarray, float]:
    """Return values (joints, 4) and processor time [s]."""
    from mujoco import sysid

    spec, x = served(trial.arms, trial.joints), OFF * trial.planted
    with_values(spec, x, trial.joints, COARSE)
    model = spec.compile()
    params = sysid.ParameterDict()
    for name, values in zip(trial.joints, x, strict=True):

        def modifier(s: mujoco.MjSpec, p: sysid.Parameter, name: str = name) -> None:
            set_joint(s, name, p.value)

        params.add(
            sysid.Parameter(name, nominal=values, min_value=0.1 * values, max_value=5 * values,
                            modifier=modifier)
        )  # fmt: skip
    q, ref = (
        np.stack([trial.log[f"{kind}.{name}"] for name in trial.joints], axis=1)
        for kind in ("q", "ref")
    )
    t = trial.log["t"]
    # commands as they are held: one a step of the rollout
    steps = np.arange(round(len(t) / RATE / COARSE)) * COARSE
    held = ref[np.minimum((steps * RATE + 1e-9).astype(int), len(ref) - 1)]
    start = sysid.create_initial_state(model, q[0], np.zeros(len(q[0])))
    sequences = sysid.ModelSequences(
        "arms", spec, "log", start, sysid.TimeSeries(steps, held),
        sysid.TimeSeries.from_names(t[1:], q[1:], model),
    )  # fmt: skip
    residual = sysid.build_residual_fn(models_sequences=[sequences], n_threads=1)
    begin = time.process_time()
    best, _ = sysid.optimize(
        initial_params=params, residual_fn=residual, verbose=False, x_scale="jac"
    )
    return best.as_vector().reshape(x.shape), time.process_time() - begin


def main() -> None:
    """Run all trials and print a line for each."""
    import tempfile

    count = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    for arms, seeds in ((1, range(3000, 3000 + count)), (4, range(3000, 3001))):
        for seed in seeds:
            of = trial(seed, arms)
            exact = replayed(of, of.planted)
            with tempfile.TemporaryDirectory() as folder:
                ways = {"ident": by_ident(of, Path(folder)), "mujoco.sysid": by_mujoco(of)}
            for way, (x, seconds) in ways.items():
                off = 100 * np.median(np.abs(x / of.planted - 1), axis=0)
                errors = replayed(of, x)
                words = ", ".join(f"{n} {v:.2g} %" for n, v in zip(QUANTITIES, off, strict=True))
                print(
                    f"{3 * arms:2d} joints, seed {seed}, {way:13s} {seconds:6.2f} s; {words}; held "
                    f"out {' '.join(f'{e:.3f}' for e in errors[:6])} mrad (exact values: "
                    f"{exact.max():.3f})"
                )
            ratio = ways["mujoco.sysid"][1] / ways["ident"][1]
            print(f"{'':24s} {ratio:.0f} times less processor time")


if __name__ == "__main__":
    main()
