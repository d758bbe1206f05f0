"""Parquet files and NumPy archives read, and tables written to CSV, Parquet and archives."""

from __future__ import annotations

import contextlib
import math
import os
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
import polars as pl

from ident.errors import LogError
from ident.files import atomic_write, check_size
from ident.log.table import Array, RawTable, table_of, table_of_arrays

# what NumPy raises for a damaged archive
BROKEN = (ValueError, EOFError, OSError, RuntimeError, KeyError, zipfile.BadZipFile, zlib.error)
HEADERS = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}


def read_parquet(path: Path) -> RawTable:
    """Read the columns of a Parquet file; raises LogError where it is not one."""
    with path.open("rb") as stream, parquet_errors(path):
        lazy = pl.scan_parquet(path)
        rows, columns = lazy.select(pl.len()).collect().item(), len(lazy.collect_schema())
        check_size(path, 8 * rows * columns)
        frame = pl.read_parquet(stream)
    return table_of(str(path), frame)


@contextlib.contextmanager
def parquet_errors(path: Path) -> Iterator[None]:
    """Raise what polars raises for a bad Parquet file as a LogError, without the words to standard
    error of threads that panic.
    """
    try:
        with _silence():
            yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        raise LogError(f"{path}: not a Parquet file, or a damaged one; write it again") from error


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Let standard error of this process lead nowhere."""
    before, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)
        os.close(nowhere)


def read_npz(path: Path) -> RawTable:
    """Read the arrays of a NumPy archive, each a column; pickles are never loaded.

    Raises LogError where the file is no archive, an array is not 1-D, or lengths differ.
    """
    with path.open("rb") as stream:
        try:
            archive = np.load(stream, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise LogError(f"{path}: a single array, not an archive; write it with np.savez")
            check_claims(archive, path)
            arrays = {name: _array(archive, name, path) for name in archive.files}
        except BROKEN as e:
            raise LogError(
                f"{path}: not a NumPy archive, or a damaged one; write it with np.savez"
            ) from e
    return table_of_arrays(str(path), arrays)


def check_claims(archive: np.lib.npyio.NpzFile, path: Path) -> dict[str, tuple[int, ...]]:
    """Return the shapes of an archive's arrays by name, none of them read.

    Raises LogError where they would take too much memory, ValueError where an array claims more
    than its file in the archive holds.
    """
    shapes, total, files = {}, 0, archive.zip
    assert files is not None  # while it is open
    for name in archive.files:
        member = name if name in files.namelist() else f"{name}.npy"
        size = files.getinfo(member).file_size
        check_size(path, total := total + size)
        if not member.endswith(".npy"):
            continue
        with files.open(member) as stream:
            read = HEADERS[np.lib.format.read_magic(stream)[0]]
            shape, _, kind = read(stream)
        if not kind.hasobject and kind.itemsize * math.prod(shape) > size:
            raise ValueError(f"{name} claims more than there is")
        shapes[name] = shape
    return shapes


def _array(archive: np.lib.npyio.NpzFile, name: str, path: Path) -> np.ndarray:
    try:
        x = archive[name]
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise
        raise LogError(
            f"{path}: array {name!r} holds Python objects, which are pickles and can run code; "
            "valid: 1-D arrays of numbers"
        ) from None
    if not isinstance(x, np.ndarray):  # another kind of file in the archive
        raise LogError(f"{path}: {name!r} is not an array; valid: 1-D arrays, one a column")
    return x


def write_table(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns by the path's suffix; raises LogError for an unknown one or a failed write."""
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise LogError(f"{path}: unknown suffix {path.suffix!r}; valid: {', '.join(WRITERS)}")
    try:
        with atomic_write(path) as stream:
            writer(stream, columns)
    except (OSError, pl.exceptions.PolarsError) as error:
        why = getattr(error, "strerror", None) or type(error).__name__
        raise LogError(
            f"{path}: cannot be written ({why}); valid: a folder you may write"
        ) from error


def _write_csv(stream: BinaryIO, columns: Mapping[str, Array]) -> None:
    # names with the other separators in them are quoted, or the reader would take those for its own
    tricky = any(set(";\t") & set(name) for name in columns)
    frame = pl.DataFrame(dict(columns)).fill_nan(None)
    frame.write_csv(stream, quote_style="non_numeric" if tricky else "necessary")


def _write_npz(stream: BinaryIO, columns: Mapping[str, Array]) -> None:
    # np.savez takes names as keywords, and has two of its own ("file", "allow_pickle")
    with zipfile.ZipFile(stream, "w") as archive:
        for name, x in columns.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, x, allow_pickle=False)


WRITERS: dict[str, Callable[[BinaryIO, Mapping[str, Array]], None]] = {
    ".csv": _write_csv,
    ".parquet": lambda stream, columns: pl.DataFrame(dict(columns)).write_parquet(stream),
    ".npz": _write_npz,
}
