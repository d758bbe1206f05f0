"""CSV to a table, keeping each row's line number: the file's own text is what errors point to."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
import polars as pl

from ident.errors import LogError
from ident.log.csv_lines import QUOTED, Lines
from ident.log.table import Table, table_of

BOM = b"\xef\xbb\xbf"
SEPARATORS = {b",": "','", b";": "';'", b"\t": "tab"}
MISQUOTED = "quotes inside cells that do not enclose the whole cell; remove or double them"
NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*")
LINE = re.compile(rb"([^\r\n]*)(\r\n|\r|\n|\Z)")


@dataclass(frozen=True)
class Head:
    """The top of a CSV file.

    Attributes:
        names: of the columns, as written.
        separator: of the cells.
        line: the header's, from 1.
        end: where the rows begin, in bytes behind a byte order mark.
    """

    names: tuple[str, ...]
    separator: bytes
    line: int
    end: int


def read_csv(stream: BinaryIO, file: str) -> Table:
    """The columns of a CSV file; raises LogError where it is not one, or its rows are ragged."""
    raw = stream.read().removeprefix(BOM)
    refuse_binary(raw, file)
    head = head_of(raw, file)
    return rows_of(raw[head.end :], head, file, head.line)


def head_of(raw: bytes, file: str) -> Head:
    """The header of a text that begins as the file does; raises LogError where it has none."""
    before = b""
    for number, found in enumerate(LINE.finditer(raw), start=1):
        line = found[1]
        if line.strip() and line.lstrip()[:1] != b"#":
            separator = _separator(line, f"{file}: line {number}")
            names = _header(line, before, number, separator, file)
            return Head(tuple(names), separator, number, found.end())
        before = line
    raise LogError(f"{file}: the file is empty; a header line and rows of numbers are needed")


def rows_of(text: bytes, head: Head, file: str, before: int, last: bool = True) -> Table:
    """The columns of some whole lines of a CSV file below its header.

    Args:
        text: the lines.
        head: of the file.
        file: what messages call it.
        before: lines of the file before these.
        last: whether the file ends with them.

    Raises:
        LogError: where rows are ragged, a cell is no number, or there is no row.
    """
    lines, width = Lines.of(text, head.separator), len(head.names)
    filled = lines.filled
    if not len(filled):
        raise LogError(
            f"{file}: a header on line {head.line} and no rows; rows of numbers are needed"
        )
    lines.refuse_ragged(head.separator, width, file, before, last)
    frame = _values(lines, head, file)
    if frame.shape != (len(filled), width):
        raise LogError(f"{file}: {MISQUOTED}")
    blank = np.setdiff1d(np.arange(filled[-1]), filled) + before + 1
    notes = [f"{blank.size} blank lines left out, first at line {blank[0]}"] if blank.size else []
    series = [column.alias(name) for name, column in zip(head.names, frame, strict=True)]
    return table_of(file, series, filled + before + 1, notes)


def refuse_binary(raw: bytes, file: str, before: int = 0) -> None:
    """Raise LogError at a byte that is no text; `before`: lines of the file before these."""
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


def _values(lines: Lines, head: Head, file: str) -> pl.DataFrame:
    """Columns that begin with a number as numbers, if that is what they are; else as text, of which
    column by column is decided later what it says.
    """
    rows = lines.rows
    first = _frame(lines[lines.filled[0]], head.separator, file).row(0)
    kinds = {
        f"column_{i}": pl.Float64 if cell and NUMBER.fullmatch(cell) else pl.String
        for i, cell in enumerate(first, start=1)
    }
    try:
        return pl.read_csv(rows, has_header=False, schema=kinds, separator=head.separator.decode())
    except pl.exceptions.PolarsError:
        return _frame(rows, head.separator, file)


def _frame(text: bytes, separator: bytes, file: str) -> pl.DataFrame:
    """Rows of text as strings, unread."""
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
