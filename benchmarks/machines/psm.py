"""Patient-side arm of a da Vinci Research Kit, without the wrist: see `mtm`."""

import io
from pathlib import Path

import numpy as np

from machines import Checkout, Machine, chain, write_log

SOURCE, COMMIT = "WPI-AIM/dvrk_dynamics_identification", "7697d3a"
PUBLISHED = "9.3 17.8 19.1 13.4 % below 5.4 Hz"
BAND = 5.4  # Hz, of the published errors
RATE = 200.0  # Hz
LOGS = ("one", "two")  # to identify from, to judge on
BACK, FRONT, RISE, TOP, BOTTOM = 0.04009, 0.14454, 0.03808, 0.096, 0.516  # m, main_psm.ipynb
CENTRE, TOOL = 0.4318, 0.4162  # m, ibid.
ORIGINS = {  # x, y, z, roll of each joint: its modified Denavit-Hartenberg rows
    "yaw": (0, 0, 0, np.pi / 2), "pitch": (0, 0, 0, -np.pi / 2),
    "front": (BACK, FRONT, 0, 0), "rear": (BACK, FRONT + RISE, 0, 0),
    "bottom": (BOTTOM, 0, 0, 0), "top": (TOP, 0, 0, 0),
    "insertion": (BACK, FRONT - CENTRE, 0, -np.pi / 2), "roll": (0, 0, TOOL, 0),
    "counterweight": (BACK, 0, 0, -np.pi / 2),
}  # fmt: skip
PARENTS = {"rear": "pitch", "bottom": "front", "top": "front", "insertion": "bottom",
           "counterweight": "pitch"}  # fmt: skip
DRIVEN = {"yaw": np.pi / 2, "pitch": -np.pi / 2, "insertion": 0.0, "roll": 0.0}  # offsets
FOLLOW = {  # ratio of the joint that is followed, offset
    "front": ("pitch", -1, np.pi / 2), "rear": ("pitch", -1, np.pi / 2),
    "bottom": ("pitch", 1, np.pi / 2), "top": ("pitch", 1, 3 * np.pi / 2),
    "counterweight": ("insertion", 1, 0.0),
}  # fmt: skip


def convert(source: Path, folder: Path) -> Machine:
    """The first four of seven joints; the parallelograms' links turn as the pitch says."""
    checkout, logs = Checkout(source, COMMIT), []
    for name in LOGS:
        file = checkout.read(f"data/psm/measured_trajectory/{name}_results.csv")
        q, v, tau = np.hsplit(np.loadtxt(io.BytesIO(file), delimiter=","), 3)
        channels = {
            f"{channel}_{joint}": x[:, i] + (offset if channel == "q" else 0.0)
            for channel, x in (("q", q), ("v", v), ("tau", tau))
            for i, (joint, offset) in enumerate(DRIVEN.items())
        }
        logs.append(write_log(folder / f"{name}.csv", t=np.arange(len(q)) / RATE, **channels))
    origins = np.array([(*origin, 0, 0) for origin in ORIGINS.values()])
    chain(folder / "psm.urdf", list(ORIGINS), origins, parents=PARENTS,
          sliding=("insertion", "counterweight"))  # fmt: skip
    passive = ", ".join(f'"{name}"' for name in FOLLOW)
    closures = "\n".join(
        f'[[closure]]\nname = "{name}"\nkind = "linear"\njoints = ["{name}", "{other}"]\n'
        f"ratios = [1.0, {-ratio}.0]\noffset = {offset}"
        for name, (other, ratio, offset) in FOLLOW.items()
    )
    (folder / "mechanism.toml").write_text(
        f'urdf = "psm.urdf"\n[joints]\npassive = [{passive}]\n{closures}\n'
    )
    return Machine(folder, (logs[0],), (logs[1],))
