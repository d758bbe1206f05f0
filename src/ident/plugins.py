"""Readers of file formats by the suffix of the file: ident's own, and those of installed packages.

A package adds a format by a function and one line of its pyproject.toml:

    [project.entry-points."ident.formats"]
    "log.dat" = "my_package:read_dat"

`log.dat` reads logs whose files end in .dat: `read_dat(path)` returns the columns by name, as
arrays or a data frame. `mechanism.usd` reads mechanisms: its function returns the text of a URDF,
or an `ident.mechanism.description.Description` that states closures and all else, too.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Literal

from ident.errors import IdentError, LogError, MechanismError, line_of

GROUP = "ident.formats"
OWN = tuple(
    EntryPoint(name, function, GROUP)
    for name, function in {
        "log.csv": "ident.log.storage:read_csv",
        "log.parquet": "ident.log.storage:read_parquet",
        "log.npz": "ident.log.storage:read_npz",
        "log.mcap": "ident.formats.rosbag:read_bag",
        "log.db3": "ident.formats.rosbag:read_bag",
        "mechanism.urdf": "ident.mechanism.description:Description",
        "mechanism.xml": "ident.formats.mjcf:read_mjcf",
        "mechanism.mjcf": "ident.formats.mjcf:read_mjcf",
        "mechanism.sdf": "ident.formats.sdf:read_sdf",
        "mechanism.world": "ident.formats.sdf:read_sdf",
    }.items()
)
Kind = Literal["log", "mechanism"]
ERRORS: dict[str, type[IdentError]] = {"log": LogError, "mechanism": MechanismError}


def suffixes(kind: Kind) -> tuple[str, ...]:
    """Return the suffixes of all formats of a kind, ident's own first."""
    names = [each.name for each in (*OWN, *entry_points(group=GROUP))]
    kinds = [f".{name.partition('.')[2].lower()}" for name in names if name.startswith(f"{kind}.")]
    return tuple(dict.fromkeys(kinds))


def is_own(kind: Kind, suffix: str) -> bool:
    """Return whether a format is one of ident's own."""
    return any(own.name == f"{kind}{suffix}" for own in OWN)


def reader_of(kind: Kind, suffix: str) -> Callable[..., Any] | None:
    """Return the function that reads files of a suffix, such as ".csv"; None if there is none.

    Whatever the function of another package raises, other than an error of the file system,
    becomes a LogError or MechanismError that names the file and the function.
    """
    name = f"{kind}{suffix}"
    for own in OWN:
        if own.name == name:
            return own.load()
    for entry in entry_points(group=GROUP):
        if entry.name.lower() == name:
            return _guarded(entry, ERRORS[kind])
    return None


def _guarded(entry: EntryPoint, error_class: type[IdentError]) -> Callable[[Path], Any]:
    def read(path: Path) -> Any:
        try:
            return entry.load()(path)
        except (IdentError, OSError):
            raise
        except Exception as error:
            raise error_class(
                f"{path}: cannot be read by {entry.value} ({line_of(error)}); correct the file, or "
                "the package that brings this format"
            ) from error

    return read
