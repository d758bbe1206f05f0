"""Rows of a file by number, without the rest of it: Parquet by row groups, CSV by byte offsets.

What cannot be read in pieces, an archive or a bag, is read whole, once a process.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ident.errors import LogError
from ident.log.cells import first_tick
from ident.log.csv_file import BOM, Head, head_of, refuse_binary, rows_of
from ident.log.csv_lines import Lines
from ident.log.read import read_whole
from ident.log.table import Table, table_of

BLOCK = 1 << 24  # bytes of a text that are looked at together
STRIDE = 1024  # rows of a CSV file from one offset that is kept to the next


class Source(Protocol):
    """A file whose rows can be had by number."""

    @property
    def rows(self) -> int:
        """In all."""

    @property
    def sha256(self) -> str:
        """Of the file's bytes."""

    def table(self, first: int, stop: int, only: Collection[str] | None) -> Table:
        """The rows first … stop − 1; of the columns `only`, if that saves work."""


@dataclass(frozen=True)
class ParquetSource:
    """A Parquet file, of which the row groups that are asked for are read."""

    path: Path
    rows: int
    sha256: str
    since: Mapping[str, int]  # first tick of columns of times

    @classmethod
    def of(cls, path: Path) -> ParquetSource:
        """Raises LogError where the file is not Parquet."""
        sha256 = _digest(path)
        try:
            lazy = pl.scan_parquet(path)
            kinds = lazy.collect_schema()
            rows = int(lazy.select(pl.len()).collect().item())
            times = [name for name, kind in kinds.items() if kind.is_temporal()]
            heads = {
                name: lazy.select(pl.col(name).drop_nulls().head(1)).collect().to_series()
                for name in times
            }
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
            raise _no_parquet(path) from error
        return cls(path, rows, sha256, {name: first_tick(head) for name, head in heads.items()})

    def table(self, first: int, stop: int, only: Collection[str] | None) -> Table:
        """The rows first … stop − 1."""
        try:
            lazy = pl.scan_parquet(self.path).slice(first, stop - first)
            if only is not None:
                lazy = lazy.select([name for name in lazy.collect_schema() if name in only])
            frame = lazy.collect()
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
            raise _no_parquet(self.path) from error
        return table_of(str(self.path), frame, first=first, since=self.since)


def _no_parquet(path: Path) -> LogError:
    return LogError(f"{path}: not a Parquet file, or a damaged one; write it again")


@dataclass(frozen=True, eq=False)
class CsvSource:
    """A CSV file, of which every STRIDE-th row's place is known.

    Attributes:
        head: of the file.
        rows: that are not blank; size: bytes.
        offset, line: (k,) where rows 0, STRIDE, … begin, and how many lines are before them.
    """

    path: Path
    head: Head
    rows: int
    sha256: str
    offset: NDArray[np.int64]
    line: NDArray[np.int64]
    size: int

    @classmethod
    def of(cls, path: Path) -> CsvSource:
        """The places found in one pass; raises LogError where the file is no text or has no row."""
        file, digest = str(path), hashlib.sha256()
        offsets: list[NDArray[np.int64]] = []
        numbers: list[NDArray[np.int64]] = []
        head: Head | None = None
        at = before = rows = 0
        for text in _texts(path):
            digest.update(text)
            begin = 0
            if head is None:
                begin = len(BOM) * text.startswith(BOM)
                head = head_of(text[begin:], file)
                begin += head.end
                refuse_binary(text[:begin], file)
                before = head.line
            refuse_binary(text[begin:], file, before)
            lines = Lines.of(text[begin:], head.separator)
            kept = lines.filled[-rows % STRIDE :: STRIDE]
            offsets.append(lines.start[kept] + at + begin)
            numbers.append(kept + before)
            at, before, rows = at + len(text), before + len(lines), rows + len(lines.filled)
        head = head or head_of(b"", file)
        if not rows:
            rows_of(b"", head, file, before)
        offset, line = np.concatenate(offsets), np.concatenate(numbers)
        return cls(path, head, rows, digest.hexdigest(), offset, line, at)

    def table(self, first: int, stop: int, only: Collection[str] | None) -> Table:
        """The rows first … stop − 1, all columns."""
        i, j = first // STRIDE, -(-stop // STRIDE)
        end = int(self.offset[j]) if j < len(self.offset) else self.size
        with self.path.open("rb") as stream:
            stream.seek(int(self.offset[i]))
            text = stream.read(end - int(self.offset[i]))
        last = j >= len(self.offset)
        found = rows_of(text, self.head, str(self.path), int(self.line[i]), last)
        return cut(found, slice(first - i * STRIDE, stop - i * STRIDE))


@dataclass(frozen=True)
class WholeSource:
    """A file that is read whole: an archive or a bag."""

    path: Path
    topics: tuple[str, ...]

    @property
    def rows(self) -> int:
        """In all."""
        return len(next(iter(self._read[0].columns.values()), ()))

    @property
    def sha256(self) -> str:
        """Of the file's bytes."""
        return self._read[1]

    @property
    def _read(self) -> tuple[Table, str]:
        return _whole(self.path, self.topics, self.path.stat().st_mtime_ns)

    def table(self, first: int, stop: int, only: Collection[str] | None) -> Table:
        """The rows first … stop − 1, all columns."""
        return cut(replace(self._read[0], first=first), slice(first, stop))


@lru_cache(maxsize=1)
def _whole(path: Path, topics: tuple[str, ...], changed: int) -> tuple[Table, str]:
    return read_whole(path, list(topics))


def cut(table: Table, part: slice) -> Table:
    """Some rows of a table."""
    columns = {name: x[part] for name, x in table.columns.items()}
    lines = None if table.lines is None else table.lines[part]
    return replace(table, columns=columns, lines=lines)


def _texts(path: Path) -> Iterator[bytes]:
    """A text file in blocks of whole lines."""
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


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
