"""What is installed: the version of ident, and readers of file formats by the suffix of the file,
ident's own and those of other packages.

A package adds a format by a function and one line of its pyproject.toml:

    [project.entry-points."ident.formats"]
    "log.dat" = "my_package:read_dat"

`log.dat` reads logs whose files end in .dat: `read_dat(path)` returns the columns by name, as
arrays or a data frame. `mechanism.usd` reads mechanisms: its function returns the text of a URDF,
or an `ident.mechanism.description.Description` that states closures and all else, too.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ident.errors import IdentError, LogError, MechanismError, line_of

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint, EntryPoints

GROUP = "ident.formats"
OWN = {
    "log.csv": "ident.log.storage:read_csv",
    "log.parquet": "ident.log.storage:read_parquet",
    "log.npz": "ident.log.storage:read_npz",
    "log.mcap": "ident.formats.rosbag:read_bag",
    "log.db3": "ident.formats.rosbag:read_bag",
    "mechanism.urdf": "ident.mechanism.description:Description",
    "mechanism.xml": "ident.formats.mjcf:read_mjcf",
    "mechanism.mjcf": "ident.formats.mjcf:read_mjcf",
}
Kind = Literal["log", "mechanism"]
ERRORS: dict[str, type[IdentError]] = {"log": LogError, "mechanism": MechanismError}


def suffixes(kind: Kind) -> tuple[str, ...]:
    """Return the suffixes of all formats of a kind, ident's own first."""
    names = [*OWN, *(each.name for each in _of_others())]
    kinds = [f".{name.partition('.')[2].lower()}" for name in names if name.startswith(f"{kind}.")]
    return tuple(dict.fromkeys(kinds))


def reader_of(kind: Kind, suffix: str) -> Callable[..., Any] | None:
    """Return the function that reads files of a suffix, such as ".csv"; None if there is none.

    Whatever the function of another package raises, other than an error of the file system,
    becomes a LogError or MechanismError that names the file and the function.
    """
    name = f"{kind}{suffix}"
    if name in OWN:
        module, _, function = OWN[name].partition(":")
        return getattr(import_module(module), function)
    for entry in _of_others():
        if entry.name.lower() == name:
            return _guarded(entry, ERRORS[kind])
    return None


def _of_others() -> EntryPoints:
    from importlib.metadata import entry_points  # `ident --help` need not wait for it

    return entry_points(group=GROUP)


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


def version(package: str = "ident", missing: str = "0") -> str:
    """Return the version of a package, `missing` of one that is not installed, as a checkout."""
    from importlib import metadata

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return missing
