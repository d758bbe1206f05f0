"""One column of any kind to float64: numbers, booleans, times, and text that spells numbers."""

from __future__ import annotations

import re

import numpy as np
import polars as pl
from numpy.typing import NDArray

Array = NDArray[np.float64]

# how loggers and spreadsheets spell "no value here" (compared in lower case)
EMPTY = ["", "nan", "-nan", "nan(ind)", "-nan(ind)", "null", "none", "na", "n/a", "#n/a"]
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
PER_SECOND = {"ms": 1e3, "us": 1e6, "ns": 1e9}


class BadCell(Exception):
    """A cell that is no number among numbers; who knows the file makes a LogError of it."""

    def __init__(self, row: int, what: str) -> None:
        super().__init__(what)
        self.row = row


class NotNumbers(Exception):
    """A column that is no measurement at all, and why: it is left out, not refused."""


def is_time(column: pl.Series) -> bool:
    """Whether the column holds stamps or durations, which `floats` counts from the first one."""
    return isinstance(column.dtype, (pl.Datetime, pl.Duration, pl.Time))


def floats(column: pl.Series, since: int | None = None) -> Array:
    """The column as float64, shape (n_rows,): NaN where a cell is empty, booleans 1 and 0.

    Stamps and durations become seconds since their first value, or since a tick of theirs. Raises
    BadCell at the first cell that is no number among numbers, NotNumbers where no cell is one.
    """
    dtype = column.dtype
    if is_time(column):
        return _seconds(column, first_tick(column) if since is None else since)
    if dtype.is_numeric() or dtype in (pl.Boolean, pl.Null):
        return column.cast(pl.Float64).to_numpy()
    if dtype in (pl.String, pl.Categorical, pl.Enum):
        return _parsed(column.cast(pl.String))
    raise NotNumbers(f"holds {dtype}")


def first_tick(column: pl.Series) -> int:
    """The first stamp of a column of times, as the integer that it is stored as; 0 for none."""
    return int(column.drop_nulls().head(1).to_physical().cast(pl.Int64).sum() or 0)


def _seconds(column: pl.Series, since: int) -> Array:
    # subtract in integers: float64 has no room for nanoseconds since 1970
    ticks = column.to_physical().cast(pl.Int64) - since
    unit = getattr(column.dtype, "time_unit", "ns")
    return ticks.cast(pl.Float64).to_numpy() / PER_SECOND[unit]


def _parsed(text: pl.Series) -> Array:
    numbers = text.cast(pl.Float64, strict=False)
    if numbers.null_count() == 0:
        return numbers.to_numpy()
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
    cell = _short(text[row])
    if DECIMAL_COMMA.fullmatch(text[row]):
        raise BadCell(row, f"{cell} has a decimal comma; write a decimal point")
    if bad.sum() == filled.sum():
        raise NotNumbers(f"holds text ({cell})")
    units = " (a row of units? delete it)" if row == 0 and bad.sum() == 1 else ""
    raise BadCell(
        row, f"{cell} is not a number{units}; leave the cell empty where there is no value"
    )


def _short(cell: str) -> str:
    return repr(cell if len(cell) <= 40 else cell[:37] + "...")
