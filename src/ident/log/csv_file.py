"""CSV to a table, keeping each row's line number: the file's own text is what errors point to."""

from __future__ import annotations

import io
import re
from typing import BinaryIO

import numpy as np
import polars as pl

from ident.errors import LogError
from ident.log.table import Table, table_of

BOM = b"\xef\xbb\xbf"
SEPARATORS = {b",": "','", b";": "';'", b"\t": "tab"}
MISQUOTED = "quotes inside cells that do not enclose the whole cell; remove or double them"
QUOTED = re.compile(rb'"[^"]*"')
NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*")


def read_csv(stream: BinaryIO, file: str) -> Table:
    """The columns of a CSV file; raises LogError where it is not one, or its rows are ragged."""
    raw = stream.read().removeprefix(BOM)
    _refuse_binary(raw, file)
    lines = raw.splitlines()
    top = next(
        (i for i, line in enumerate(lines) if line.strip() and line.lstrip()[:1] != b"#"), None
    )
    if top is None:
        raise LogError(f"{file}: the file is empty; a header line and rows of numbers are needed")
    separator = _separator(lines[top], f"{file}: line {top + 1}")
    header = _header(lines, top, separator, file)
    filled = [i for i in range(top + 1, len(lines)) if lines[i].strip(b" ")]
    if not filled:
        raise LogError(
            f"{file}: a header on line {top + 1} and no rows; rows of numbers are needed"
        )
    _refuse_ragged(lines, filled, separator, len(header), file)

    frame = _frame(b"\n".join([lines[i] for i in filled]), separator, file)
    if frame.shape != (len(filled), len(header)):
        raise LogError(f"{file}: {MISQUOTED}")
    blank = np.setdiff1d(np.arange(top + 1, filled[-1]), filled) + 1
    notes = [f"{blank.size} blank lines left out, first at line {blank[0]}"] if blank.size else []
    series = [column.alias(name) for name, column in zip(header, frame, strict=True)]
    return table_of(file, series, np.array(filled) + 1, notes)


def _frame(text: bytes, separator: bytes, file: str) -> pl.DataFrame:
    """Rows of text as strings, unread: what a cell says is decided column by column later."""
    try:
        return pl.read_csv(
            io.BytesIO(text), has_header=False, infer_schema=False, separator=separator.decode()
        )
    except pl.exceptions.PolarsError as error:
        raise LogError(f"{file}: {MISQUOTED}") from error


def _refuse_binary(raw: bytes, file: str) -> None:
    try:
        raw.decode()
        at = raw.find(b"\0")
    except UnicodeDecodeError as error:
        at = error.start
    if at >= 0:
        line = raw.count(b"\n", 0, at) + 1
        raise LogError(
            f"{file}: byte 0x{raw[at]:02x} in line {line} is not text; "
            "a .csv file must be text in UTF-8"
        )


def _separator(header: bytes, place: str) -> bytes:
    bare = QUOTED.sub(b"", header)
    best = max(SEPARATORS, key=bare.count)
    if best not in bare and re.search(rb"[\s|]", bare.strip()):
        valid = ", ".join(SEPARATORS.values())
        raise LogError(f"{place}: no separator between the column names; valid: {valid}")
    return best


def _header(lines: list[bytes], top: int, separator: bytes, file: str) -> list[str]:
    if lines[top].count(b'"') % 2:
        raise LogError(f"{file}: line {top + 1}: a quote is opened and not closed; close it")
    names = [name or "" for name in _frame(lines[top], separator, file).row(0)]
    if all(NUMBER.fullmatch(name) for name in names):
        hint = "name the columns in the first line: t, q.<joint>, ..."
        commented = lines[top - 1] if top else b""
        if commented.lstrip()[:1] == b"#" and commented.count(separator) == len(names) - 1:
            hint = f"line {top} looks like one behind its '#': remove that"  # as np.savetxt writes
        raise LogError(f"{file}: line {top + 1} holds numbers where the header should be; {hint}")
    return names


def _refuse_ragged(
    lines: list[bytes], rows: list[int], separator: bytes, width: int, file: str
) -> None:
    """Polars fills short rows with nulls, in silence; here they are counted."""
    for i in rows:
        line = lines[i]
        if b'"' in line:
            if line.count(b'"') % 2:
                raise LogError(f"{file}: line {i + 1}: a quote is opened and not closed; close it")
            line = QUOTED.sub(b"", line)
        cells = line.count(separator) + 1
        if cells != width:
            cut = " (the last line, cut off while it was written? delete it)"
            raise LogError(
                f"{file}: line {i + 1} has {cells} cells, the header has {width}"
                f"{cut if i == rows[-1] and cells < width else ''}; "
                "every row needs as many cells as the header"
            )
