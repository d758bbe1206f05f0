"""KUKA LWR4+, three logs of trapezes: kjyv/FloBaRoID (Bethge, Malzahn et al., 2017)."""

import io
from pathlib import Path

import numpy as np

from machines import Checkout, Machine, write_log

SOURCE, COMMIT = "kjyv/FloBaRoID", "e6c077e"
PUBLISHED = "2.81 % of the whole vector, 0.72 N m"
JOINTS = [f"lwr_{i}_joint" for i in range(7)]


def convert(source: Path, folder: Path) -> Machine:
    """Identified from logs two and three, judged on the first."""
    checkout = Checkout(source, COMMIT)
    logs = []
    for number in (1, 2, 3):
        data = np.load(io.BytesIO(checkout.read(f"data/KUKA/HW/measurements_{number}.npz")))
        t = data["times"] - data["times"][0]
        channels = {
            f"{channel}_{joint}": data[key][:, i]
            for channel, key in (("q", "positions"), ("tau", "torques"))
            for i, joint in enumerate(JOINTS)
        }
        logs.append(write_log(folder / f"log{number}.csv", t=t, **channels))
    urdf = folder / "lwr4.urdf"
    urdf.write_bytes(checkout.read("model/kuka_lwr4.urdf"))
    return Machine(urdf, (logs[1], logs[2]), (logs[0],), ("torque_offset",))
