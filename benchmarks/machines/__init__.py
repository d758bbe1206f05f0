"""Converters of public measurements: raw files to a mechanism and logs that `ident` reads.

Each machine is one module with `SOURCE`, `PUBLISHED` and `convert(source, folder)`. Nothing of the
measurements is in this repository; facts carry over with their source.
"""

from __future__ import annotations

import argparse
import os
import subprocess
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# folders of shared data
SHARED = Path(os.environ.get("IDENT_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def arguments(description: str | None, names: Sequence[str]) -> tuple[Sequence[str], list[Path]]:
    """The names that a command line has, all without any, and the folders to look in for data."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", help=f"of {', '.join(names)}; default: all")
    parser.add_argument("--data", action="append", type=Path, default=[], metavar="DIR")
    given = parser.parse_args()
    return given.names or names, [*given.data, SHARED]


@dataclass(frozen=True)
class Machine:
    """A real machine with its logs.

    Attributes:
        mechanism: URDF or folder.
        train, validate: logs to identify from, and to judge on; without the latter, held-out time.
        effects: of its sensors, present in every model.
    """

    mechanism: Path
    train: tuple[Path, ...]
    validate: tuple[Path, ...] = ()
    effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class Checkout:
    """A clone of a public repository, bare or not, at one commit."""

    folder: Path
    commit: str

    def read(self, path: str) -> bytes:
        """The content of a file at the commit."""
        command = ["git", "-C", str(self.folder), "show", f"{self.commit}:{path}"]
        return subprocess.run(command, check=True, capture_output=True).stdout


def located(source: str, places: Sequence[Path]) -> Path | None:
    """The folder of shared data or the clone that a source names; None if it is nowhere.

    A source is the name of a folder, or `owner/name` of a public repository, of which a clone may
    be called `name`, `owner/name` or `owner+name/repo`.
    """
    owner, _, name = source.rpartition("/")
    for place in places:
        for folder in (place / name, place / owner / name, place / f"{owner}+{name}" / "repo"):
            if folder.is_dir():
                return folder
    return None


def write_log(path: Path, **channels: np.ndarray) -> Path:
    """Writes a log; `channels` are columns by name, with `_` in place of the first dot."""
    names = [name.replace("_", ".", 1) for name in channels]
    table = np.column_stack(list(channels.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    return path


def modified_dh(rows: np.ndarray) -> np.ndarray:
    """Origins (joints, 6) of a, α, d (joints, 3): modified Denavit-Hartenberg (Craig)."""
    a, alpha, d = rows.T
    zero = np.zeros(len(rows))
    return np.column_stack([a, -np.sin(alpha) * d, np.cos(alpha) * d, alpha, zero, zero])


def chain(
    path: Path,
    joints: Sequence[str],
    origins: np.ndarray,
    *,
    parents: Mapping[str, str | None] | None = None,
    masses: Mapping[str, tuple[float, float]] | None = None,
    sliding: Collection[str] = (),
) -> Path:
    """Writes the URDF of an arm with revolute joints about z.

    Args:
        path: of the URDF.
        joints: names.
        origins: (joints, 6) x, y, z [m], roll, pitch, yaw [rad] of each joint in the one before.
        parents: by joint, the one that it sits on, None for the base, where not the one before.
        masses: by joint, of its link [kg], and its centre's x [m], where that is not 1 kg at 0.
        sliding: joints that slide along z.
    """
    parents, masses = parents or {}, masses or {}
    inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    lines, parent = [f'<robot name="{path.stem}">', '<link name="base"/>'], "base"
    for joint, origin in zip(joints, origins, strict=True):
        xyz, rpy = (" ".join(map(str, x)) for x in (origin[:3], origin[3:]))
        if joint in parents:
            parent = f"link_{parents[joint]}" if parents[joint] else "base"
        kind = "prismatic" if joint in sliding else "revolute"
        mass, x = masses.get(joint, (1.0, 0.0))
        body = f'<origin xyz="{x} 0 0"/><mass value="{mass}"/>{inertia}'
        lines += [
            f'<link name="link_{joint}"><inertial>{body}</inertial></link>',
            f'<joint name="{joint}" type="{kind}"><parent link="{parent}"/>',
            f'<child link="link_{joint}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>',
            '<limit lower="-6.3" upper="6.3" effort="1000" velocity="10"/></joint>',
        ]
        parent = f"link_{joint}"
    path.write_text("\n".join([*lines, "</robot>", ""]))
    return path
