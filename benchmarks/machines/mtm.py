"""Master arm of a da Vinci Research Kit, a parallelogram: WPI-AIM/dvrk_dynamics_identification.

Wang, Gondokaryono, Munawar, Fischer, IEEE RA-L 4(4), 2019.
"""

import io
from pathlib import Path

import numpy as np

from machines import Checkout, Machine, chain, modified_dh, write_log

SOURCE, COMMIT = "WPI-AIM/dvrk_dynamics_identification", "7697d3a"
PUBLISHED = "7.7 14.9 17.0 22.3 28.0 23.4 34.0 % below 1.8 Hz"
BAND = 1.8  # Hz, of the published errors
RATE = 200.0  # Hz
LOGS = ("one", "two")  # to identify from, to judge on
RATIO = 0.6697  # motor 4 turns with the forearm
CRANK, ARM, FOREARM = 0.1, 0.2794, 0.3645  # m, as all that follows from main_mtm.ipynb
PARTS = {  # modified Denavit-Hartenberg a, α, d
    "j1": (0, 0, -0.2154), "upper": (0, -np.pi / 2, 0), "elbow": (ARM, 0, 0),
    "crank": (0, -np.pi / 2, 0), "rod": (CRANK, 0, 0), "j4": (FOREARM, -np.pi / 2, 0.151),
    "j5": (0, np.pi / 2, 0), "j6": (0, -np.pi / 2, 0), "j7": (0, -np.pi / 2, 0),
}  # fmt: skip
PARENTS = {"crank": "j1", "j4": "elbow"}
OFFSETS = {"upper": np.pi / 2, "elbow": np.pi / 2, "crank": np.pi, "j6": np.pi / 2, "j7": np.pi}
CLOSURE = f"""
[[closure]]
name = "parallelogram"
kind = "point"
a = {{ link = "link_rod", xyz = [{ARM}, 0, 0] }}
b = {{ link = "link_elbow", xyz = [{CRANK}, 0, 0] }}
"""
MOTORS = f"""
[motors]
j1 = "j1"
upper = "upper"
crank = "crank"
m4 = "j4 + {RATIO}*elbow"
j5 = "j5"
j6 = "j6"
j7 = "j7"
"""


def convert(source: Path, folder: Path) -> Machine:
    """Positions and torques are those of the motors; elbow, rod and joint 4 are not logged."""
    checkout, logs = Checkout(source, COMMIT), []
    motors = ("j1", "upper", "crank", "m4", "j5", "j6", "j7")
    shift = [OFFSETS.get(name, 0.0) for name in motors]
    shift[3] = RATIO * OFFSETS["elbow"]
    for name in LOGS:
        file = checkout.read(f"data/mtm/measured_trajectory/{name}_results.csv")
        q, v, tau = np.hsplit(np.loadtxt(io.BytesIO(file), delimiter=","), 3)
        channels = {
            f"{channel}_{motor}": x[:, i]
            for channel, x in (("q", q + shift), ("v", v), ("tau", tau))
            for i, motor in enumerate(motors)
        }
        logs.append(write_log(folder / f"{name}.csv", t=np.arange(len(q)) / RATE, **channels))
    start = {"upper": np.pi / 2, "elbow": np.pi / 2, "crank": np.pi, "rod": -np.pi / 2}
    write_mechanism(folder, ("elbow", "rod", "j4"), start, MOTORS)
    return Machine(folder, (logs[0],), (logs[1],))


def write_mechanism(
    folder: Path, passive: tuple[str, ...], start: dict[str, float], motors: str = ""
) -> None:
    """Writes URDF and mechanism.toml of the arm with its parallelogram."""
    chain(folder / "mtm.urdf", list(PARTS), modified_dh(np.array(list(PARTS.values()))),
          parents=PARENTS)  # fmt: skip
    angles = ", ".join(f"{name} = {value}" for name, value in start.items())
    names = ", ".join(f'"{name}"' for name in passive)
    (folder / "mechanism.toml").write_text(
        f'urdf = "mtm.urdf"\n[joints]\npassive = [{names}]\nstart = {{ {angles} }}\n'
        f"{CLOSURE}{motors}"
    )
