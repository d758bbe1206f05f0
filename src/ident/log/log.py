"""One recorded experiment."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from numpy.typing import ArrayLike

from ident.display import Displayed
from ident.errors import LogError, one_of
from ident.log.clock import with_clock
from ident.log.storage import write_table
from ident.log.table import Array, Column, RawTable, check_name, frame_table, renamed

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class Log(Displayed):
    """One recorded experiment: named time series in SI units on one clock.

    `read_log`, `Log.from_arrays` and `Log.from_frame` check, repair and return one. Its arrays are
    read-only. Raises LogError where arrays are not 1-D of one length, or `t` does not increase.

    Attributes:
        name: of the file, as "run.csv".
        columns: all but t, each (n_samples,); NaN where a cell is empty.
        t: (n_samples,) [s], strictly increasing, finite.
        repairs: what was changed, how often, where first, in words.
        sha256: of the file's bytes; "" if made in memory.
    """

    name: str
    columns: Mapping[str, Array]
    t: Array
    repairs: tuple[str, ...] = ()
    sha256: str = ""

    def __post_init__(self) -> None:
        t = _read_only(self.t, self.name, "t")
        columns = {name: _read_only(x, self.name, name) for name, x in self.columns.items()}
        for name, x in columns.items():
            if x.shape != t.shape:
                raise LogError(
                    f"{self.name}: column {name!r} has {x.size} values, t has {t.size}; "
                    "every column needs one value a sample (NaN where there is none)"
                )
        if t.size < 2 or not np.isfinite(t).all() or not (np.diff(t) > 0).all():
            raise LogError(
                f"{self.name}: t must be finite and increase over two samples or more; "
                "Log.from_arrays says where it does not"
            )
        object.__setattr__(self, "t", t)
        object.__setattr__(self, "columns", MappingProxyType(columns))
        object.__setattr__(self, "repairs", tuple(self.repairs))

    @classmethod
    def from_arrays(cls, name: str, t: ArrayLike, columns: Mapping[str, ArrayLike]) -> Log:
        """A log from memory: `t` (n_samples,) [s] and `columns` (n_samples,), checked as a file is.

        `name` stands for it in messages and results. Raises LogError where `read_log` would.
        """
        if "t" in columns:
            raise LogError(f"{name}: 't' is among the columns; valid: t as the argument alone")
        for key in columns:
            check_name(name, key)
        arrays = {key: _read_only(x, name, key) for key, x in {"t": t, **columns}.items()}
        return cls.from_table(name, RawTable(name, arrays))

    @classmethod
    def from_frame(
        cls, frame: Any, name: str = "frame", columns: Mapping[str, Column] | None = None
    ) -> Log:
        """A log from a polars or pandas data frame, checked and repaired as a file is.

        Args:
            frame: a row a sample, columns named as a file's. A pandas index that is named `t`, or
                holds times, is `t`.
            name: what messages and tables call it.
            columns: ident's names to the frame's columns, as `read_log` takes them.

        Raises:
            LogError: where `read_log` would, and for anything but a data frame.
        """
        mapping = columns or {}
        table = frame_table(name, frame, {source.column for source in mapping.values()})
        return cls.from_table(name, table, mapping)

    @classmethod
    def from_table(
        cls,
        name: str,
        table: RawTable,
        columns: Mapping[str, Column] | None = None,
        sha256: str = "",
    ) -> Log:
        """Check and repair columns under the file's own names.

        Args:
            name: what messages and tables call it.
            table: of a file or of memory.
            columns: ident's names to the file's columns.
            sha256: of the file's bytes.

        Raises:
            LogError: where `read_log` would.
        """
        mapping = columns or {}
        table = with_clock(renamed(table, mapping).checked(), mapping.get("t"))
        values = {key: x for key, x in table.columns.items() if key != "t"}
        return cls(name, values, table.columns["t"], table.repairs, sha256)

    def polars(self) -> pl.DataFrame:
        """`t` and all columns (n_samples,) as a polars data frame; null where a cell is empty."""
        return pl.DataFrame({"t": self.t, **self.columns}).fill_nan(None)

    def pandas(self) -> pd.DataFrame:
        """All columns (n_samples,) as a pandas data frame over `t`; NaN where a cell is empty.

        Raises:
            LogError: if pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise LogError(
                "pandas is not installed: pip install pandas, or take .polars()"
            ) from None
        return pd.DataFrame(dict(self.columns), index=pd.Index(self.t, name="t"))

    def series(self, name: str) -> tuple[Array, Array]:
        """The samples that one column has: its times [s] and values, both (n_finite,).

        Raises LogError for a name that is not a column.
        """
        if name not in self.columns:
            raise LogError(f"{self.name}: no column {name!r}; {one_of(name, self.columns)}")
        x = self.columns[name]
        known = np.isfinite(x)
        return self.t[known], x[known]

    @property
    def duration(self) -> float:
        """From the first sample to the last [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def rate(self) -> float:
        """Median sampling rate [Hz]."""
        return 1.0 / float(np.median(np.diff(self.t)))

    @property
    def jitter(self) -> tuple[float, float]:
        """Deviation of the steps of t from their median: largest and root mean square [s]."""
        step = np.diff(self.t)
        off = step - np.median(step)
        return float(np.abs(off).max()), float(np.sqrt(np.mean(off**2)))

    def gaps(self, factor: float = 5.0) -> list[tuple[float, float]]:
        """Where t jumps by more than `factor` median steps: last time before, first after [s]."""
        step = np.diff(self.t)
        before = np.flatnonzero(step > factor * np.median(step))
        return [(float(self.t[i]), float(self.t[i + 1])) for i in before]

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write to `path`, a .csv, .parquet or .npz, whole or not at all; read again it is this.

        Column `t` comes first, then the others as stored. Raises LogError for another suffix and
        where the file cannot be written.
        """
        write_table(Path(path), {"t": self.t, **self.columns})

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    def __reduce__(self) -> tuple[type[Log], tuple[object, ...]]:
        # a mappingproxy cannot be pickled, and unpickled arrays are writable
        return Log, (self.name, dict(self.columns), self.t, self.repairs, self.sha256)


def _read_only(x: ArrayLike, log: str, column: str) -> Array:
    try:
        array = np.asarray(x)
    except ValueError:  # nested lists of different lengths
        raise LogError(f"{log}: column {column!r} is no array; valid: (n_samples,)") from None
    if array.dtype.kind not in "fiub":
        raise LogError(f"{log}: column {column!r} holds {array.dtype}; valid: numbers, booleans")
    if array.ndim != 1:
        raise LogError(f"{log}: column {column!r} has shape {array.shape}; valid: (n_samples,)")
    if array.dtype != np.float64 or array.flags.writeable or array.base is not None:
        array = array.astype(np.float64)
        array.setflags(write=False)
    return array
