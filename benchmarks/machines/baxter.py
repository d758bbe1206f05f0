"""Baxter's left arm at 100 Hz: EduardoRosLab/Baxter_Dynamic_Model; URDF of example-robot-data."""

import io
from pathlib import Path

import numpy as np

from machines import Checkout, Machine, chain, write_log

SOURCE, COMMIT = "EduardoRosLab/Baxter_Dynamic_Model", "4b89e93"
PUBLISHED = "springs of s1"
JOINTS = ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
STEP = 0.01  # s; the files have no stamps
LOGS = (
    "Training/sin_XYZ_10s_T2_5_Tz_4T_r18", "Training/sin_XYZ_12_5s_T2_5_Tz_5T_r15",
    "Test/sin_XYZ_12_5s_T2_5_Tz_5T_r18",
)  # fmt: skip
HALF = np.pi / 2
ORIGINS = np.array([  # baxter.urdf of the package: left_s0 … left_w2
    (0.055695, 0, 0.011038, 0, 0, 0), (0.069, 0, 0.27035, -HALF, 0, 0),
    (0.102, 0, 0, HALF, 0, HALF), (0.069, 0, 0.26242, -HALF, -HALF, 0),
    (0.10359, 0, 0, HALF, 0, HALF), (0.01, 0, 0.2707, -HALF, -HALF, 0),
    (0.115975, 0, 0, HALF, 0, HALF),
])  # fmt: skip
SECONDS = 60.0  # of each log


def convert(source: Path, folder: Path) -> Machine:
    """Two of the training logs, one of the test logs."""
    checkout, logs = Checkout(source, COMMIT), []
    for path in LOGS:
        raw = checkout.read(f"Dataset/{path}_ang_vel_torq.csv")
        rows = np.loadtxt(io.BytesIO(raw), skiprows=1)[: int(SECONDS / STEP)]
        channels = {
            f"{channel}_{joint}": rows[:, 7 * k + i]
            for k, channel in enumerate(("q", "v", "tau"))
            for i, joint in enumerate(JOINTS)
        }
        logs.append(write_log(folder / f"{Path(path).name}.csv", t=STEP * np.arange(len(rows)),
                              **channels))  # fmt: skip
    return Machine(chain(folder / "baxter.urdf", JOINTS, ORIGINS), tuple(logs[:2]), (logs[2],))
