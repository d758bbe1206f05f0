"""Rokae xMate3 Pro, joint torque sensors, one run of 20 s: a repository of YanjunLIU-ac."""

import io
from pathlib import Path

import numpy as np

from machines import Checkout, Machine, chain, modified_dh, write_log

SOURCE = "YanjunLIU-ac/Dynamic_Parameter_Identification_for_Rokae_xMate"
COMMIT = "d5855f4"
PUBLISHED = "–"
DATA = "filtering/data/excit/excit_{}_record.txt"
STEP, TRAIN = 1e-3, 13_000  # s; samples
DH = np.array([  # excitation/utils/robot_model.m of the source
    (0, 0, 0.3415), (0, -np.pi / 2, 0), (0, np.pi / 2, 0.394), (0, -np.pi / 2, 0),
    (0, np.pi / 2, 0.366), (0, -np.pi / 2, 0), (0, np.pi / 2, 0.2503),
])  # fmt: skip


def convert(source: Path, folder: Path) -> Machine:
    """The first 13 s of the one run are for training."""
    checkout = Checkout(source, COMMIT)
    q, v, tau = (
        np.loadtxt(io.BytesIO(checkout.read(DATA.format(what))))
        for what in ("ang", "vel", "torque")
    )
    joints = [f"joint{i + 1}" for i in range(7)]
    logs = []
    for name, rows in (("train", slice(0, TRAIN)), ("validate", slice(TRAIN, len(q)))):
        channels = {
            f"{channel}_{joint}": x[rows, i]
            for channel, x in (("q", q), ("v", v), ("tau", tau))
            for i, joint in enumerate(joints)
        }
        t = STEP * np.arange(len(q))[rows]
        logs.append(write_log(folder / f"{name}.csv", t=t, **channels))
    return Machine(chain(folder / "xmate.urdf", joints, modified_dh(DH)), (logs[0],), (logs[1],))
