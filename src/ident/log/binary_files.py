"""Parquet and NumPy archives to a table."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
import polars as pl

from ident.errors import LogError
from ident.log.table import Table, table_of


def read_parquet(stream: BinaryIO, file: str) -> Table:
    """The columns of a Parquet file; raises LogError where it is not one."""
    try:
        frame = pl.read_parquet(stream)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        raise LogError(f"{file}: not a Parquet file, or a damaged one; write it again") from error
    return table_of(file, frame)


def read_npz(stream: BinaryIO, file: str) -> Table:
    """The arrays of a NumPy archive, each a column; pickles are never loaded.

    Raises LogError where the file is no archive, an array is not 1-D, or lengths differ.
    """
    try:
        arrays = np.load(stream, allow_pickle=False)
        if not isinstance(arrays, np.lib.npyio.NpzFile):
            raise LogError(f"{file}: a single array, not an archive; write it with np.savez")
        with arrays:
            return table_of(file, list(_series(arrays, file)))
    except (ValueError, EOFError, OSError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise LogError(
            f"{file}: not a NumPy archive, or a damaged one; write it with np.savez"
        ) from error


def _series(arrays: np.lib.npyio.NpzFile, file: str) -> Iterator[pl.Series]:
    length: dict[int, str] = {}
    for name in arrays.files:
        try:
            x = arrays[name]
        except ValueError as error:
            if "allow_pickle" not in str(error):
                raise
            raise LogError(
                f"{file}: array {name!r} holds Python objects, which are pickles and can run code; "
                "valid: 1-D arrays of numbers"
            ) from None
        if not isinstance(x, np.ndarray):  # another kind of file in the archive
            raise LogError(f"{file}: {name!r} is not an array; valid: 1-D arrays, one a column")
        if x.ndim != 1:
            raise LogError(f"{file}: array {name!r} has shape {x.shape}; valid: 1-D, one a column")
        length.setdefault(x.size, name)
        if len(length) > 1:
            (n, one), (m, other) = length.items()
            raise LogError(
                f"{file}: arrays of different lengths: {one!r} has {n}, {other!r} has {m}; "
                "every column needs one value a sample (NaN where there is none)"
            )
        if x.dtype.kind in "fiu":  # polars knows no long double, and no foreign byte order
            yield pl.Series(name, x.astype(np.float64))
        elif x.dtype.kind in "mM":
            yield pl.Series(name, x.astype(f"{x.dtype.kind}8[ns]"))
        elif x.dtype.kind == "b":
            yield pl.Series(name, x)
        elif x.dtype.kind in "US":
            yield pl.Series(name, x.astype(str).tolist(), dtype=pl.String)
        else:
            raise LogError(f"{file}: array {name!r} holds {x.dtype}; valid: 1-D arrays of numbers")
