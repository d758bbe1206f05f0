"""Files of columns read and written: CSV, Parquet, NumPy archives.

Each row of a CSV keeps the number of its line, to which error messages point. polars parses the
cells; it fills short rows up in silence and counts no lines, so these are counted before.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ident.errors import LogError
from ident.files import atomic_write, check_size
from ident.lazy import lazy
from ident.log.table import Array, RawTable, check_name, table_of, table_of_arrays

if TYPE_CHECKING:
    import polars as pl
else:
    pl = lazy("polars")

BOM = b"\xef\xbb\xbf"
SEPARATORS = {b",": "','", b";": "';'", b"\t": "tab"}
MISQUOTED = "quotes inside cells that do not enclose the whole cell; remove or double them"
NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*")
LINE = re.compile(rb"([^\r\n]*)(\r\n|\r|\n|\Z)")
PLAIN = b"0123456789+-.eE,\n"  # of a file of numbers alone
MOST_ARRAYS = 5000  # work: of an archive, each of which is opened
SMALL = 2_000_000  # work: bytes of a file that is read before polars would be imported
QUOTED = re.compile(rb'"[^"]*"')


@dataclass(frozen=True)
class Head:
    """The top of a CSV file."""

    names: tuple[str, ...]  # of the columns, as written
    separator: bytes  # of the cells
    line: int  # the header's, from 1
    end: int  # where the rows begin, in bytes behind a byte order mark


def read_csv(path: Path) -> RawTable:
    """Read the columns of a CSV file; raises LogError where it is not one, or rows are ragged."""
    top, file = b"", str(path)
    with path.open("rb") as stream:
        while line := stream.readline():  # rows by themselves, so that they are not copied
            top += line
            if _is_header(line.removeprefix(BOM)):
                break
        text, top = stream.read(), top.removeprefix(BOM)
    refuse_binary(top, file)
    refuse_binary(text, file, top.count(b"\n"))
    head = head_of(top, file)
    return rows_of(top[head.end :] + text, head, file, head.line)


def head_of(raw: bytes, file: str) -> Head:
    """Return the header of a text that begins as the file does; raises LogError for none."""
    before = b""
    for number, match in enumerate(LINE.finditer(raw), start=1):
        line = match[1]
        if _is_header(line):
            return _head(line, before, number, match.end(), file)
        before = line
    raise LogError(f"{file}: the file is empty; a header line and rows of numbers are needed")


def _is_header(line: bytes) -> bool:
    """Return whether a line is more than a remark."""
    return bool(line.strip()) and line.lstrip()[:1] != b"#"


def _head(line: bytes, before: bytes, number: int, end: int, file: str) -> Head:
    place, bare = f"{file}: line {number}", QUOTED.sub(b"", line)
    separator = max(SEPARATORS, key=bare.count)
    if separator not in bare and re.search(rb"[\s|]", bare.strip()):
        valid = ", ".join(SEPARATORS.values())
        raise LogError(f"{place}: no separator between the column names; valid: {valid}")
    if line.count(b'"') % 2:
        raise LogError(f"{place}: a quote is opened and not closed; close it")
    if b'"' in line:
        names = tuple(name or "" for name in _frame(line, separator, file).row(0))
    else:
        names = tuple(name.decode() for name in line.rstrip(b"\r\n").split(separator))
    if all(NUMBER.fullmatch(name) for name in names):
        hint = "name the columns in the first line: t, q.<joint>, ..."
        if before.lstrip()[:1] == b"#" and before.count(separator) == len(names) - 1:
            hint = f"line {number - 1} looks like one behind its '#': remove that"  # np.savetxt
        raise LogError(f"{place} holds numbers where the header should be; {hint}")
    return Head(names, separator, number, end)


def rows_of(text: bytes, head: Head, file: str, before: int, last: bool = True) -> RawTable:
    """Return the columns of whole lines of a CSV file, with `before` lines of it before them."""
    if (columns := _plain_numbers(text, head)) is not None:
        for name in columns:
            check_name(file, name)
        count = len(next(iter(columns.values())))
        return RawTable(file, columns, lines=np.arange(count) + before + 1)
    if (frame := _even_frame(text, head, file)) is not None:
        series = [column.alias(name) for name, column in zip(head.names, frame, strict=True)]
        return table_of(file, series, np.arange(len(frame)) + before + 1)
    lines, width = text.splitlines(), len(head.names)
    filled = filled_lines(lines)
    if not len(filled):
        raise LogError(
            f"{file}: a header on line {head.line} and no rows; rows of numbers are needed"
        )
    for i, line in enumerate(lines):
        if (line.count(head.separator) != width - 1 or b'"' in line) and line.strip(b" "):
            _check_row(line, head, f"{file}: line {before + i + 1}", last and i == filled[-1])
    if len(filled) < len(lines) or b"\r" in text:
        text = b"\n".join([lines[i] for i in filled])
    frame = _values(text, lines[filled[0]], head, file)
    if frame.shape != (len(filled), width):
        raise LogError(f"{file}: {MISQUOTED}")
    notes = []
    if blank := int(filled[-1]) + 1 - len(filled):
        first = int((filled != np.arange(len(filled))).argmax()) + before + 1
        notes.append(f"{blank} blank lines left out, first at line {first}")
    series = [column.alias(name) for name, column in zip(head.names, frame, strict=True)]
    return table_of(file, series, filled + before + 1, notes)


def _plain_numbers(text: bytes, head: Head) -> dict[str, NDArray[np.float64]] | None:
    """The columns of a small file of which each cell holds a number; None for any other file, whose
    reader takes as long to be imported as such a file to be read.
    """
    names, width = [name.strip() for name in head.names], len(head.names)
    if len(text) > SMALL or text.translate(None, PLAIN) or not all(names):
        return None
    cells = text.rstrip(b"\n")
    rows = cells.count(b"\n") + 1
    if len({*names}) < width or cells.count(b",") != rows * (width - 1) or head.separator != b",":
        return None
    flat = b"," + cells.replace(b"\n", b",") + b","
    if b",," in flat:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy warns of a cell that is no number
            values = np.fromstring(cells.replace(b"\n", b",").decode(), sep=",")
    except (DeprecationWarning, ValueError):
        return None
    if values.size != rows * width or not _even(cells, width):
        return None
    return dict(zip(names, np.ascontiguousarray(values.reshape(rows, width).T), strict=True))


def _even(cells: bytes, width: int) -> bool:
    """Whether all lines have as many cells."""
    codes = np.frombuffer(cells, dtype=np.uint8)
    ends = np.flatnonzero((codes == ord(",")) | (codes == ord("\n")))
    return bool((codes[ends][width - 1 :: width] == ord("\n")).all())


def _even_frame(text: bytes, head: Head, file: str) -> pl.DataFrame | None:
    """The cells of a text whose lines have one for each column each, none of them quoted; None for
    any other text, whose lines are to be looked at.

    A longer line is an error of the parser; a shorter one leaves cells empty, of which there are as
    many as separators, then.
    """
    width, line = len(head.names), text[: text.find(b"\n") + 1].rstrip(b"\n")
    if not line.strip() or b'"' in text or b"\r" in text:
        return None
    if text.endswith(head.separator):
        return None  # the parser drops an empty cell at the end of a text
    try:
        frame = _typed(text, line, head, file)
    except pl.exceptions.PolarsError:
        return None
    rows = text.count(b"\n") + (not text.endswith(b"\n"))
    if frame.shape != (rows, width):
        return None
    empty = sum(column.null_count() for column in frame)
    even = not empty or (width > 1 and text.count(head.separator) == rows * (width - 1))
    return frame if even else None


def filled_lines(lines: Sequence[bytes]) -> NDArray[np.int64]:
    """Return which lines (m,) hold more than blanks."""
    return np.array([i for i, line in enumerate(lines) if line.strip(b" \r\n")], dtype=np.int64)


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


def _values(text: bytes, line: bytes, head: Head, file: str) -> pl.DataFrame:
    """Parse rows as `_typed` does; where cells in later rows are no numbers, as text."""
    try:
        return _typed(text, line, head, file)
    except pl.exceptions.PolarsError:
        return _frame(text, head.separator, file)


def _typed(text: bytes, line: bytes, head: Head, file: str) -> pl.DataFrame:
    """Parse rows; a column whose cell in the first line is a number is one of numbers."""
    kinds = {
        f"column_{i}": pl.Float64 if cell and NUMBER.fullmatch(cell) else pl.String
        for i, cell in enumerate(_frame(line, head.separator, file).row(0), start=1)
    }
    return pl.read_csv(text, has_header=False, schema=kinds, separator=head.separator.decode())


def _frame(text: bytes, separator: bytes, file: str) -> pl.DataFrame:
    try:
        return pl.read_csv(text, has_header=False, infer_schema=False, separator=separator.decode())
    except pl.exceptions.PolarsError as error:
        raise LogError(f"{file}: {MISQUOTED}") from error


# what NumPy raises for a damaged archive
BROKEN = (ValueError, EOFError, OSError, RuntimeError, KeyError, zipfile.BadZipFile, zlib.error)
HEADERS = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}


def read_parquet(path: Path) -> RawTable:
    """Read the columns of a Parquet file; raises LogError where it is not one."""
    with path.open("rb") as stream, parquet_errors(path):
        lazy = pl.scan_parquet(path)
        rows, columns = lazy.select(pl.len()).collect().item(), len(lazy.collect_schema())
        check_size(path, 8 * rows * columns)
        frame = pl.read_parquet(stream)
    return table_of(str(path), frame)


@contextlib.contextmanager
def parquet_errors(path: Path) -> Iterator[None]:
    """Raise what polars raises for a bad Parquet file as a LogError."""
    try:
        yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        raise LogError(f"{path}: not a Parquet file, or a damaged one; write it again") from error


STATES = {"qpos": "q", "qvel": "v"}  # of joints, in MuJoCo's time series


def read_npz(path: Path) -> RawTable:
    """Read the arrays of a NumPy archive, each a column; pickles are never loaded."""
    with path.open("rb") as stream:
        try:
            archive = np.load(stream, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise LogError(f"{path}: a single array, not an archive; write it with np.savez")
            check_claims(archive, path)
            arrays = {name: archive[name] for name in archive.files}
        except BROKEN as e:
            raise LogError(
                f"{path}: not a NumPy archive, or a damaged one; write it with np.savez"
            ) from e
    return table_of_arrays(str(path), series_of_sysid(path, arrays))


def series_of_sysid(path: Path, arrays: Mapping[str, Array]) -> Mapping[str, Array]:
    """Return the columns of a time series that MuJoCo's system identification has saved; other
    arrays as they are.

    `times` (n,), `data` (n, m) and, as JSON, by signal its type and its places in `data`. States of
    joints get their names here; sensors and controls keep theirs. Format: mujoco.sysid 4.0,
    TimeSeries.save_to_disk.
    """
    if not {"times", "data"} <= arrays.keys() <= {"times", "data", "signal_mapping"}:
        return arrays
    times, data = arrays["times"], arrays["data"]
    if data.ndim != 2 or times.shape != data.shape[:1]:
        return arrays
    try:
        text = str(arrays["signal_mapping"]) if "signal_mapping" in arrays else "{}"
        mapping = json.loads(text).items()
        signals = {str(name): [int(i) for i in places] for name, (_, places) in mapping}
    except (ValueError, TypeError, AttributeError) as error:
        raise LogError(
            f"{path}: 'signal_mapping' is no JSON of types and places of signals by name; save it "
            "again with TimeSeries.save_to_disk"
        ) from error
    signals = signals or {f"data.{i}": [i] for i in range(data.shape[1])}
    columns = {"t": times}
    for name, places in signals.items():
        if any(not 0 <= place < data.shape[1] for place in places):
            raise LogError(
                f"{path}: signal '{name}' is at {places}, and 'data' has {data.shape[1]} columns"
            )
        joint, _, kind = name.rpartition("_")
        named = f"{STATES[kind]}.{joint}" if joint and kind in STATES else name
        for k, place in enumerate(places):
            columns[named if len(places) == 1 else f"{named}.{k}"] = data[:, place]
    return columns


def check_claims(archive: np.lib.npyio.NpzFile, path: Path) -> dict[str, tuple[int, ...]]:
    """Return the shapes of an archive's arrays by name, none of them read.

    Raises LogError where they would take too much memory, or one is no array of plain values;
    ValueError where an array claims more than its file in the archive holds.
    """
    shapes, total, files = {}, 0, archive.zip
    assert files is not None  # while it is open
    every = files.namelist()
    members = {*every}
    if len(every) > MOST_ARRAYS:
        raise LogError(
            f"{path}: {len(every):,} arrays; a log has at most {MOST_ARRAYS:,} columns, each a 1-D "
            "array of all samples"
        )
    if twice := [name for name, count in Counter(archive.files).items() if count > 1]:
        raise LogError(
            f"{path}: two arrays are named {twice[0]!r}, of which a reader sees the last alone; "
            "write each under its own name"
        )
    for name in archive.files:
        member = name if name in members else f"{name}.npy"
        size = files.getinfo(member).file_size
        check_size(path, total := total + size)
        if not member.endswith(".npy"):
            raise LogError(f"{path}: {name!r} is not an array; valid: 1-D arrays, one a column")
        with files.open(member) as stream:
            read = HEADERS[np.lib.format.read_magic(stream)[0]]
            shape, _, kind = read(stream)
        if kind.hasobject:
            raise LogError(
                f"{path}: array {name!r} holds Python objects, which are pickles and can run code; "
                "valid: 1-D arrays of numbers"
            )
        if kind.itemsize * math.prod(shape) > size:
            raise ValueError(f"{name} claims more than there is")
        shapes[name] = shape
    return shapes


def write_table(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns by the path's suffix; raises LogError for an unknown one or a failed write."""
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise LogError(f"{path}: unknown suffix {path.suffix!r}; valid: {', '.join(WRITERS)}")
    try:
        with atomic_write(path) as stream:
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


def _write_npz(stream: BinaryIO, columns: Mapping[str, Array]) -> None:
    # np.savez takes names as keywords, and has two of its own ("file", "allow_pickle")
    with zipfile.ZipFile(stream, "w") as archive:
        for name, x in columns.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, x, allow_pickle=False)


WRITERS: dict[str, Callable[[BinaryIO, Mapping[str, Array]], None]] = {
    ".csv": _write_csv,
    ".parquet": lambda stream, columns: pl.DataFrame(dict(columns)).write_parquet(stream),
    ".npz": _write_npz,
}
