"""A table to a file, whole or not at all."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
import polars as pl

from ident.errors import LogError
from ident.files import whole
from ident.log.cells import Array


def write_table(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns by the path's suffix; raises LogError for an unknown one or a failed write."""
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise LogError(f"{path}: unknown suffix {path.suffix!r}; valid: {', '.join(WRITERS)}")
    try:
        with whole(path) as stream:
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


def _write_parquet(stream: BinaryIO, columns: Mapping[str, Array]) -> None:
    pl.DataFrame(dict(columns)).write_parquet(stream)


def _write_npz(stream: BinaryIO, columns: Mapping[str, Array]) -> None:
    # np.savez takes names as keywords, and has two of its own ("file", "allow_pickle")
    with zipfile.ZipFile(stream, "w") as archive:
        for name, x in columns.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, x, allow_pickle=False)


WRITERS: dict[str, Callable[[BinaryIO, Mapping[str, Array]], None]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
    ".npz": _write_npz,
}
