"""Samples of a CSV file that may still grow, or of standard input, line by line as they come.

A line that is no sample (cut off, another number of cells, no numbers) is reported with its number;
reading goes on.
"""

from __future__ import annotations

import math
import os
import select
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ident.errors import LogError, not_there
from ident.log.csv_text import BOM, Head, head_of, refuse_binary
from ident.log.read import reading
from ident.log.table import EMPTY

PIECE = 1 << 16  # bytes read at once
WAIT = 0.05  # [s] between two looks at what does not grow
HEAD = 1 << 20  # bytes in which the header must be


@dataclass(frozen=True)
class Line:
    """One line below the header.

    Attributes:
        number: from 1.
        sample: its cells by column, NaN where a cell is empty or text; None for no sample.
        why: the reason why it is no sample.
    """

    number: int
    sample: Mapping[str, float] | None
    why: str = ""


def follow(
    path: Path | None, *, grow: bool = False, stop: Callable[[], bool] = lambda: False
) -> Iterator[Line]:
    """Yield the lines of a CSV file or of standard input, as they come.

    Args:
        path: of the file; None: standard input.
        grow: whether to wait for more at the end of the file.
        stop: called again and again; true ends it.

    Yields:
        One line below the header that is not blank.

    Raises:
        LogError: where there is no such file, no header, or the file becomes shorter.
    """
    name = "standard input" if path is None else str(path)
    head: Head | None = None
    rest, number = b"", 0
    for piece in _pieces(path, name, grow, stop):
        rest += piece
        if head is None:
            head, rest = _head(rest, name, whole=not piece)
            if head is None:
                continue
            number = head.line
        *lines, rest = rest.split(b"\n")
        if not piece and rest:  # the end
            lines, rest = [*lines, rest], b""
        for line in lines:
            number += 1
            if line.strip():
                yield _read(line.rstrip(b"\r"), number, head)
    if head is None and not stop():
        head_of(rest, name)


def _head(text: bytes, name: str, whole: bool) -> tuple[Head | None, bytes]:
    """Return the header, once its line is whole, and what follows it; before, None and the text."""
    text = text.removeprefix(BOM)
    refuse_binary(text[: text.rfind(b"\n") + 1], name)
    lines = text.splitlines(keepends=True)
    filled = [line for line in lines if line.strip() and line.lstrip()[:1] != b"#"]
    if not whole and not (filled and filled[0].endswith(b"\n")):
        if len(text) > HEAD:
            raise LogError(
                f"{name}: no header line in its first {HEAD >> 20} MB; is it a CSV file?"
            )
        return None, text
    head = head_of(text, name)
    return head, text[head.end :]


def _read(line: bytes, number: int, head: Head) -> Line:
    cells = line.decode(errors="replace").split(head.separator.decode())
    if len(cells) != len(head.names):
        why = f"{len(cells)} cells, the header has {len(head.names)}"
        return Line(number, None, why + (" (cut off?)" if len(cells) < len(head.names) else ""))
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        values = [_number(cell) for cell in cells]
        if all(map(math.isnan, values)):
            return Line(number, None, "no numbers")
    return Line(number, dict(zip(head.names, values, strict=True)))


def _number(cell: str) -> float:
    cell = cell.strip().strip('"').lower()
    if cell in EMPTY:
        return math.nan
    try:
        return float(cell)
    except ValueError:
        return {"true": 1.0, "false": 0.0}.get(cell, math.nan)


def _pieces(path: Path | None, name: str, grow: bool, stop: Callable[[], bool]) -> Iterator[bytes]:
    """Yield bytes as they come; empty ones at the end, unless stopped."""
    if path is None:
        yield from _of_pipe(sys.stdin.fileno(), stop)
        return
    if not path.exists():
        raise LogError(f"{path}: {not_there(path)}; name a CSV file, or - for standard input")
    with reading(path), path.open("rb", buffering=0) as stream:
        while not stop():
            piece = stream.read(PIECE)
            if piece:
                yield piece
            elif not grow:
                yield b""
                return
            elif os.fstat(stream.fileno()).st_size < stream.tell():
                raise LogError(f"{name}: has become shorter while it was followed; start anew")
            else:
                time.sleep(WAIT)


def _of_pipe(stream: int, stop: Callable[[], bool]) -> Iterator[bytes]:
    while not stop():
        if not select.select([stream], [], [], WAIT)[0]:
            continue
        piece = os.read(stream, PIECE)
        yield piece
        if not piece:
            return
