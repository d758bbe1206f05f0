"""A log that is opened, but not read: its rows come in pieces, as `read_log` would return them.

polars reads Parquet by row groups. It cannot start in the middle of a CSV file, so the place of
every STRIDE-th row is kept. Archives, bags and formats of other packages are read whole, once a
process.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ident.errors import LogError
from ident.log.csv_text import BOM, Head, Lines, head_of, refuse_binary, rows_of
from ident.log.log import Log
from ident.log.read import check_kind, digest, log_name, read_table, reading, split, suffix_of
from ident.log.storage import parquet_errors
from ident.log.table import Column, RawTable, first_tick, renamed, table_of

BLOCK = 1 << 24  # bytes of a text that are in memory together
HEAD = 1 << 16  # bytes of a text from which its number of rows is estimated
STRIDE = 1024  # rows of a CSV file from one kept place to the next


@dataclass(frozen=True, eq=False)
class FileRows:
    """A file whose rows can be read by number.

    Attributes:
        path: of the file.
        rows: their number.
        sha256: of the file's bytes.
    """

    path: Path
    rows: int
    sha256: str

    def table(self, first: int, stop: int, only: Collection[str] | None = None) -> RawTable:
        """Return the rows first … stop - 1; of the columns `only`, if that saves work."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Pieces:
    """A recorded experiment on disk, opened by `open_log`.

    Attributes:
        path: of the file.
        name: in messages and tables.
        mapping: ident's names to the file's columns.
        source: of its rows.
        columns: ident's names of all columns of numbers, t among them.
    """

    path: Path
    name: str
    mapping: Mapping[str, Column]
    source: FileRows
    columns: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Number of rows of the file, repeated time stamps among them."""
        return self.source.rows

    @property
    def sha256(self) -> str:
        """SHA-256 of the file's bytes."""
        return self.source.sha256

    def piece(self, first: int, stop: int, only: Collection[str] | None = None) -> Log:
        """Return the samples of the rows first … stop - 1, checked and repaired as by `read_log`.

        Args:
            first: row, from 0.
            stop: row behind the last, ten or more after the first.
            only: columns that are needed; others may be missing.
        """
        wanted, mapping = None, self.mapping
        if only is not None:
            mapping = {name: source for name, source in mapping.items() if name in only}
            wanted = {mapping[name].column if name in mapping else name for name in only}
        with reading(self.path):
            table = self.source.table(first, min(stop, self.rows), wanted)
        if only is not None:
            columns = {name: x for name, x in table.columns.items() if name in (wanted or ())}
            table = replace(table, columns=columns)
        elif other := sorted(set(renamed(table, mapping).columns) ^ set(self.columns)):
            raise LogError(
                f"{self.path}: column {other[0]!r} holds numbers in some rows and text in others "
                f"(from {table.where(0)} on); leave cells empty where there is no value"
            )
        return Log.from_table(self.name, table, mapping, self.sha256)


def open_log(
    path: str | os.PathLike[str],
    columns: Mapping[str, Column] | None = None,
    *,
    topic: str | None = None,
) -> Pieces:
    """Open a log as `read_log` reads it; rows of CSV and Parquet files stay on disk.

    Args:
        path: of the file or bag.
        columns: ident's names to the file's columns.
        topic: of a bag.

    Returns:
        The log in pieces. A text file was read once, to know where rows begin.
    """
    path, topics = split(Path(path), topic)
    check_kind(path, topics)
    mapping, suffix = dict(columns or {}), suffix_of(path)
    with reading(path):
        source: FileRows
        if suffix == ".csv":
            source = CsvRows.of(path)
        elif suffix == ".parquet":
            source = ParquetRows.of(path)
        else:
            source = WholeRows.of(path, tuple(topics))
        head = renamed(source.table(0, min(source.rows, 1024)), mapping)
    return Pieces(path, log_name(path, topics), mapping, source, tuple(head.columns))


@dataclass(frozen=True, eq=False)
class ParquetRows(FileRows):
    """FileRows of a Parquet file, of which the row groups that are asked for are read."""

    since: Mapping[str, int]  # first tick of columns of times

    @classmethod
    def of(cls, path: Path) -> ParquetRows:
        """Open a file; raises LogError where it is not Parquet."""
        sha256 = digest(path)
        with parquet_errors(path):
            lazy = pl.scan_parquet(path)
            rows = int(lazy.select(pl.len()).collect().item())
            times = [name for name, kind in lazy.collect_schema().items() if kind.is_temporal()]
            firsts = lazy.select(pl.col(times).drop_nulls().first()).collect()
        return cls(path, rows, sha256, {name: first_tick(firsts[name]) for name in times})

    def table(self, first: int, stop: int, only: Collection[str] | None = None) -> RawTable:
        """Return the rows first … stop - 1."""
        with parquet_errors(self.path):
            lazy = pl.scan_parquet(self.path).slice(first, stop - first)
            if only is not None:
                lazy = lazy.select([name for name in lazy.collect_schema() if name in only])
            frame = lazy.collect()
        return table_of(str(self.path), frame, first=first, since=self.since)


