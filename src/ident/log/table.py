"""Columns of a file, of arrays or of a data frame as float64, under ident's names, in SI units."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ident.errors import LogError, one_of
from ident.lazy import lazy

if TYPE_CHECKING:
    import polars as pl
else:
    pl = lazy("polars")

Array = NDArray[np.float64]

# how loggers and spreadsheets write "no value here" (compared in lower case)
EMPTY = ["", "nan", "-nan", "nan(ind)", "-nan(ind)", "null", "none", "na", "n/a", "#n/a"]
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
MOST_PLACES = 500  # work: of a list in each cell, which become columns
TICKS_PER_SECOND = {"ms": 1e3, "us": 1e6, "ns": 1e9}


@dataclass(frozen=True, eq=False)
class RawTable:
    """Equally long columns of one file or of memory; every row knows its place in the file."""

    file: str  # as messages name it
    columns: Mapping[str, Array]  # (n_rows,) by name, NaN where a cell is empty
    ignored: Mapping[str, str] = field(default_factory=dict)  # why it is no measurement
    repairs: tuple[str, ...] = ()  # what was changed, in words
    lines: NDArray[np.int64] | None = None  # (n_rows,) of each row, if there are any
    first: int = 0  # number of the first row in a file without lines

    def where(self, row: int) -> str:
        """Return the name of a row in messages: its line in a text file, else its index from 0."""
        return f"index {self.first + row}" if self.lines is None else f"line {self.lines[row]}"

    def cut(self, part: slice) -> RawTable:
        """Return some of the rows."""
        columns = {name: x[part] for name, x in self.columns.items()}
        lines = None if self.lines is None else self.lines[part]
        return replace(self, columns=columns, lines=lines, first=self.first + (part.start or 0))


@dataclass(frozen=True)
class Column:
    """A column of the file and its conversion to SI units: value = scale * file + offset.

    A file may lack one that is not `required`, as of a locked joint. Those made by one entry of
    [log] with `*`, its name the `group`, may be lacking too, but not all of them.

    Raises LogError where `scale` is zero or not finite, or `offset` is not finite.
    """

    column: str  # its name in the file
    scale: float = 1.0  # [SI unit / file's unit]
    offset: float = 0.0  # [SI unit]
    required: bool = True
    group: str = ""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale != 0.0 and math.isfinite(self.offset)):
            raise LogError(
                f"column {self.column!r}: scale = {self.scale}, offset = {self.offset}; "
                "valid: finite numbers, scale other than 0"
            )


def renamed(table: RawTable, mapping: Mapping[str, Column]) -> RawTable:
    """Return the table under ident's names and in SI units; unmapped columns keep their own name.

    One that is not required gives way to a column that has the name already. A file with `t` and
    ident's names, and none of the mapped columns, stays as it is, as planned motions do.
    """
    every = {*table.columns, *table.ignored}
    groups: dict[str, list[str]] = {}
    for source in mapping.values():
        if source.group:
            groups.setdefault(source.group, []).append(source.column)
    wanted_names = {
        name for name, source in mapping.items() if source.required
    } & table.columns.keys()
    mapping = {
        name: source
        for name, source in mapping.items()
        if (source.required and not source.group)
        or (source.column in every and (source.required or name not in every))
    }
    used = {source.column for source in mapping.values()}
    if "t" in table.columns and wanted_names - {"t"} and not used & every:
        return table
    free = every - used
    for group, sources in groups.items():
        if not every & {*sources}:
            raise LogError(
                f"{table.file}: [log] {group!r} in mechanism.toml finds no column of any joint, "
                f"such as {sources[0]!r}; {one_of(sources[0], free, used & every)}"
            )
    for name, source in mapping.items():
        wanted = f"{table.file}: column {source.column!r}, [log] {name!r} in mechanism.toml,"
        if source.column in table.ignored:
            raise LogError(f"{wanted} {table.ignored[source.column]}; numbers are needed")
        if source.column not in table.columns:
            raise LogError(
                f"{wanted} is not in the file; {one_of(source.column, free, used & every)}"
            )
        if name not in used and (name in table.columns or name in table.ignored):
            raise LogError(
                f"{table.file}: {name!r} is ambiguous: [log] in mechanism.toml makes it from "
                f"{source.column!r}, and the file has a column {name!r} too; "
                f"remove the [log] entry, or rename the file's column"
            )
    columns: dict[str, Array] = {}
    for column, x in table.columns.items():
        if column not in used:
            columns[column] = x
        for name, source in mapping.items():
            if source.column == column:
                with np.errstate(over="ignore"):  # infinite values are refused later, by place
                    columns[name] = source.scale * x + source.offset
    return replace(table, columns=columns)


def check_name(file: str, name: str) -> None:
    """Raise LogError for a name that would not survive a header line or a one-line message."""
    if name != name.strip() or len(name.splitlines()) != 1:
        raise LogError(
            f"{file}: {name!r} cannot name a column; valid: one line, no blanks around it"
        )


def table_of(
    file: str,
    series: Iterable[pl.Series],
    lines: NDArray[np.int64] | None = None,
    repairs: Iterable[str] = (),
    first: int = 0,
    since: Mapping[str, int] | None = None,
) -> RawTable:
    """Convert named columns of any type; times count from `since`, or their first tick."""
    table = RawTable(file, {}, {}, (), lines, first)
    columns: dict[str, Array] = {}
    ignored: dict[str, str] = {}
    notes = list(repairs)
    for position, one in enumerate(_flat(series), start=1):
        name = one.name.strip()
        if not name:  # a data frame's index, or a comma at the end of each line
            notes.append(f"column {position} has no name, left out")
            continue
        if name in columns or name in ignored:
            raise LogError(f"{file}: two columns are named {name!r}; each needs its own name")
        check_name(file, name)
        x = _floats(one, table, (since or {}).get(one.name))
        if isinstance(x, str):
            ignored[name] = x
            notes.append(f"column {name!r} {x}, left out")
            continue
        columns[name] = x
        if one.dtype.is_temporal():
            notes.append(f"column {name!r} held {one.dtype}, now seconds since its first value")
    return replace(table, columns=columns, ignored=ignored, repairs=tuple(notes))


def _flat(series: Iterable[pl.Series]) -> Iterator[pl.Series]:
    """Yield columns, and of one whose cells are lists of one length, as LeRobot's `action`, a
    column `name.0`, `name.1`, … for each place in them.
    """
    for one in series:
        nested = isinstance(one.dtype, pl.List | pl.Array)
        if not (nested and one.dtype.inner.is_numeric()):  # type: ignore[attr-defined]
            yield one
            continue
        lists = one.cast(pl.List(pl.Float64))
        count = lists.list.len().drop_nulls().unique()
        if len(count) != 1 or not 0 < count[0] <= MOST_PLACES:
            yield one
            continue
        for i in range(count[0]):
            yield lists.list.get(i).alias(f"{one.name}.{i}")


def _floats(column: pl.Series, table: RawTable, since: int | None) -> Array | str:
    # or why it is no measurement
    dtype = column.dtype
    if dtype.is_temporal() and dtype != pl.Date:
        # subtract in integers: float64 has no room for nanoseconds since 1970
        start = first_tick(column) if since is None else since
        seconds = (column.to_physical().cast(pl.Int64) - start).cast(pl.Float64).to_numpy()
        return seconds / TICKS_PER_SECOND[getattr(dtype, "time_unit", "ns")]
    if dtype.is_numeric() or dtype in (pl.Boolean, pl.Null):
        return column.cast(pl.Float64).to_numpy()
    if dtype in (pl.String, pl.Categorical, pl.Enum):
        return _parsed(column.cast(pl.String), table)
    return f"holds {dtype}"


def first_tick(column: pl.Series) -> int:
    """Return the first value of a column of times, as the integer that is stored; 0 for none."""
    return int(column.drop_nulls().head(1).to_physical().cast(pl.Int64).sum() or 0)


def _parsed(text: pl.Series, table: RawTable) -> Array | str:
    name = text.name.strip()
    text = text.str.strip_chars()
    lower = text.str.to_lowercase()
    filled = ~lower.is_in(EMPTY) & text.is_not_null()
    numbers = text.cast(pl.Float64, strict=False)
    bad = filled & numbers.is_null()
    if not bad.any():
        return numbers.to_numpy()
    if lower.filter(filled).is_in(["true", "false"]).all():
        return np.where(filled.to_numpy(), (lower == "true").fill_null(False).to_numpy(), np.nan)
    row = int(bad.arg_max() or 0)
    cell = repr(text[row] if len(text[row]) <= 40 else text[row][:37] + "...")
    what = f"{cell} has a decimal comma; write a decimal point"
    if not DECIMAL_COMMA.fullmatch(text[row]):
        if bad.sum() == filled.sum():
            return f"holds text ({cell})"
        units = " (a row of units? delete it)" if row == 0 and bad.sum() == 1 else ""
        what = f"{cell} is not a number{units}; leave the cell empty where there is no value"
    raise LogError(f"{table.file}: column {name!r}, {table.where(row)}: {what}")


def table_of_arrays(file: str, arrays: Mapping[str, Any]) -> RawTable:
    """Convert named arrays (n_rows,) of numbers, booleans, times or text."""
    series: list[pl.Series] = []
    for name, values in arrays.items():
        x = np.asarray(values)
        if x.ndim != 1:
            raise LogError(f"{file}: array {name!r} has shape {x.shape}; valid: 1-D, one a column")
        if series and len(series[0]) != x.size:
            raise LogError(
                f"{file}: arrays of different lengths: {series[0].name!r} has {len(series[0])}, "
                f"{name!r} has {x.size}; every column needs one value a sample (NaN where there is "
                "none)"
            )
        if x.dtype.kind in "fiub":  # polars knows no long double, and no foreign byte order
            series.append(pl.Series(name, x if x.dtype.kind == "b" else x.astype(np.float64)))
        elif x.dtype.kind in "mM":
            series.append(pl.Series(name, x.astype(f"{x.dtype.kind}8[ns]")))
        elif x.dtype.kind in "US":
            series.append(pl.Series(name, x.astype(str).tolist(), dtype=pl.String))
        else:
            raise LogError(f"{file}: array {name!r} holds {x.dtype}; valid: 1-D arrays of numbers")
    return table_of(file, series)


def is_frame(thing: object) -> bool:
    """Return whether it is a data frame of polars or pandas, whatever it holds."""
    package = type(thing).__module__.split(".")[0]
    kinds = {"polars": ("DataFrame", "LazyFrame"), "pandas": ("DataFrame",)}
    return type(thing).__name__ in kinds.get(package, ())


def frame_table(name: str, frame: Any, mapped: Collection[str] = ()) -> RawTable:
    """Convert the columns of a polars or pandas data frame, whose rows are samples.

    A pandas index that is named, or holds times, is a column too, `t` where nothing else is; the
    columns `mapped` are asked for under their own name.
    """
    if isinstance(frame, pl.DataFrame):
        return table_of(name, frame.get_columns())
    if isinstance(frame, pl.LazyFrame):
        raise LogError(f"{name}: a polars LazyFrame holds no values yet; give frame.collect()")
    if is_frame(frame):
        return table_of(name, _series_of_pandas(name, frame, mapped))
    raise LogError(
        f"{name}: {type(frame).__name__} is no data frame; valid: a polars or pandas DataFrame"
    )


# not pl.from_pandas, which needs pyarrow for most types
def _series_of_pandas(name: str, frame: Any, mapped: Collection[str]) -> Iterator[pl.Series]:
    index, labels = frame.index, list(frame.columns)
    for label in [*labels, *index.names]:
        if not isinstance(label, str) and not (label is None and label not in labels):
            raise LogError(f"{name}: column {label!r} is not named by text; rename it")
    if index.nlevels == 1:
        times = getattr(index.dtype, "kind", "") in "mM"
        label = "t" if times and "t" not in labels and index.name not in mapped else index.name
        if label is not None and label not in labels:
            yield _series(label, index)
    for position, label in enumerate(labels):
        yield _series(label, frame.iloc[:, position])


def _series(label: str, values: Any) -> pl.Series:
    kind = getattr(values.dtype, "kind", "O")
    if kind in "mM":
        return pl.Series(label, values.to_numpy(f"{kind}8[ns]"))  # of a zone: in UTC
    if kind in "fiub":
        return pl.Series(label, values.to_numpy(np.float64, na_value=np.nan))
    cells = [None if e else cell for e, cell in zip(values.isna(), values.tolist(), strict=True)]
    if all(isinstance(cell, int | float | bool | None) for cell in cells):
        return pl.Series(label, cells, dtype=pl.Float64, strict=False)
    return pl.Series(label, [None if cell is None else str(cell) for cell in cells], pl.String)
