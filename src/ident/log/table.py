"""What a file holds before anything is asked of it: equally long columns of float64."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ident.errors import LogError
from ident.log.cells import Array, BadCell, NotNumbers, floats, is_time


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one file or of memory, and the way back from a row to its line."""

    file: str  # what messages call it
    columns: Mapping[str, Array]  # name -> (n_rows,), NaN where a cell is empty
    left_out: Mapping[str, str] = field(default_factory=dict)  # name -> why it is no measurement
    repairs: tuple[str, ...] = ()
    lines: NDArray[np.int64] | None = None  # (n_rows,) each row's line; None: a file without lines
    first: int = 0  # of a piece of a file without lines: rows of the file before it

    def where(self, row: int) -> str:
        """How a message names this row: its line in a text file, else its index from 0."""
        return _where(row, self.lines, self.first)


def _where(row: int, lines: NDArray[np.int64] | None, first: int) -> str:
    return f"index {first + row}" if lines is None else f"line {lines[row]}"


def table_of(
    file: str,
    series: Iterable[pl.Series],
    lines: NDArray[np.int64] | None = None,
    repairs: Iterable[str] = (),
    first: int = 0,
    since: Mapping[str, int] | None = None,
) -> Table:
    """Convert named columns of any kind; raises LogError for doubled names and bad cells.

    Of a piece of a file: its rows before are `first`, and its columns of times count `since` ticks.
    """
    columns: dict[str, Array] = {}
    left_out: dict[str, str] = {}
    notes = list(repairs)
    for position, one in enumerate(series, start=1):
        name = one.name.strip()
        if not name:  # a data frame's index, or a comma at the end of each line
            notes.append(f"column {position} has no name, left out")
            continue
        if name in columns or name in left_out:
            raise LogError(f"{file}: two columns are named {name!r}; each needs its own name")
        check_name(file, name)
        try:
            columns[name] = floats(one, (since or {}).get(one.name))
        except NotNumbers as why:
            left_out[name] = str(why)
            notes.append(f"column {name!r} {why}, left out")
        except BadCell as bad:
            place = _where(bad.row, lines, first)
            raise LogError(f"{file}: column {name!r}, {place}: {bad}") from None
        if is_time(one):
            notes.append(f"column {name!r} held {one.dtype}, now seconds since its first value")
    return Table(file, columns, left_out, tuple(notes), lines, first)


def check_name(file: str, name: str) -> None:
    """Raise LogError for a name that would not survive a header line or a one-line message."""
    if name != name.strip() or len(name.splitlines()) != 1:
        raise LogError(
            f"{file}: {name!r} cannot name a column; valid: one line, no blanks around it"
        )


def refuse_infinite(table: Table) -> None:
    """Raise LogError at the first infinite value, naming its column and place."""
    for name, x in table.columns.items():
        infinite = np.isinf(x)
        if infinite.any():
            row = int(infinite.argmax())
            raise LogError(
                f"{table.file}: column {name!r}, {table.where(row)}: {x[row]} is no measurement; "
                "leave the cell empty (NaN) where there is no value"
            )


def with_empty_noted(table: Table) -> Table:
    """The same table; a column without a single value is kept, and said to be so in `repairs`."""
    empty = [name for name, x in table.columns.items() if np.isnan(x).all()]
    notes = tuple(f"column {name!r} is empty" for name in empty)
    return replace(table, repairs=table.repairs + notes)
