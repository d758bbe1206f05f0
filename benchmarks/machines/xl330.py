"""Dynamixel XL330 on a pendulum, voltages: Rhoban/bam (Duclusaud, Passault et al., 2025)."""

import json
from pathlib import Path

import numpy as np

from machines import Checkout, Machine, chain, write_log

SOURCE, COMMIT = "Rhoban/bam", "af22604"
PUBLISHED = "friction that depends on the load"
JOINT = "servo"
GAIN = 4096 / (2 * np.pi) / (256 * 885)  # duty/rad of 1 of kp: bam/xl330/actuator.py
KT, R = 0.38617, 3.40257  # N m/A, Ω: params/xl330/m4.json of commit ca760c6
LOGS = (  # bam/data.bak/processed/2026-01-15_….json; lift_and_drop, without torque, is left out
    "10h28m10", "10h28m24", "10h28m32", "10h28m42", "10h28m57", "10h29m04",
    "10h29m14", "10h29m29", "10h29m37", "10h29m47", "10h30m02", "10h30m10",
)  # fmt: skip
VALIDATE = ("10h29m14", "10h29m29", "10h29m37")  # of kp = 400


def convert(source: Path, folder: Path) -> Machine:
    """Torques are those of the voltage that the servo's controller gives; kp = 400 is judged on."""
    checkout, logs = Checkout(source, COMMIT), {}
    for name in LOGS:
        x = json.loads(checkout.read(f"bam/data.bak/processed/2026-01-15_{name}.json"))
        keys = ("timestamp", "position", "goal_position", "speed")
        t, q, goal, v = (np.array([row[key] for row in x["entries"]], float) for key in keys)
        volts = x["vin"] * np.clip(GAIN * x["kp"] * (goal - q), -1, 1)
        channels = {f"q_{JOINT}": q, f"tau_{JOINT}": KT * (volts - KT * v) / R}
        path = folder / f"{x['trajectory']}_{x['kp']}.csv"
        logs[name] = write_log(path, t=t, **channels)
    urdf = chain(folder / "xl330.urdf", (JOINT,), np.array([(0, 0, 0, 0, np.pi / 2, 0)]))
    train = tuple(path for name, path in logs.items() if name not in VALIDATE)
    return Machine(urdf, train, tuple(logs[name] for name in VALIDATE))
