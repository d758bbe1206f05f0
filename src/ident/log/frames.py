"""Data frames of polars and pandas to a table, and a log's columns to frames.

pandas is imported only to make one of its frames; one that is given brings its own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from ident.errors import LogError
from ident.log.cells import Array
from ident.log.table import Table, table_of

if TYPE_CHECKING:
    import pandas as pd


def is_frame(thing: object) -> bool:
    """Whether it is a data frame of polars or pandas, whatever it holds.

    >>> is_frame(pl.DataFrame({"t": [0.0]}))
    True
    """
    of_pandas = type(thing).__module__.split(".")[0] == "pandas"
    return isinstance(thing, pl.DataFrame | pl.LazyFrame) or (
        of_pandas and type(thing).__name__ == "DataFrame"
    )


def frame_table(name: str, frame: Any, mapped: Collection[str] = ()) -> Table:
    """The columns of a polars or pandas data frame.

    Args:
        name: what messages call it.
        frame: its rows are samples. A pandas index that is named, or holds times, is a column too:
            `t`, where it holds times and nothing else is `t`.
        mapped: names of columns that are asked for under their own name.

    Raises:
        LogError: for anything else, for names that are no text, and for bad cells.
    """
    if isinstance(frame, pl.DataFrame):
        return table_of(name, frame.get_columns())
    if isinstance(frame, pl.LazyFrame):
        raise LogError(f"{name}: a polars LazyFrame holds no values yet; give frame.collect()")
    if is_frame(frame):
        return table_of(name, _series(name, frame, mapped))
    raise LogError(
        f"{name}: {type(frame).__name__} is no data frame; valid: a polars or pandas DataFrame"
    )


def _series(name: str, frame: pd.DataFrame, mapped: Collection[str]) -> Iterator[pl.Series]:
    index, own = frame.index, list(frame.columns)
    for label in [*own, *index.names]:
        if not isinstance(label, str) and not (label is None and label not in own):
            raise LogError(f"{name}: column {label!r} is not named by text; rename it")
    if index.nlevels == 1:
        times = getattr(index.dtype, "kind", "") in "mM"
        label = "t" if times and "t" not in own and index.name not in mapped else index.name
        if label is not None and label not in own:
            yield _converted(name, label, index)
    for position, label in enumerate(own):
        yield _converted(name, label, frame.iloc[:, position])


def _converted(name: str, label: str, values: Any) -> pl.Series:
    kind = getattr(values.dtype, "kind", "O")
    if kind in "mM":
        return pl.Series(label, values.to_numpy(f"{kind}8[ns]"))  # of a zone: in UTC
    if kind in "fiub":
        return pl.Series(label, values.to_numpy(np.float64, na_value=np.nan))
    empty = values.isna()
    cells = [None if e else cell for e, cell in zip(empty, values.tolist(), strict=True)]
    if all(isinstance(cell, int | float | bool | None) for cell in cells):
        return pl.Series(label, cells, dtype=pl.Float64, strict=False)
    return pl.Series(label, [None if cell is None else str(cell) for cell in cells], pl.String)


def polars_frame(columns: Mapping[str, Array]) -> pl.DataFrame:
    """The columns side by side; null where a cell is empty."""
    return pl.DataFrame(dict(columns)).fill_nan(None)


def pandas_frame(t: Array, columns: Mapping[str, Array]) -> pd.DataFrame:
    """The columns side by side, NaN where a cell is empty; `t` is the index.

    Raises:
        LogError: if pandas is not installed.
    """
    try:
        import pandas as pd
    except ImportError:
        raise LogError("pandas is not installed: pip install pandas, or take .polars()") from None
    return pd.DataFrame(dict(columns), index=pd.Index(t, name="t"))
