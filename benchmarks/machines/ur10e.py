"""UR10e, currents: shamilmamedov/dynamic_calibration (Mamedov, Mikhel, 2020)."""

import io
from pathlib import Path

import numpy as np

from machines import Checkout, Machine, write_log

SOURCE, COMMIT = "shamilmamedov/dynamic_calibration", "11af40e"
PUBLISHED = "–"
DATA = "dataset_ur10e/"
GAINS = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])  # N m/A, main.m of the source
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
LOGS = (  # file, first and last row that the source uses
    ("identification_data/ur-20_02_10-30sec_12harm.csv", 635, 3510),
    ("validation_data/ur-20_01_17-ptp_10_points.csv", 700, 4200),
)


def convert(source: Path, folder: Path) -> Machine:
    """The source's own logs for identification and validation."""
    checkout = Checkout(source, COMMIT)
    names = [f"{joint}_joint" for joint in JOINTS]
    logs = []
    for path, first, last in LOGS:
        rows = np.loadtxt(io.BytesIO(checkout.read(DATA + path)), delimiter=",")[first:last]
        t, q, v, current = rows[:, 0] - rows[0, 0], rows[:, 1:7], rows[:, 7:13], rows[:, 13:19]
        channels = {
            f"{channel}_{joint}": x[:, i]
            for channel, x in (("q", q), ("v", v), ("tau", current * GAINS))
            for i, joint in enumerate(names)
        }
        logs.append(write_log(folder / Path(path).name, t=t, **channels))
    urdf = folder / "ur10e.urdf"
    urdf.write_bytes(checkout.read("URe/urdf/ur10e.urdf"))
    return Machine(urdf, (logs[0],), (logs[1],))
