"""Franka Panda, one run of 21 s: marcocognetti/FrankaEmikaPandaDynModel (Gaz et al., 2019)."""

import io
from pathlib import Path

import numpy as np

from machines import Checkout, Machine, chain, modified_dh, write_log

SOURCE, COMMIT = "marcocognetti/FrankaEmikaPandaDynModel", "24d85ce"
PUBLISHED = "8.0 3.2 2.3 1.5 10.4 7.5 17.0 % below 3 Hz"
BAND = 3.0  # Hz, of the published errors
LOG = "matlab/data/Exciting_Traj/Trajectory_1/rbt_log/exciting_traj_{}.txt"
TRAIN = 0.7  # share of the run
DH = np.array([  # Gaz et al., Dynamic Identification of the Franka Emika Panda Robot, table I
    (0, 0, 0.333), (0, -np.pi / 2, 0), (0, np.pi / 2, 0.316), (0.0825, np.pi / 2, 0),
    (-0.0825, -np.pi / 2, 0.384), (0, np.pi / 2, 0), (0.088, np.pi / 2, 0),
])  # fmt: skip


def convert(source: Path, folder: Path) -> Machine:
    """The first 70 % of the run are for training."""
    checkout = Checkout(source, COMMIT)
    t, q, v, tau = (
        np.loadtxt(io.BytesIO(checkout.read(LOG.format(what))))
        for what in ("time", "positions", "velocity", "torques")
    )
    joints = [f"joint{i + 1}" for i in range(7)]
    q, v, tau = (x.reshape(-1, 7) for x in (q, v, tau))
    n, first = min(len(t), len(q)), int(TRAIN * min(len(t), len(q)))
    logs = []
    for name, rows in (("train", slice(0, first)), ("validate", slice(first, n))):
        channels = {
            f"{channel}_{joint}": x[rows, i]
            for channel, x in (("q", q), ("v", v), ("tau", tau))
            for i, joint in enumerate(joints)
        }
        logs.append(write_log(folder / f"{name}.csv", t=t[rows], **channels))
    return Machine(chain(folder / "panda.urdf", joints, modified_dh(DH)), (logs[0],), (logs[1],))
