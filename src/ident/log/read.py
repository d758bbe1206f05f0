"""A file or bag to a Log: the one place where its path, suffix and readability are asked about."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from ident.errors import LogError, one_of
from ident.log.bag import SUFFIXES, bag_digest, is_bag, read_bag
from ident.log.binary_files import read_npz, read_parquet
from ident.log.columns import Column, renamed
from ident.log.csv_file import read_csv
from ident.log.log import Log
from ident.log.table import Table

READERS: dict[str, Callable[[BinaryIO, str], Table]] = {
    ".csv": read_csv,
    ".parquet": read_parquet,
    ".npz": read_npz,
}


def read_log(
    path: str | os.PathLike[str],
    columns: Mapping[str, Column] | None = None,
    *,
    topic: str | None = None,
) -> Log:
    """Read one recorded experiment from a .csv, .parquet or .npz file, or from a ROS 2 bag.

    Columns that are not mapped keep their own name. Empty cells are NaN, booleans 1 and 0; columns
    of text are left out; of repeated time stamps the first is kept. What was changed is said in
    `Log.repairs`.

    Args:
        path: of the file, or of a bag: its folder, or one .mcap or .db3 file. `bag#/joint_states`
            names a topic too.
        columns: ident's names to the file's columns (mechanism.toml's [log]), for example
            `{"t": Column("stamp_ms", 0.001)}`: value = scale * file + offset.
        topic: of a bag, where it has several of `sensor_msgs/JointState`. Several are merged, with
            commas between; a topic of `geometry_msgs/WrenchStamped` adds its wrench.

    Returns:
        The log, its times in s and its columns in SI units.

    Raises:
        LogError: one line: what, where in the file, and what would be valid.
    """
    path, topics = split(Path(path), topic)
    mapping = columns or {}
    table, sha256 = read_whole(path, topics)
    return Log._checked(named(path, topics), renamed(table, mapping), mapping.get("t"), sha256)


def split(path: Path, topic: str | None) -> tuple[Path, list[str]]:
    """The path without its `#topic`, and the topics; raises LogError where both are given."""
    before, mark, behind = str(path).partition("#")
    if mark and not path.exists() and (Path(before).exists() or is_bag(Path(before))):
        if topic is not None:
            raise LogError(
                f"{path}: names a topic, and topic = {topic!r} is given; give one of them"
            )
        path, topic = Path(before), behind
    topics = [each.strip() for each in (topic or "").split(",")]
    if topic is not None and not all(topics):
        raise LogError(f"{path}: topic '{topic}'; name one, such as {path}#/joint_states")
    return path, [each for each in topics if each]


def named(path: Path, topics: list[str]) -> str:
    """What a log of this file is called."""
    return (path.name or path.resolve().name) + (f"#{','.join(topics)}" if topics else "")


def check_kind(path: Path, topics: list[str]) -> None:
    """Raise LogError, with what would be valid, for a path that is neither a log nor a bag."""
    valid = ", ".join(READERS)
    bag = is_bag(path)
    if topics and not bag:
        raise LogError(f"{path}: is no ROS 2 bag, so it has no topic '{topics[0]}'")
    if path.is_dir() and not bag:
        raise LogError(
            f"{path}: a folder; name one file in it, with a suffix of {valid}, or a ROS 2 "
            "bag, which has a metadata.yaml"
        )
    if path.suffix.lower() == ".bag":
        raise LogError(
            f"{path}: a ROS 1 bag; make a ROS 2 bag of it: rosbags-convert --src {path} "
            f"--dst {path.stem}"
        )
    if not path.exists() and (bag or not path.suffix):
        raise LogError(f"{path}: no such file; {_nearby(path)}")
    if path.suffix.lower() not in READERS and not bag:
        raise LogError(
            f"{path}: unknown suffix {path.suffix!r}; valid: {valid}, and {', '.join(SUFFIXES)} or "
            "the folder of a ROS 2 bag"
        )


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """What the system says against reading a file becomes a LogError."""
    try:
        yield
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; {_nearby(path)}") from None
    except OSError as error:
        why = error.strerror or type(error).__name__
        raise LogError(f"{path}: cannot be read ({why}); name a file that you may read") from error


def read_whole(path: Path, topics: list[str]) -> tuple[Table, str]:
    """All columns of a file or bag under its own names, and its SHA-256; raises LogError."""
    check_kind(path, topics)
    with reading(path):
        if is_bag(path):
            return read_bag(path, topics), bag_digest(path)
        with path.open("rb") as stream:
            sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
            stream.seek(0)
            return READERS[path.suffix.lower()](stream, str(path)), sha256


def _nearby(path: Path) -> str:
    """Which logs are in the folder, where one was named that is not there."""
    try:
        files = [*path.parent.iterdir()]
        logs = [f.name for f in files if f.suffix.lower() in READERS or is_bag(f)]
    except OSError:
        return f"there is no folder {str(path.parent)!r}; valid: the path of a log"
    return f"in that folder: {one_of(path.name, logs)}"
