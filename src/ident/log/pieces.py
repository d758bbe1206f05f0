"""Logs that come in pieces: opened and not read, or still growing.

polars reads Parquet by row groups. It cannot start in the middle of a CSV file, so the place of
every STRIDE-th row is kept. Archives, bags and formats of other packages are read whole, once a
process.

Of a CSV file that may still grow, or of standard input, all lines that have come are taken
together, since parsing is the least of what one line takes. A line that is no sample (cut off,
another number of cells, no numbers) is reported with its number; reading goes on.
"""

from __future__ import annotations

import hashlib
import math
import os
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ident.errors import LogError, missing_file
from ident.files import regular
from ident.lazy import lazy
from ident.log import storage
from ident.log.log import Log
from ident.log.read import LogFile, file_errors, log_file
from ident.log.table import EMPTY, Column, RawTable, first_tick, renamed, table_of

if TYPE_CHECKING:
    import polars as pl
else:
    pl = lazy("polars")

BLOCK = 1 << 24  # work: bytes of a text that are in memory together
GROUP = 1 << 16  # work: rows of a Parquet file up to a multiple of which is read
STRIDE = 1024  # work: rows of a CSV file from one kept place to the next

Rows = Callable[[int, int], RawTable]  # table(first, stop): rows first … stop - 1


@dataclass(frozen=True, eq=False)
class Pieces:
    """A recorded experiment on disk, opened by `open_log`."""

    path: Path
    name: str  # in messages and tables
    mapping: Mapping[str, Column]  # ident's names to the file's columns
    rows: int  # of the file, repeated time stamps among them
    sha256: str  # of the file's bytes
    table: Rows
    columns: tuple[str, ...]  # ident's names of all columns of numbers, t among them

    def piece(self, first: int, stop: int) -> Log:
        """Return the samples of ten rows or more, first … stop - 1, as `read_log` would."""
        with file_errors(self.path):
            table = self.table(first, min(stop, self.rows))
        if other := sorted(set(renamed(table, self.mapping).columns) ^ set(self.columns)):
            raise LogError(
                f"{self.path}: column {other[0]!r} holds numbers in some rows and text in others "
                f"(from {table.where(0)} on); leave cells empty where there is no value"
            )
        return Log.from_table(self.name, table, self.mapping, self.sha256, poses=False)


def open_log(path: str | os.PathLike[str], columns: Mapping[str, Column] | None = None) -> Pieces:
    """Open a log as `read_log` reads it; rows of CSV and Parquet files stay on disk.

    A text file is read once, to know where rows begin.
    """
    source, mapping = log_file(path, None), dict(columns or {})
    suffix = source.path.suffix.lower()
    with file_errors(source.path):
        regular(source.path)
        if suffix == ".csv":
            rows, sha256, table = _open_csv(source.path)
        elif suffix == ".parquet":
            (rows, table), sha256 = _open_parquet(source.path), source.sha256()
        else:
            entire = _entire(source, source.path.stat().st_mtime_ns)
            rows, sha256 = len(next(iter(entire.columns.values()), ())), source.sha256()
            table = partial(_rows_of_whole, source)
        names = tuple(renamed(table(0, min(rows, STRIDE)), mapping).columns)
    return Pieces(source.path, source.name, mapping, rows, sha256, table, names)


def _open_parquet(path: Path) -> tuple[int, Rows]:
    with storage.parquet_errors(path):
        lazy = pl.scan_parquet(path)
        rows = int(lazy.select(pl.len()).collect().item())
        times = [name for name, kind in lazy.collect_schema().items() if kind.is_temporal()]
        firsts = lazy.select(pl.col(times).drop_nulls().first()).collect()
    since = {name: first_tick(firsts[name]) for name in times}
    return rows, partial(_rows_of_parquet, path, since, LastFrame())


def _rows_of_parquet(
    path: Path, since: Mapping[str, int], last: LastFrame, first: int, stop: int
) -> RawTable:
    with storage.parquet_errors(path):
        frame = last.rows(path, first, stop)
    return table_of(str(path), frame, first=first, since=since)


