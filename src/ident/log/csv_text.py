"""CSV to a table in which each row keeps the number of its line, to which error messages point.

polars parses the cells. It fills short rows up in silence and counts no lines, hence `Lines`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ident.errors import LogError
from ident.log.table import RawTable, table_of

BOM = b"\xef\xbb\xbf"
SEPARATORS = {b",": "','", b";": "';'", b"\t": "tab"}
MISQUOTED = "quotes inside cells that do not enclose the whole cell; remove or double them"
NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*")
LINE = re.compile(rb"([^\r\n]*)(\r\n|\r|\n|\Z)")
QUOTED = re.compile(rb'"[^"]*"')
NEWLINE, RETURN, QUOTE = b'\n\r"'


@dataclass(frozen=True)
class Head:
    """The top of a CSV file."""

    names: tuple[str, ...]  # of the columns, as written
    separator: bytes  # of the cells
    line: int  # the header's, from 1
    end: int  # where the rows begin, in bytes behind a byte order mark


class Lines:
    r"""The lines of a text; `\n`, `\r\n` and `\r` end one.

    Attributes:
        text: of the lines.
        start: (n + 1,) where each begins; the end of the text is the last.
        cells: (n,) one more than the separators in each, quoted ones included.
        quotes: (n,) quotes in each.
        filled: (m,) which lines hold more than blanks.
    """

    def __init__(self, text: bytes, separator: bytes) -> None:
        data = np.frombuffer(text, dtype=np.uint8)
        ends = data == NEWLINE
        if b"\r" in text:
            ends |= (data == RETURN) & (np.append(data[1:], 0) != NEWLINE)
        start = np.concatenate([[0], np.flatnonzero(ends) + 1]).astype(np.int64)
        self.text = text
        self.start = start if start[-1] == len(text) else np.append(start, len(text))
        self.cells = self._count(data == separator[0]) + 1
        self.quotes = self._count(data == QUOTE) if b'"' in text else np.zeros_like(self.cells)
        blank = [i for i in np.flatnonzero(self.cells == 1) if not self[i].strip(b" ")]
        self.filled = np.delete(np.arange(len(self.cells)), blank)

    def _count(self, mark: NDArray[np.bool_]) -> NDArray[np.int64]:
        return np.diff(np.searchsorted(np.flatnonzero(mark), self.start))

    def __len__(self) -> int:
        return len(self.cells)

    def __getitem__(self, i: int | np.integer) -> bytes:
        return self.text[self.start[i] : self.start[i + 1]].rstrip(b"\r\n")

    @property
    def rows(self) -> bytes:
        """The filled lines alone, separated by newlines."""
        if len(self.filled) < len(self):
            return b"\n".join([self[i] for i in self.filled])
        if b"\r" in self.text:
            return self.text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        return self.text


def read_csv(path: Path) -> RawTable:
    """Read the columns of a CSV file; raises LogError where it is not one, or rows are ragged."""
    with path.open("rb") as stream:
        raw = stream.read().removeprefix(BOM)
    refuse_binary(raw, str(path))
    head = head_of(raw, str(path))
    return rows_of(raw[head.end :], head, str(path), head.line)


def head_of(raw: bytes, file: str) -> Head:
    """Return the header of a text that begins as the file does; raises LogError for none."""
    before = b""
    for number, match in enumerate(LINE.finditer(raw), start=1):
        line = match[1]
        if line.strip() and line.lstrip()[:1] != b"#":
            separator = _separator(line, f"{file}: line {number}")
            names = _header(line, before, number, separator, file)
            return Head(tuple(names), separator, number, match.end())
        before = line
    raise LogError(f"{file}: the file is empty; a header line and rows of numbers are needed")


def rows_of(text: bytes, head: Head, file: str, before: int, last: bool = True) -> RawTable:
    """Return the columns of some whole lines of a CSV file below its header.

    `before` is the number of lines of the file before these, `last` whether it ends with them.
    """
    lines, width = Lines(text, head.separator), len(head.names)
    filled = lines.filled
    if not len(filled):
        raise LogError(
            f"{file}: a header on line {head.line} and no rows; rows of numbers are needed"
        )
    for i in filled[(lines.cells[filled] != width) | (lines.quotes[filled] > 0)]:
        _check_row(lines[i], head, f"{file}: line {before + i + 1}", last and i == filled[-1])
    frame = _values(lines, head, file)
    if frame.shape != (len(filled), width):
        raise LogError(f"{file}: {MISQUOTED}")
    notes = []
    if blank := int(filled[-1]) + 1 - len(filled):
        first = int((filled != np.arange(len(filled))).argmax()) + before + 1
        notes.append(f"{blank} blank lines left out, first at line {first}")
    series = [column.alias(name) for name, column in zip(head.names, frame, strict=True)]
    return table_of(file, series, filled + before + 1, notes)


def refuse_binary(raw: bytes, file: str, before: int = 0) -> None:
    """Raise LogError at a byte that is no text; `before` counts the lines before these."""
    try:
        if not raw.isascii():
            raw.decode()
        at = raw.find(b"\0")
    except UnicodeDecodeError as error:
        at = error.start
    if at >= 0:
        line = raw.count(b"\n", 0, at) + before + 1
        raise LogError(
            f"{file}: byte 0x{raw[at]:02x} in line {line} is not text; "
            "a .csv file must be text in UTF-8"
        )


def _check_row(line: bytes, head: Head, place: str, last: bool) -> None:
    if line.count(b'"') % 2:
        raise LogError(f"{place}: a quote is opened and not closed; close it")
    cells, width = QUOTED.sub(b"", line).count(head.separator) + 1, len(head.names)
    if cells != width:
        cut = " (the last line, cut off while it was written? delete it)"
        raise LogError(
            f"{place} has {cells} cells, the header has {width}"
            f"{cut if last and cells < width else ''}; every row needs as many cells as the header"
        )


def _values(lines: Lines, head: Head, file: str) -> pl.DataFrame:
    first = _frame(lines[lines.filled[0]], head.separator, file).row(0)
    kinds = {
        f"column_{i}": pl.Float64 if cell and NUMBER.fullmatch(cell) else pl.String
        for i, cell in enumerate(first, start=1)
    }
    separator = head.separator.decode()
    try:
        return pl.read_csv(lines.rows, has_header=False, schema=kinds, separator=separator)
    except pl.exceptions.PolarsError:
        return _frame(lines.rows, head.separator, file)


def _frame(text: bytes, separator: bytes, file: str) -> pl.DataFrame:
    try:
        return pl.read_csv(text, has_header=False, infer_schema=False, separator=separator.decode())
    except pl.exceptions.PolarsError as error:
        raise LogError(f"{file}: {MISQUOTED}") from error


def _separator(header: bytes, place: str) -> bytes:
    bare = QUOTED.sub(b"", header)
    best = max(SEPARATORS, key=bare.count)
    if best not in bare and re.search(rb"[\s|]", bare.strip()):
        valid = ", ".join(SEPARATORS.values())
        raise LogError(f"{place}: no separator between the column names; valid: {valid}")
    return best


def _header(line: bytes, before: bytes, number: int, separator: bytes, file: str) -> list[str]:
    if line.count(b'"') % 2:
        raise LogError(f"{file}: line {number}: a quote is opened and not closed; close it")
    names = [name or "" for name in _frame(line, separator, file).row(0)]
    if all(NUMBER.fullmatch(name) for name in names):
        hint = "name the columns in the first line: t, q.<joint>, ..."
        if before.lstrip()[:1] == b"#" and before.count(separator) == len(names) - 1:
            hint = f"line {number - 1} looks like one behind its '#': remove that"  # np.savetxt
        raise LogError(f"{file}: line {number} holds numbers where the header should be; {hint}")
    return names
