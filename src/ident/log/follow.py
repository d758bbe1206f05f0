"""Samples of a CSV file that may still grow, or of standard input, as they come.

All lines that have come are taken together, since parsing is the least of what one line takes. A
line that is no sample (cut off, another number of cells, no numbers) is reported with its number;
reading goes on.
"""

from __future__ import annotations

import math
import os
import select
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ident.errors import LogError, missing_file
from ident.log.read import file_errors
from ident.log.storage import BOM, Head, head_of, refuse_binary
from ident.log.table import EMPTY

PIECE = 1 << 16  # bytes read at once
WAIT = 0.05  # [s] between two looks at what does not grow
HEAD = 1 << 20  # bytes in which the header must be


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

    `grow` waits for more at the end of the file; `stop` is called again and again, true ends it.
    """
    name = "standard input" if path is None else str(path)
    pieces = _pipe_pieces(stop) if path is None else _file_pieces(path, grow, stop)
    head: Head | None = None
    rest, number = b"", 0
    for piece in pieces:
        rest += piece
        end = not piece
        if head is None:
            head = _head(rest, name, end)
            if head is None:
                continue
            rest, number = rest.removeprefix(BOM)[head.end :], head.line
        *lines, rest = rest.split(b"\n")
        if end and rest:
            lines.append(rest)
        filled = [(i, line) for i, line in enumerate(lines, number + 1) if line.strip()]
        number += len(lines)
        if filled:
            yield _parsed(filled, head)
    if head is None and not stop():
        head_of(rest, name)


def _head(text: bytes, name: str, end: bool) -> Head | None:
    text = text.removeprefix(BOM)
    refuse_binary(text[: text.rfind(b"\n") + 1], name)
    filled = [x for x in text.splitlines(keepends=True) if x.strip() and x.lstrip()[:1] != b"#"]
    if end or (filled and filled[0].endswith(b"\n")):
        return head_of(text, name)
    if len(text) > HEAD:
        raise LogError(f"{name}: no header line in its first {HEAD >> 20} MB; is it a CSV file?")
    return None


def _parsed(lines: Sequence[tuple[int, bytes]], head: Head) -> CsvLines:
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
        try:
            values = [*map(float, cells)]
        except ValueError:
            text = [cell.decode(errors="replace").strip().strip('"').lower() for cell in cells]
            values = [_number(cell) for cell in text]
            if all(map(math.isnan, values)):
                bad.append((number, "no numbers"))
                continue
        numbers.append(number)
        rows.append(values)
    X = np.array(rows).reshape(len(rows), width)
    columns = dict(zip(head.names, X.T, strict=True))
    return CsvLines(np.array(numbers, dtype=int), columns, tuple(bad))


def _number(cell: str) -> float:
    try:
        return math.nan if cell in EMPTY else float(cell)
    except ValueError:
        return {"true": 1.0, "false": 0.0}.get(cell, math.nan)


def _file_pieces(path: Path, grow: bool, stop: Callable[[], bool]) -> Iterator[bytes]:
    if not path.exists():
        raise LogError(f"{path}: {missing_file(path)}; name a CSV file, or - for standard input")
    with file_errors(path), path.open("rb", buffering=0) as stream:
        while not stop():
            piece = stream.read(PIECE)
            if piece or not grow:
                yield piece
                if not piece:
                    return
            elif os.fstat(stream.fileno()).st_size < stream.tell():
                raise LogError(f"{path}: has become shorter while it was followed; start anew")
            else:
                time.sleep(WAIT)


def _pipe_pieces(stop: Callable[[], bool]) -> Iterator[bytes]:
    stream = sys.stdin.fileno()
    while not stop():
        if select.select([stream], [], [], WAIT)[0]:
            piece = os.read(stream, PIECE)
            yield piece
            if not piece:
                return
