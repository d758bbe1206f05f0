"""AIRBOT Play, a chirp of all joints and trapezes: liuyurong129/figaroh_kinova."""

import io
from pathlib import Path

import numpy as np

from machines import Checkout, Machine, write_log

SOURCE, COMMIT = "liuyurong129/figaroh_kinova", "9ac8ad7"
PUBLISHED = "–"
DATA = "examples/airbot_play/data/"
STEP = 0.01  # s
LOGS = ("chirp_motion", "trapezoidal_motion")  # to identify from, to judge on


def convert(source: Path, folder: Path) -> Machine:
    """Positions and torques of six joints, at a constant rate."""
    checkout = Checkout(source, COMMIT)
    logs = []
    for name in LOGS:
        channels = {}
        for kind in ("q", "tau"):
            file = checkout.read(f"{DATA}identification/{name}/identification_{kind}_real.csv")
            rows = np.loadtxt(io.BytesIO(file), delimiter=",", skiprows=1)
            channels["t"] = STEP * np.arange(len(rows))
            channels |= {f"{kind}_joint{i + 1}": rows[:, i] for i in range(6)}
        logs.append(write_log(folder / f"{name}.csv", **channels))
    urdf = folder / "airbot.urdf"
    urdf.write_bytes(checkout.read(f"{DATA}urdf/airbot_play_v3_0_gripper.urdf"))
    return Machine(urdf, (logs[0],), (logs[1],))
