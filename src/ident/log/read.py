"""Logs in files: their paths, formats and readability; folders of logs."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ident.errors import LogError, one_of
from ident.files import check_size, reader_of, regular, suffixes
from ident.lazy import lazy
from ident.log import storage
from ident.log.log import Log
from ident.log.table import Column, RawTable, frame_table, is_frame, table_of_arrays

if TYPE_CHECKING:
    import polars as pl
else:
    pl = lazy("polars")

BAG = (".mcap", ".db3")  # ROS 2 bags, whose topics are chosen
HEAD = 1 << 16  # work: bytes of a text from which its number of rows is estimated


def read_log(
    path: str | os.PathLike[str],
    columns: Mapping[str, Column] | None = None,
    *,
    topic: str | None = None,
    poses: bool | None = None,
) -> Log:
    """Read one recorded experiment from a .csv, .parquet or .npz file, or from a ROS 2 bag.

    Columns that are not mapped keep their own name. Empty cells are NaN, booleans 1 and 0; columns
    of text are left out; of repeated time stamps the first is kept. `Log.repairs` states what was
    changed. Other packages may add formats (`ident.files`).

    Args:
        path: of the file, or of a bag: its folder, or one .mcap or .db3 file. `bag#/joint_states`
            names a topic too.
        columns: ident's names to the file's columns (mechanism.toml's [log]), for example
            `{"t": Column("stamp_ms", 0.001)}`: value = scale * file + offset.
        topic: of a bag, where it has several of `sensor_msgs/JointState`. Several are merged, with
            commas between.
        poses: whether its rows are poses at rest, one row a pose.

    Returns:
        The log, its times in s and its columns in SI units.

    Raises:
        LogError: one line: what, where in the file, and what would be valid.
    """
    file = log_file(path, topic)
    with file_errors(file.path):
        table, sha256 = file.table(), file.sha256()
    return Log.from_table(file.name, table, columns, sha256, poses)


@dataclass(frozen=True)
class LogFile:
    """The file of a log, or a ROS 2 bag with the topics to read, in a format that has a reader."""

    path: Path
    topics: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the log."""
        name = self.path.name or self.path.resolve().name
        return name + (f"#{','.join(self.topics)}" if self.topics else "")

    def table(self) -> RawTable:
        """Read all columns under the file's own names."""
        suffix = suffix_of(self.path)
        reader = reader_of("log", suffix)
        assert reader is not None
        check_size(self.path, regular(self.path).stat().st_size)
        content = reader(self.path, self.topics) if suffix in BAG else reader(self.path)
        if isinstance(content, RawTable):
            return content
        if is_frame(content):
            return frame_table(str(self.path), content)
        return table_of_arrays(str(self.path), content)

    def sha256(self) -> str:
        """Return the SHA-256 of the file; of a bag's folder that of its data files, by name."""
        digest = hashlib.sha256()
        for file in sorted(self.path.iterdir()) if self.path.is_dir() else [self.path]:
            if file == self.path or set(file.suffixes) & set(BAG):
                with file.open("rb") as stream:
                    hashlib.file_digest(stream, lambda: digest)
        return digest.hexdigest()


def log_file(path: str | os.PathLike[str], topic: str | None) -> LogFile:
    """Return the file that `path` or `path#topic` names; a LogError says what would be valid."""
    if not isinstance(path, str | os.PathLike):
        raise LogError(
            f"a log's file is a path, given: {type(path).__name__}; ident.complete takes a data "
            "frame as it is"
        )
    path = Path(path)
    before, mark, behind = str(path).partition("#")
    if mark and not path.exists() and (Path(before).exists() or suffix_of(Path(before)) in BAG):
        if topic is not None:
            raise LogError(
                f"{path}: names a topic, and topic = {topic!r} is given; give one of them"
            )
        path, topic = Path(before), behind
    topics = [name.strip() for name in (topic or "").split(",")]
    if topic is not None and not all(topics):
        raise LogError(f"{path}: topic '{topic}'; name one, such as {path}#/joint_states")
    suffix = suffix_of(path)
    if topic is not None and suffix not in BAG:
        raise LogError(f"{path}: is no ROS 2 bag, so it has no topic '{topics[0]}'")
    if path.is_dir() and suffix not in BAG:
        raise LogError(
            f"{path}: a folder; name one file in it, with a suffix of {_valid()}, or a ROS 2 "
            "bag, which has a metadata.yaml"
        )
    if suffix == ".bag":
        raise LogError(
            f"{path}: a ROS 1 bag; make a ROS 2 bag of it: rosbags-convert --src {path} "
            f"--dst {path.stem}"
        )
    if not path.exists() and (suffix in BAG or not suffix):
        raise LogError(f"{path}: no such file; {_nearby(path)}")
    if reader_of("log", suffix) is None:
        raise LogError(
            f"{path}: unknown suffix {path.suffix!r}; valid: {_valid()}, or a ROS 2 bag's folder"
        )
    return LogFile(path, tuple(name for name in topics if name))


def likely_rows(path: str | os.PathLike[str]) -> int:
    """Return about how many rows a log has, without reading it; 0 for what it cannot tell."""
    path = Path(path)
    suffix = path.suffix.lower()
    with contextlib.suppress(Exception):  # whoever reads it says what is wrong with it
        regular(path)
        if suffix == ".parquet":
            return int(pl.scan_parquet(path).select(pl.len()).collect().item())
        with path.open("rb") as stream:
            if suffix == ".csv":
                head = stream.read(HEAD)
                return int(path.stat().st_size * head.count(b"\n") / max(len(head), 1))
            if suffix == ".npz":
                arrays = np.load(stream, allow_pickle=False)
                return next(iter(storage.check_claims(arrays, path).values()))[0]
    return 0


def suffix_of(path: Path) -> str:
    """Return the suffix that names the format, in lower case; a bag's folder has that of a bag."""
    return BAG[0] if (path / "metadata.yaml").is_file() else path.suffix.lower()


@contextlib.contextmanager
def file_errors(path: Path) -> Iterator[None]:
    """Raise errors of the file system as LogError."""
    try:
        yield
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; {_nearby(path)}") from None
    except OSError as error:
        why = error.strerror or type(error).__name__
        raise LogError(f"{path}: cannot be read ({why}); name a file that you may read") from error


def _valid() -> str:
    return ", ".join(suffixes("log"))


def _is_log(path: Path) -> bool:
    suffix = suffix_of(path)
    return suffix in suffixes("log") and (path.is_file() or suffix in BAG)


def _nearby(path: Path) -> str:
    try:
        logs = [file.name for file in path.parent.iterdir() if _is_log(file)]
    except OSError:
        return f"there is no folder {str(path.parent)!r}; valid: the path of a log"
    return f"in that folder: {one_of(path.name, logs)}" if logs else "in that folder is no log"


# --- folders ------------------------------------------------------------------------------------


def is_folder_of_logs(path: Path) -> bool:
    """Return whether a path is a folder, and not a ROS 2 bag."""
    return path.is_dir() and suffix_of(path) not in BAG


def logs_in(folder: str | os.PathLike[str]) -> list[Path]:
    """Return the logs in a folder, by name: all files of a log's suffix, and ROS 2 bags."""
    folder = Path(folder)
    try:
        paths = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise LogError(
            f"{folder}: cannot be looked into ({error.strerror}); name a folder of logs"
        ) from None
    logs = [path for path in paths if _is_log(path)]
    if not logs:
        raise LogError(
            f"{folder}: holds no log; valid: files of {', '.join(suffixes('log'))}, or ROS 2 bags"
        )
    return logs


def expanded(paths: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Return logs, and in place of every folder the logs in it; each file once."""
    unique: dict[Path, Path] = {}
    for path in map(Path, paths):
        for log in logs_in(path) if is_folder_of_logs(path) else [path]:
            unique.setdefault(Path(os.path.realpath(log)), log)
    return list(unique.values())


def distinct(names: Iterable[str]) -> list[str]:
    """Return names that differ, a second one of a name with (2) behind it.

    >>> distinct(["run.csv", "run.csv"])
    ['run.csv', 'run.csv (2)']
    """
    count = Counter[str]()
    unique_names = []
    for name in names:
        count[name] += 1
        unique_names.append(name if count[name] == 1 else f"{name} ({count[name]})")
    return unique_names
