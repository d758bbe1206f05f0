"""Patient-side arm of a da Vinci Research Kit, without the wrist: see `mtm`."""

import io
from dataclasses import dataclass
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
QUARTER = np.pi / 2


@dataclass(frozen=True)
class Arm:
    """A tree of joints, those with a drive, and those that follow.

    Attributes:
        origins: by joint x, y, z [m], roll [rad] of its modified Denavit-Hartenberg row.
        parents: by joint, where it is not the one before; None is the base.
        driven: offsets of the logged positions, in the order of the columns [rad | m].
        follow: by joint, ratios of the joints that it follows, and an offset [rad | m].
    """

    origins: dict[str, tuple[float, float, float, float]]
    parents: dict[str, str | None]
    driven: dict[str, float]
    follow: dict[str, tuple[dict[str, float], float]]


ARM = Arm(
    origins={
        "yaw": (0, 0, 0, QUARTER), "pitch": (0, 0, 0, -QUARTER),
        "front": (BACK, FRONT, 0, 0), "rear": (BACK, FRONT + RISE, 0, 0),
        "bottom": (BOTTOM, 0, 0, 0), "top": (TOP, 0, 0, 0),
        "insertion": (BACK, FRONT - CENTRE, 0, -QUARTER),
        "counterweight": (BACK, 0, 0, -QUARTER), "roll": (0, 0, TOOL, 0),
    },
    parents={"rear": "pitch", "bottom": "front", "top": "front", "insertion": "bottom",
             "counterweight": "pitch", "roll": "insertion"},
    driven={"yaw": QUARTER, "pitch": -QUARTER, "insertion": 0.0, "roll": 0.0},
    follow={
        "front": ({"pitch": -1}, QUARTER), "rear": ({"pitch": -1}, QUARTER),
        "bottom": ({"pitch": 1}, QUARTER), "top": ({"pitch": 1}, 3 * QUARTER),
        "counterweight": ({"insertion": 1}, 0.0),
    },
)  # fmt: skip


def convert(source: Path, folder: Path) -> Machine:
    """The first four of seven joints; the parallelograms' links turn as the pitch says."""
    first, second = write(ARM, source, folder)
    return Machine(folder, (first,), (second,))


def write(arm: Arm, source: Path, folder: Path) -> tuple[Path, ...]:
    """Writes the mechanism's files; its logs."""
    checkout, logs = Checkout(source, COMMIT), []
    for name in LOGS:
        file = checkout.read(f"data/psm/measured_trajectory/{name}_results.csv")
        q, v, tau = np.hsplit(np.loadtxt(io.BytesIO(file), delimiter=","), 3)
        channels = {
            f"{channel}_{joint}": x[:, i] + (offset if channel == "q" else 0.0)
            for channel, x in (("q", q), ("v", v), ("tau", tau))
            for i, (joint, offset) in enumerate(arm.driven.items())
        }
        logs.append(write_log(folder / f"{name}.csv", t=np.arange(len(q)) / RATE, **channels))
    origins = np.array([(*origin, 0, 0) for origin in arm.origins.values()])
    chain(folder / "psm.urdf", list(arm.origins), origins, parents=arm.parents,
          sliding=("insertion", "counterweight"))  # fmt: skip
    passive = ", ".join(f'"{name}"' for name in arm.follow)
    closures = "\n".join(
        f'[[closure]]\nname = "{name}"\nkind = "linear"\njoints = {[name, *others]}\n'
        f"ratios = {[1.0, *(-float(x) for x in others.values())]}\noffset = {offset}"
        for name, (others, offset) in arm.follow.items()
    )
    (folder / "mechanism.toml").write_text(
        f'urdf = "psm.urdf"\n[joints]\npassive = [{passive}]\n{closures}\n'
    )
    return tuple(logs)
