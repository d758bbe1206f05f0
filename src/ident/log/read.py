"""A file to a Log: the one place where its path, suffix and readability are asked about."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

from ident.errors import LogError, one_of
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


def read_log(path: str | os.PathLike[str], columns: Mapping[str, Column] | None = None) -> Log:
    """Read one recorded experiment from a .csv, .parquet or .npz file.

    `columns` maps ident's names to the file's columns (mechanism.toml's [log]), for example
    `{"t": Column("stamp_ms", 0.001)}`: value = scale * file + offset. Columns that are not mapped
    keep their own name. Empty cells are NaN, booleans 1 and 0; columns of text are left out;
    of repeated time stamps the first is kept. What was changed is said in `Log.repairs`.

    Raises LogError, one line: what, where in the file, and what would be valid.
    """
    path = Path(path)
    mapping = columns or {}
    table, sha256 = _read(path)
    table = renamed(table, mapping)
    return Log._checked(path.name, table, mapping.get("t"), sha256)


def _read(path: Path) -> tuple[Table, str]:
    valid = ", ".join(READERS)
    if path.is_dir():
        raise LogError(f"{path}: a folder; name one file in it, with a suffix of {valid}")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise LogError(f"{path}: unknown suffix {path.suffix!r}; valid: {valid}")
    try:
        with path.open("rb") as stream:
            sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
            stream.seek(0)
            return reader(stream, str(path)), sha256
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; {_nearby(path)}") from None
    except OSError as error:
        why = error.strerror or type(error).__name__
        raise LogError(f"{path}: cannot be read ({why}); name a file that you may read") from error


def _nearby(path: Path) -> str:
    """Which logs are in the folder, where one was named that is not there."""
    try:
        logs = [file.name for file in path.parent.iterdir() if file.suffix.lower() in READERS]
    except OSError:
        return f"there is no folder {str(path.parent)!r}; valid: the path of a log"
    return f"in that folder: {one_of(path.name, logs)}"
