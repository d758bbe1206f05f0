"""What is hidden in one joint of a servo arm, by MuJoCo, and the model that does not know it."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from servo_logs import MIDDLE, Servos, model_of, servo_log

import ident
from helpers import ROBOTS

JOINTS = ("yaw", "shoulder", "elbow")
CASES = ("compliance", "play", "late command", "load friction", "wrong kp", "nothing")
SPREAD = 0.3  # of planted values
TOP = 8.0  # [Hz] of the commands


@dataclass(frozen=True)
class Hidden:
    """A log with something hidden, the model for it, and what names it."""

    log: dict  # columns
    mechanism: ident.Mechanism
    label: str  # of the effect; "" of nothing
    values: dict  # planted, by full name


def hidden(case, seed, seconds=20.0, joint=None, **options):
    """One of CASES in a joint; all values are drawn by the seed."""
    random = np.random.default_rng((CASES.index(case), seed))
    usual = Servos()
    truth = replace(
        usual,
        **{
            name: tuple(np.array(getattr(usual, name)) * random.uniform(1 - SPREAD, 1 + SPREAD, 3))
            for name in ("kp", "kd", "Fc", "Fv", "Ia")
        },
        delay=random.uniform(0.004, 0.012),
    )
    bits, at = int(random.choice([12, 14])), int(random.integers(3))
    at = at if joint is None else JOINTS.index(joint)
    joint = JOINTS[at]
    drives, values, label = {name: {} for name in JOINTS}, {}, ""
    if case == "compliance":
        frequency, ratio = 2 * np.pi * random.uniform(4.0, TOP), random.uniform(0.02, 0.1)
        M = inertias()[at]
        K, D = M * frequency**2, 2 * ratio * M * frequency
        truth, label = replace(truth, springs={joint: (K, D)}), f"elasticity:{joint}"
        values = {f"elasticity.{joint}.compliance": 1 / K, f"elasticity.{joint}.damping": D}
    elif case == "play":
        width = random.uniform(10, 30) * 2 * np.pi / 2**bits
        truth, label = replace(truth, plays={joint: width}), f"backlash:{joint}"
        values = {f"backlash.{joint}.width": width}
    elif case == "late command":
        drives = {name: {"delay": truth.delay} for name in JOINTS}
        later = random.uniform(0.005, 0.015)
        truth, label = replace(truth, later={joint: later}), f"command_delay:{joint}"
        values = {f"command_delay.{joint}.d": later}
    elif case == "load friction":
        mu = random.uniform(0.08, 0.2)
        truth, label = replace(truth, loaded={joint: mu}), f"load_friction:{joint}"
        values = {f"load_friction.{joint}.mu": mu}
    elif case == "wrong kp":
        wrong = 1 + random.choice([-1, 1]) * random.uniform(0.1, 0.3)
        drives = {
            name: {"kp": kp * (wrong if name == joint else 1)}
            for name, kp in zip(JOINTS, truth.kp, strict=True)
        }
        label, values = f"servo:{joint}", {f"servo.{joint}.kp": truth.kp[at]}
    begin = int(random.integers(2**31))
    log = servo_log(truth, begin, seconds, bits=bits, top=TOP, **options)
    return Hidden(log, with_drives(drives), label, values)


def with_drives(values):
    """The arm with what is given of its drives."""
    mechanism = ident.load(ROBOTS / "servo_arm").with_calibration("exact")
    bare = [e for e in mechanism.effects if not e.supplies_torque and e.kind != "command_delay"]
    given = [
        f"{joint}:" + ",".join(f"{name}={value}" for name, value in its.items())
        for joint, its in values.items()
    ]
    return replace(mechanism, effects=tuple(bare)).with_drives(*given)


def inertias():
    """Inertia (3,) [kg m²] that each joint moves, in the middle of the motion, without rotors."""
    model = model_of(Servos(Ia=(0.0, 0.0, 0.0)))
    data, full = mujoco.MjData(model), np.zeros((3, 3))
    data.qpos[:] = MIDDLE
    mujoco.mj_forward(model, data)
    for unit, row in zip(np.eye(3), full, strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    return np.diag(full)