@dataclass(frozen=True, eq=False)
class CsvRows(FileRows):
    """FileRows of a CSV file, of which every STRIDE-th row's place is known.

    Attributes:
        head: the header.
        offset: (k + 1,) [bytes] where rows 0, STRIDE, … begin, and the end of the file.
        line: (k,) number of lines before these rows.
    """

    head: Head
    offset: NDArray[np.int64]
    line: NDArray[np.int64]

    @classmethod
    def of(cls, path: Path) -> CsvRows:
        """Find the places in one pass; raises LogError where the file is no text or has no row."""
        file, sha256 = str(path), hashlib.sha256()
        offsets: list[NDArray[np.int64]] = []
        numbers: list[NDArray[np.int64]] = []
        head: Head | None = None
        at = before = rows = 0
        for text in _blocks(path):
            sha256.update(text)
            begin = 0
            if head is None:
                begin = len(BOM) * text.startswith(BOM)
                head = head_of(text[begin:], file)
                begin += head.end
                refuse_binary(text[:begin], file)
                before = head.line
            refuse_binary(text[begin:], file, before)
            lines = Lines(text[begin:], head.separator)
            every = lines.filled[-rows % STRIDE :: STRIDE]
            offsets.append(lines.start[every] + at + begin)
            numbers.append(every + before)
            at, before, rows = at + len(text), before + len(lines), rows + len(lines.filled)
        head = head or head_of(b"", file)
        if not rows:
            rows_of(b"", head, file, before)
        offset, line = np.append(np.concatenate(offsets), at), np.concatenate(numbers)
        return cls(path, rows, sha256.hexdigest(), head, offset, line)

    def table(self, first: int, stop: int, only: Collection[str] | None = None) -> RawTable:
        """Return the rows first … stop - 1, all columns."""
        i, j = first // STRIDE, min(-(-stop // STRIDE), len(self.line))
        with self.path.open("rb") as stream:
            stream.seek(int(self.offset[i]))
            text = stream.read(int(self.offset[j] - self.offset[i]))
        last = j == len(self.line)
        table = rows_of(text, self.head, str(self.path), int(self.line[i]), last)
        return table.cut(slice(first - i * STRIDE, stop - i * STRIDE))


def _blocks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as stream:
        rest = b""
        while block := stream.read(BLOCK):
            block = rest + block
            end = block.rfind(b"\n") + 1 or block.rfind(b"\r", 0, -1) + 1
            rest = block[end:]
            if end:
                yield block[:end]
        if rest:
            yield rest


@dataclass(frozen=True, eq=False)
class WholeRows(FileRows):
    """FileRows of a file that is read whole: an archive, a bag, a format of another package."""

    topics: tuple[str, ...]

    @classmethod
    def of(cls, path: Path, topics: tuple[str, ...]) -> WholeRows:
        """Open a file."""
        table = _whole(path, topics, path.stat().st_mtime_ns)
        return cls(path, len(next(iter(table.columns.values()), ())), digest(path), topics)

    def table(self, first: int, stop: int, only: Collection[str] | None = None) -> RawTable:
        """Return the rows first … stop - 1, all columns."""
        whole = _whole(self.path, self.topics, self.path.stat().st_mtime_ns)
        return whole.cut(slice(first, stop))


@lru_cache(maxsize=1)
def _whole(path: Path, topics: tuple[str, ...], changed: int) -> RawTable:
    return read_table(path, list(topics))


def likely_rows(path: str | os.PathLike[str]) -> int:
    """Return about how many rows a log has, without reading it; 0 for what it cannot tell.

    Args:
        path: of a file or bag, which need not be there.
    """
    path = Path(path)
    try:
        if path.suffix.lower() == ".parquet":
            return int(pl.scan_parquet(path).select(pl.len()).collect().item())
        if path.suffix.lower() == ".csv":
            with path.open("rb") as stream:
                head = stream.read(HEAD)
            return int(path.stat().st_size * head.count(b"\n") / max(len(head), 1))
        if path.suffix.lower() == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                return len(arrays[arrays.files[0]])
    except Exception:  # whoever reads it says what is wrong with it
        return 0
    return 0