class LastFrame(threading.local):
    """The rows of a Parquet file that a thread read last, of which the next piece needs the end."""

    def __init__(self) -> None:
        self.version: tuple[int, ...] = ()  # of the file
        self.first = 0
        self.frame: pl.DataFrame | None = None

    def __reduce__(self) -> tuple[type[LastFrame], tuple[()]]:
        return LastFrame, ()  # a copy in another process starts empty

    def __repr__(self) -> str:
        return "LastFrame()"  # the same in each process: a run that goes on compares what it reads

    def rows(self, path: Path, first: int, stop: int) -> pl.DataFrame:
        """Return rows first … stop - 1 of a file; a group of rows that was read is not read again,
        as long as pieces follow each other.
        """
        state, ahead = path.stat(), -(-stop // GROUP) * GROUP
        version = state.st_ino, state.st_size, state.st_mtime_ns
        before = self.frame if version == self.version else None
        end = self.first + len(before) if before is not None else 0
        if before is None or not self.first <= first <= end:
            frame = pl.scan_parquet(path).slice(first, ahead - first).collect()
        elif stop <= end:
            return before.slice(first - self.first, stop - first)
        else:
            more = pl.scan_parquet(path).slice(end, ahead - end).collect()
            frame = pl.concat([before.slice(first - self.first), more])
        self.version, self.first, self.frame = version, first, frame
        return frame.slice(0, stop - first)


def _open_csv(path: Path) -> tuple[int, str, Rows]:
    file, sha256 = str(path), hashlib.sha256()
    offsets: list[NDArray[np.int64]] = []  # [bytes] where rows 0, STRIDE, … begin, and the end
    numbers: list[NDArray[np.int64]] = []  # of lines before these rows
    head: storage.Head | None = None
    at = before = rows = 0
    with path.open("rb") as stream:
        while block := stream.readlines(BLOCK):
            text, begin = b"".join(block), 0
            sha256.update(text)
            if head is None:
                begin = len(storage.BOM) * text.startswith(storage.BOM)
                head = storage.head_of(text[begin:], file)
                begin += head.end
                storage.refuse_binary(text[:begin], file)
                before = head.line
            storage.refuse_binary(text[begin:], file, before)
            lines = text[begin:].splitlines(keepends=True)
            filled, start = storage.filled_lines(lines), np.cumsum([begin, *map(len, lines)])
            every = filled[-rows % STRIDE :: STRIDE]
            offsets.append(start[every] + at)
            numbers.append(every + before)
            at, before, rows = at + len(text), before + len(lines), rows + len(filled)
    head = head or storage.head_of(b"", file)
    if not rows:
        storage.rows_of(b"", head, file, before)
    offset, line = np.append(np.concatenate(offsets), at), np.concatenate(numbers)
    return rows, sha256.hexdigest(), partial(_rows_of_csv, path, head, offset, line)


def _rows_of_csv(
    path: Path,
    head: storage.Head,
    offset: NDArray[np.int64],
    line: NDArray[np.int64],
    first: int,
    stop: int,
) -> RawTable:
    i, j = first // STRIDE, min(-(-stop // STRIDE), len(line))
    with path.open("rb") as stream:
        stream.seek(int(offset[i]))
        text = stream.read(int(offset[j] - offset[i]))
    table = storage.rows_of(text, head, str(path), int(line[i]), j == len(line))
    return table.cut(slice(first - i * STRIDE, stop - i * STRIDE))


def _rows_of_whole(file: LogFile, first: int, stop: int) -> RawTable:
    return _entire(file, file.path.stat().st_mtime_ns).cut(slice(first, stop))


@lru_cache(maxsize=1)
def _entire(file: LogFile, changed: int) -> RawTable:
    return file.table()


PIECE = 1 << 16  # work: bytes read at once
WAIT = 0.05  # work: [s] between two looks at what does not grow
HEADER = 1 << 20  # work: bytes in which the header must be


@dataclass(frozen=True, eq=False)
class CsvLines:
    """Lines below the header that came together."""

    numbers: np.ndarray  # (n,) of the samples' lines, from 1
    columns: Mapping[str, np.ndarray]  # their cells (n,), NaN where one is empty or text
    bad: tuple[tuple[int, str], ...]  # (number, why) of the lines that are no samples

    def __len__(self) -> int:
        return len(self.numbers)

    def part(self, which: slice) -> CsvLines:
        """Return some of the samples, without the bad lines."""
        columns = {name: x[which] for name, x in self.columns.items()}
        return CsvLines(self.numbers[which], columns, ())


def follow(
    path: Path | None, *, grow: bool = False, stop: Callable[[], bool] = lambda: False
) -> Iterator[CsvLines]:
    """Yield the lines of a CSV file, or of standard input for None, as they come, no blank ones.

    `grow` waits for more at the end of the file; a true `stop` ends it.
    """
    name = "standard input" if path is None else str(path)
    head: storage.Head | None = None
    rest, number = b"", 0
    for piece in _pieces(path, grow, stop):
        rest += piece
        end = not piece
        if head is None:
            head = _head(rest, name, end)
            if head is None:
                continue
            rest, number = rest.removeprefix(storage.BOM)[head.end :], head.line
        *lines, rest = rest.split(b"\n")
        if end and rest:
            lines.append(rest)
        filled = [(i, line) for i, line in enumerate(lines, number + 1) if line.strip()]
        number += len(lines)
        if filled:
            yield _parsed(filled, head)
    if head is None and not stop():
        storage.head_of(rest, name)


def _head(text: bytes, name: str, end: bool) -> storage.Head | None:
    text = text.removeprefix(storage.BOM)
    storage.refuse_binary(text[: text.rfind(b"\n") + 1], name)
    filled = [x for x in text.splitlines(keepends=True) if x.strip() and x.lstrip()[:1] != b"#"]
    if end or (filled and filled[0].endswith(b"\n")):
        return storage.head_of(text, name)
    if len(text) > HEADER:
        raise LogError(f"{name}: no header line in its first {HEADER >> 20} MB; is it a CSV file?")
    return None


def _parsed(lines: Sequence[tuple[int, bytes]], head: storage.Head) -> CsvLines:
    """Parse numbered lines."""
    width, separator = len(head.names), head.separator
    numbers: list[int] = []
    rows: list[list[float]] = []
    bad: list[tuple[int, str]] = []
    for number, line in lines:
        cells = line.split(separator)
        if len(cells) != width:
            why = f"{len(cells)} cells, the header has {width}"
            bad.append((number, why + (" (cut off?)" if len(cells) < width else "")))
            continue
        values = [*map(_number, cells)]
        if all(map(math.isnan, values)):
            bad.append((number, "no numbers"))
            continue
        numbers.append(number)
        rows.append(values)
    X = np.array(rows).reshape(len(rows), width)
    columns = dict(zip(head.names, X.T, strict=True))
    return CsvLines(np.array(numbers, dtype=int), columns, tuple(bad))


def _number(cell: bytes) -> float:
    try:
        return float(cell)
    except ValueError:
        text = cell.decode(errors="replace").strip().strip('"').lower()
    try:
        return math.nan if text in EMPTY else float(text)
    except ValueError:
        return {"true": 1.0, "false": 0.0}.get(text, math.nan)


def _pieces(path: Path | None, grow: bool, stop: Callable[[], bool]) -> Iterator[bytes]:
    """Yield bytes as they come, at the end none once; from standard input for no path."""
    if path is not None and not path.exists():
        raise LogError(f"{path}: {missing_file(path)}; name a CSV file, or - for standard input")
    given = sys.stdin.fileno() if path is None else path
    with file_errors(path or Path("-")), open(given, "rb", 0, closefd=path is not None) as stream:
        while not stop():
            if path is None and not select.select([stream], [], [], WAIT)[0]:
                continue
            piece = stream.read(PIECE)
            if piece or path is None or not grow:
                yield piece
                if not piece:
                    return
            elif os.fstat(stream.fileno()).st_size < stream.tell():
                raise LogError(f"{path}: has become shorter while it was followed; start anew")
            else:
                time.sleep(WAIT)
