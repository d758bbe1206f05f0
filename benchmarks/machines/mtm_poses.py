"""Master arm of a da Vinci Research Kit at rest in 101 poses: WPI-AIM/dvrk_gravity_comp."""

import io
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from machines import Checkout, Machine, write_log
from machines.mtm import OFFSETS, write_mechanism

SOURCE, COMMIT = "WPI-AIM/dvrk_gravity_comp", "003389f"
PUBLISHED = "–"
TABLE = "Final_Submission/MATLAB code/GettingTorques/TorqueData/combined_good_torque_data.mat"
JOINTS = ("j1", "upper", "elbow", "j4", "j5", "j6", "j7")
VALIDATE = 4  # every so-manieth pose is to judge on


def convert(source: Path, folder: Path) -> Machine:
    """Averages of ten readings a pose; crank and rod of the parallelogram are not logged."""
    file = io.BytesIO(Checkout(source, COMMIT).read(TABLE))
    q, tau = loadmat(file)["Combined_good_torque"].transpose(1, 2, 0)[:, :, :7]
    q = q + [OFFSETS.get(name, 0.0) for name in JOINTS]
    judged = np.arange(len(q)) % VALIDATE == VALIDATE - 1
    logs = []
    for name, rows in (("train", ~judged), ("validate", judged)):
        channels = {
            f"{channel}_{joint}": x[rows, i]
            for channel, x in (("q", q), ("tau", tau))
            for i, joint in enumerate(JOINTS)
        }
        logs.append(write_log(folder / f"{name}.csv", **channels))
    start = {"upper": np.pi / 2, "elbow": np.pi / 2, "crank": np.pi, "rod": -np.pi / 2}
    write_mechanism(folder, ("crank", "rod"), start)
    return Machine(folder, (logs[0],), (logs[1],))
