"""UR10, one exciting motion of 27 s, torques of its currents: unisa-acg/inverse-dynamics-solver.

Petrone, Ferrentino, Chiacchio, The Dynamic Model of the UR10 Robot and Its ROS2 Integration, IEEE
Transactions on Industrial Informatics, 2025.
"""

from pathlib import Path

import numpy as np

import ident
from machines import Checkout, Machine, chain, modified_dh, write_log

SOURCE, COMMIT = "unisa-acg/inverse-dynamics-solver", "41e196d"
PUBLISHED = "–"
BAG = "ur10_inverse_dynamics_solver/bagfiles/ur10_exciting_trajectory.db3"
TRAIN = 18.5  # s
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
DH = np.array([  # Universal Robots, DH parameters for calculations of kinematics and dynamics
    (0, 0, 0.1273), (0, np.pi / 2, 0), (-0.612, 0, 0), (-0.5723, 0, 0.163941),
    (0, np.pi / 2, 0.1157), (0, -np.pi / 2, 0.0922),
])  # fmt: skip


def convert(source: Path, folder: Path) -> Machine:
    """The first 18.5 s of the run are for training."""
    bag = folder / "run.db3"
    bag.write_bytes(Checkout(source, COMMIT).read(BAG))
    log = ident.read_log(bag)
    joints = [f"{joint}_joint" for joint in JOINTS]
    names = [f"{channel}.{joint}" for channel in ("q", "v", "tau") for joint in joints]
    train = log.t - log.t[0] < TRAIN
    logs = []
    for name, rows in (("train", train), ("validate", ~train)):
        channels = {each.replace(".", "_", 1): log.columns[each][rows] for each in names}
        logs.append(write_log(folder / f"{name}.csv", t=log.t[rows], **channels))
    return Machine(chain(folder / "ur10.urdf", joints, modified_dh(DH)), (logs[0],), (logs[1],))
