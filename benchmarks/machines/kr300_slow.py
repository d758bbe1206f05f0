"""KUKA KR300 R2500, runs of a minute at 10 Hz, 60 for training and 6 for test: a benchmark.

Weigand, Götz, Ulmen, Ruskowski, Dataset and Baseline for an Industrial Robot Identification
Benchmark, 2023; here from yifang0-0/Physics-Guided-Recurrent-State-Space-Neural-Networks, where the
positions are one sample ahead of the torques. Kinematics as in the shared data of the same robot.
"""

import io
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from machines import SHARED, Checkout, Machine, write_log

SOURCE = "yifang0-0/Physics-Guided-Recurrent-State-Space-Neural-Networks"
COMMIT = "a4b87d9"
PUBLISHED = "NRMSE 0.125 of simulated positions"
FILE = "data/IndustRobo/forward_identification_without_raw_data_shifted.mat"
RUN = 605  # samples
RATIOS = np.array([256.857, 267.429, 252.333, 221, 239.619, 154.323])  # README of the shared data


def convert(source: Path, folder: Path) -> Machine:
    """Training set and test set, each one log whose runs are 40 s apart."""
    table = loadmat(io.BytesIO(Checkout(source, COMMIT).read(FILE)))
    logs = []
    for name in ("train", "test"):
        u, y = (table[f"{x}_{name}"].T.reshape(-1, RUN, 6) for x in "uy")
        t = 0.1 * np.arange(RUN - 1) + 100 * np.arange(len(u))[:, None]
        q, tau = np.radians(y[:, :-1]).reshape(-1, 6), (RATIOS * u[:, 1:]).reshape(-1, 6)
        channels = {f"q_a{i + 1}": q[:, i] for i in range(6)}
        channels |= {f"tau_a{i + 1}": tau[:, i] for i in range(6)}
        logs.append(write_log(folder / f"{name}.csv", t=t.ravel(), **channels))
    return Machine(SHARED / "kuka_kr300" / "kr300.urdf", (logs[0],), (logs[1],))
