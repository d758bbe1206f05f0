"""PAL TIAGo, motor currents of the arm: thanhndv212/figaroh-examples."""

import io
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from machines import Checkout, Machine, write_log

SOURCE, COMMIT = "thanhndv212/figaroh-examples", "c0b5c7f"
PUBLISHED = "–"
DATA = "examples/tiago/data/identification/dynamic/tiago_{}.csv"
URDF = "examples/tiago/urdf/tiago_48_schunk.urdf"
MOVING, TRAIN = (921, 6791), 0.7  # rows that the authors use; share of them
# N m/A, ratio of the gear times constant of the motor: examples/tiago/identification.py
GAINS = (13.6, 13.6, -8.7, -8.7, -20.597, -20.597, -20.597)


def convert(source: Path, folder: Path) -> Machine:
    """Currents of arm 1 to 7, scaled in [log]; the lift has an effort without a unit."""
    checkout, logs, tables = Checkout(source, COMMIT), [], {}
    for kind in ("position", "velocity", "effort"):
        file = io.BytesIO(checkout.read(DATA.format(kind)))
        tables[kind] = np.loadtxt(file, delimiter=",", skiprows=1)[slice(*MOVING)]
    arms = [f"arm_{i + 1}_joint" for i in range(7)]
    names = ["torso_lift_joint", *arms]
    first = int(TRAIN * len(tables["position"]))
    for name, rows in (("train", slice(0, first)), ("validate", slice(first, None))):
        channels = {"t": tables["position"][rows, 0]}
        for channel, kind in (("q", "position"), ("v", "velocity")):
            channels |= {f"{channel}_{n}": tables[kind][rows, 1 + i] for i, n in enumerate(names)}
        channels |= {f"current_{n}": tables["effort"][rows, 2 + i] for i, n in enumerate(arms)}
        logs.append(write_log(folder / f"{name}.csv", **channels))
    urdf = checkout.read(URDF)
    (folder / "tiago.urdf").write_bytes(urdf)
    joints = [j for j in ET.fromstring(urdf).findall("joint") if j.get("type") != "fixed"]
    others = [
        j.get("name") for j in joints if j.get("name") not in names and j.find("mimic") is None
    ]
    held = ", ".join(f'"{name}" = 0.0' for name in others)
    scales = "\n".join(
        f'"tau.{name}" = {{ column = "current.{name}", scale = {gain} }}'
        for name, gain in zip(arms, GAINS, strict=True)
    )
    (folder / "mechanism.toml").write_text(
        f'urdf = "tiago.urdf"\n[joints]\nunmeasured = ["torso_lift_joint"]\n'
        f"locked = {{ {held} }}\n[log]\n{scales}\n"
    )
    return Machine(folder, (logs[0],), (logs[1],))
