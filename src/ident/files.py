"""Files: written completely or not at all, Python files of the user run, TOML tables checked, and
readers of formats found: ident's own and those of other packages.

Every fault of a table is named with its place. A package adds a format by a function and one line
of its pyproject.toml:

    [project.entry-points."ident.formats"]
    "log.dat" = "my_package:read_dat"

`log.dat` reads logs whose files end in .dat: `read_dat(path)` returns the columns by name, as
arrays or a data frame. `mechanism.usd` reads mechanisms: its function returns the text of a URDF,
or an `ident.mechanism.description.Description` that states closures and all else, too.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import glob
import json
import math
import os
import runpy
import shutil
import stat
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, is_dataclass
from functools import cache
from importlib import import_module
from inspect import isfunction
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Literal

from ident.display import render
from ident.errors import IdentError, LogError, MechanismError, line_of, near, one_of
from ident.request import PYTHON, Request

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

LARGEST = 4.0  # work: GB of a log's numbers in memory: half a billion values
ABANDONED = 600.0  # range: s without a change, after which the writer of a part is taken to be dead
LARGEST_LOG = "IDENT_LARGEST_LOG"  # variable of the environment, which workers inherit


def regular(path: Path) -> Path:
    """Return the path of a file or folder; refuse a pipe or a device with an OSError."""
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError(errno.EINVAL, "a pipe or a device, which may never end", str(path))
    return path


def most_bytes() -> int:
    """Return how many bytes of numbers a log may have in memory, IDENT_LARGEST_LOG in GB."""
    text = os.environ.get(LARGEST_LOG, "")
    try:
        size = float(text or LARGEST)
    except ValueError:
        size = 0.0
    if not 0 < size < 1e9:
        raise IdentError(f"{LARGEST_LOG} = '{text}'; valid: a size in GB, such as {LARGEST:g}")
    return int(size * 1e9)


def check_size(path: Path, size: float) -> None:
    """Refuse, before memory is taken, a log whose numbers would take too many bytes."""
    if size > most_bytes():
        raise LogError(
            f"{path}: its numbers would take {size / 1e9:.3g} GB, and at most "
            f"{most_bytes() / 1e9:.3g} GB are taken; leave columns out, cut the log, read CSV and "
            f"Parquet files in portions (--stream), or raise the limit: ident --largest-log GB …, "
            f"or {LARGEST_LOG}=GB in the environment"
        )


def _check_replaceable(path: Path) -> None:
    """Refuse to replace a file that nobody may write, as a rename would."""
    with contextlib.suppress(FileNotFoundError):
        if not path.stat().st_mode & (stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH):
            raise PermissionError(errno.EACCES, "is read-only", str(path))


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """Open a stream whose content appears under `path` only if the block ends without an error."""
    _check_replaceable(path)
    # same folder, so that the last step is one rename; not tempfile, whose files are private
    _clear(path)
    part = _sibling(path, "part")
    try:
        with part.open("xb") as stream:
            yield stream
        os.replace(part, path)
    finally:
        _quietly(part.unlink)


def jsonable(value: Any) -> Any:
    """Return a value as JSON can hold it: numbers of Python, None for what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return jsonable(asdict(value))
    if hasattr(value, "tolist"):  # of numpy, which is not imported for this
        return jsonable(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def json_bytes(content: Mapping[str, Any]) -> bytes:
    """Return the content of a JSON file; numbers that are not finite are null."""
    text = json.dumps(jsonable(content), indent=1, ensure_ascii=False, allow_nan=False)
    return text.encode() + b"\n"


def json_line(content: Mapping[str, Any]) -> str:
    """Return the same in one line of ASCII, for another program to read."""
    return json.dumps(jsonable(content), allow_nan=False)


def write_all(folder: Path, contents: Mapping[str, bytes | Iterable[bytes]]) -> list[Path]:
    """Write the files of a folder, made where there is none, all or none of them; return the paths.

    `contents` are by name relative to the folder, whole or in pieces. Each is written beside its
    place, then renamed. If that fails midway, the previous files are put back and new ones, folders
    too, are removed.
    """
    paths = [folder / name for name in contents]
    with contextlib.ExitStack() as scraps, contextlib.ExitStack() as undo:  # undo runs first
        try:
            for path in paths:
                _make_folder(path.parent, undo)
                if path.is_dir():
                    raise IsADirectoryError(errno.EISDIR, "is a folder", str(path))
                _check_replaceable(path)
            for path in paths:
                _clear(path)
            parts = [_sibling(path, "part") for path in paths]
            for part, content in zip(parts, contents.values(), strict=True):
                scraps.callback(_quietly, part.unlink)
                undo.callback(_quietly, part.unlink)
                with part.open("xb") as stream:
                    stream.writelines([content] if isinstance(content, bytes) else content)
            for part, path in zip(parts, paths, strict=True):
                old = _sibling(path, "old")
                scraps.callback(_quietly, old.unlink)
                undo.callback(_quietly, old.unlink)
                if path.exists():
                    shutil.copy2(path, old)
                    undo.callback(_quietly, os.replace, old, path)
                else:
                    undo.callback(_quietly, path.unlink)
                os.replace(part, path)
            undo.pop_all()
        except OSError as error:
            raise _unwritable(error, folder) from None
    return paths


class Written:
    """A noun of which `show` makes files: a report, its numbers as JSON, tables."""

    def write(self, folder: str | Path, request: Request = PYTHON) -> list[Path]:
        """Write its files into a folder, made where there is none; return them, all or none.

        Args:
            folder: made if it is not there.
            request: the command that asked for it, which the report's next commands repeat.

        Raises:
            IdentError: if the folder cannot be written; then no file of it has changed.
        """
        return write_all(Path(folder), render(self, "files", request=request))


def function_of(file: Path, name: str, *, allow_code: bool) -> Callable[..., Any]:
    """Run a Python file of the user and return its function `name`."""
    if not allow_code:
        raise MechanismError(
            f"would run {file}; pass --allow-code (allow_code=True) if you trust it"
        )
    if not file.is_file():
        raise MechanismError(f"no such file: {file}; check the path")
    try:
        members = runpy.run_path(str(file), run_name=f"user_{file.stem}")
    except (Exception, SystemExit) as error:  # it is the user's code
        raise MechanismError(f"{file} fails: {line_of(error)}; correct it") from None
    if not callable(members.get(name)):
        functions = [key for key, member in members.items() if isfunction(member)]
        raise MechanismError(f"{file} has no function '{name}'; {one_of(name, functions)}")
    return members[name]


def check_writable(folder: Path) -> None:
    """Refuse, before long work, a folder into which nothing could be written; leaves no trace."""
    if folder.is_file():
        raise IdentError(f"{folder}: is a file; give the name of a folder")
    with contextlib.ExitStack() as undo:
        try:
            _make_folder(folder, undo)
            probe = _sibling(folder / "probe", "part")
            probe.touch()
            probe.unlink()
        except OSError as error:
            raise _unwritable(error, folder) from None


def _unwritable(error: OSError, folder: Path) -> IdentError:
    return IdentError(
        f"{error.filename or folder}: cannot be written ({error.strerror or error}); "
        "name a folder that you may write"
    )


def _sibling(path: Path, suffix: str) -> Path:
    return path.with_name(f".{path.name}.{os.urandom(4).hex()}.{suffix}")


def _clear(path: Path) -> None:
    """Remove what writes of a file that were killed left beside it, unless they may still run."""
    with contextlib.suppress(OSError):
        for part in path.parent.glob(f".{glob.escape(path.name)}.????????.part"):
            if time.time() - part.stat().st_mtime > ABANDONED:
                _quietly(part.unlink)


def _make_folder(folder: Path, undo: contextlib.ExitStack) -> None:
    for parent in reversed([parent for parent in (folder, *folder.parents) if not parent.exists()]):
        parent.mkdir(exist_ok=True)
        undo.callback(_quietly, parent.rmdir)


def _quietly(change: Callable[..., object], *args: Path) -> None:
    with contextlib.suppress(OSError):  # the first error is the one to report
        change(*args)


HUGE = 1e30  # numerics: numbers from which products overflow


def is_number(value: object) -> bool:
    """Return whether a value is a finite number with whose products one can still count."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < HUGE


@dataclass(frozen=True)
class TomlTable:
    """A table of the file, and the place that messages name."""

    where: str
    data: Mapping[str, Any] = field(default_factory=dict)

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def error(self, text: str) -> MechanismError:
        """Return the error of this place."""
        return MechanismError(f"{self.where}: {text}")

    def check(self, *valid: str) -> None:
        """Refuse a key that nothing reads: it would be ignored silently otherwise."""
        for key in self.data:
            if key not in valid:
                raise self.error(f"unknown key '{key}'; {one_of(key, valid)}")

    def table(self, key: str, inline: str = "") -> TomlTable:
        """Return the table `[key]`, empty if it is missing; `inline` is the content of a valid one
        that is written in a line.
        """
        value = self.data.get(key, {})
        if not isinstance(value, dict):
            valid = f"write {key} = {{ {inline} }}" if inline else f"[{key}] must be a table"
            raise self.error(f"{key} = {value!r}; {valid}")
        return TomlTable(f"{self.where}: [{key}]", value)

    def tables(self, key: str) -> list[TomlTable]:
        """Return all tables `[[key]]`."""
        tables = self.data.get(key, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise self.error(f"write every {key} as a table [[{key}]]")
        return [
            TomlTable(f"{self.where}: {key} {i}", table) for i, table in enumerate(tables, start=1)
        ]

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text that is not empty; required unless there is a default."""
        value = self.data.get(key, default)
        if value is None:
            instead = f" ('{meant}' instead?)" if (meant := near(key, self.data)) else ""
            raise self.error(f"has no key '{key}'{instead}; write {key} = \"…\"")
        if not isinstance(value, str) or not value:
            raise self.error(f"{key} = {value!r}; a text in quotes is expected")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """Return a finite number; required unless there is a default."""
        value = self.data.get(key, default)
        if value is None:
            raise self.error(f"has no key '{key}'; write {key} = <number>")
        if not is_number(value):
            raise self.error(f"{key} = {value!r}; a finite number is expected")
        return float(value)

    def vector(
        self, key: str, count: int = 0, default: tuple[float, ...] | None = None
    ) -> tuple[float, ...]:
        """Return `count` finite numbers, any number of them for count 0."""
        value = self.data.get(key, None if default is None else list(default))
        good = isinstance(value, list) and all(map(is_number, value))
        if not isinstance(value, list) or not good or count not in (0, len(value)):
            need = f"{count} finite numbers" if count else "finite numbers"
            raise self.error(f"{key} = {value!r}; a list of {need} is expected")
        return tuple(map(float, value))

    def words(self, key: str) -> tuple[str, ...]:
        """Return a list of texts, empty if it is missing."""
        value = self.data.get(key, [])
        if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
            raise self.error(f"{key} = {value!r}; a list of texts is expected")
        return tuple(value)


def read_toml(path: Path) -> TomlTable:
    """Return the top level of a TOML file."""
    try:
        data = tomllib.loads(regular(path).read_bytes().removeprefix(codecs.BOM_UTF8).decode())
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise MechanismError(
            f"{path}: is no valid TOML: byte 0x{error.object[error.start]:02x} in line {line} "
            "is no UTF-8 text; save the file as UTF-8"
        ) from None
    except (ValueError, RecursionError) as error:
        raise MechanismError(
            f"{path}: is no valid TOML: {error or 'nested too deeply'}; see the mechanism.toml of "
            "robots/ for its form"
        ) from None
    except OSError as error:
        raise MechanismError(f"{path}: cannot be read: {error.strerror}") from None
    return TomlTable(str(path), data)


GROUP = "ident.formats"
BUILT_IN = {
    "log.csv": "ident.log.storage:read_csv",
    "log.parquet": "ident.log.storage:read_parquet",
    "log.npz": "ident.log.storage:read_npz",
    "log.pt": "ident.formats.torch_log:read_torch",
    "log.mcap": "ident.formats.rosbag:read_bag",
    "log.db3": "ident.formats.rosbag:read_bag",
    "mechanism.urdf": "ident.mechanism.description:Description",
    "mechanism.xml": "ident.formats.mjcf:read_mjcf",
    "mechanism.mjcf": "ident.formats.mjcf:read_mjcf",
    "dialect.extended": "ident.formats.urdf_loops:read_extended",
    "dialect.constraint": "ident.formats.urdf_loops:read_constraints",
    "dialect.plus": "ident.formats.urdf_loops:read_urdf_plus",
}
Kind = Literal["log", "mechanism"]
ERRORS: dict[str, type[IdentError]] = {"log": LogError, "mechanism": MechanismError}


def suffixes(kind: Kind) -> tuple[str, ...]:
    """Return the suffixes of all formats of a kind, ident's own first."""
    names = [*BUILT_IN, *(entry.name for entry in _of_others())]
    kinds = [f".{name.partition('.')[2].lower()}" for name in names if name.startswith(f"{kind}.")]
    return tuple(dict.fromkeys(kinds))


def reader_of(kind: Kind, suffix: str) -> Callable[..., Any] | None:
    """Return the function that reads files of a suffix, such as ".csv"; None if there is none."""
    name = f"{kind}{suffix}"
    if name in BUILT_IN:
        module, _, function = BUILT_IN[name].partition(":")
        return getattr(import_module(module), function)
    entry = next((candidate for candidate in _of_others() if candidate.name.lower() == name), None)
    if entry is None:
        return None

    def read(path: Path) -> Any:
        try:
            return entry.load()(path)
        except (IdentError, OSError):
            raise
        except Exception as error:
            raise ERRORS[kind](
                f"{path}: cannot be read by {entry.value} ({line_of(error)}); correct the file, or "
                "the package that brings this format"
            ) from error

    return read


def dialects() -> list[Callable[..., Any]]:
    """Return the readers of what URDFs state beyond a tree, in or beside the file: functions of the
    checked `<robot>`, which they may change, its path, and whether files beside it are read.
    """
    paths = [path.partition(":") for name, path in BUILT_IN.items() if name.startswith("dialect.")]
    readers = [getattr(import_module(module), function) for module, _, function in paths]
    return [*readers, *(x.load() for x in _of_others() if x.name.startswith("dialect."))]


def _of_others() -> EntryPoints:
    return _installed(tuple(sys.path))


@cache
def _installed(paths: tuple[str, ...]) -> EntryPoints:
    """Return what packages in `sys.path` offer: all of their folders are looked through."""
    from importlib.metadata import entry_points  # `ident --help` need not wait for it

    return entry_points(group=GROUP)


def version(package: str = "ident", missing: str = "0") -> str:
    """Return the version of a package, `missing` of one that is not installed, as a checkout."""
    from importlib import metadata

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return missing
