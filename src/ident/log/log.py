"""The noun: one recorded experiment."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from ident.errors import LogError, one_of
from ident.log.cells import Array
from ident.log.clock import with_clock
from ident.log.columns import Column, renamed
from ident.log.frames import frame_table, pandas_frame, polars_frame
from ident.log.table import Table, check_name, refuse_infinite, with_empty_noted
from ident.log.write import write_table
from ident.show.html import Shown, definitions, strong, table

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


@dataclass(frozen=True, eq=False, repr=False)
class Log(Shown):
    """One recorded experiment: named time series in SI units on one clock.

    Made by `read_log`, `Log.from_arrays` or `Log.from_frame`, which check and repair. Its arrays
    are read-only. Raises LogError where arrays are not 1-D of one length, or `t` does not increase.

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
        return cls._checked(name, Table(name, arrays))

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
        return cls._checked(name, renamed(table, mapping), mapping.get("t"))

    def polars(self) -> pl.DataFrame:
        """`t` and all columns (n_samples,) as a polars data frame; null where a cell is empty."""
        return polars_frame({"t": self.t, **self.columns})

    def pandas(self) -> pd.DataFrame:
        """All columns (n_samples,) as a pandas data frame over `t`; NaN where a cell is empty.

        Raises:
            LogError: if pandas is not installed.
        """
        return pandas_frame(self.t, self.columns)

    @classmethod
    def _checked(
        cls, name: str, table: Table, source: Column | None = None, sha256: str = ""
    ) -> Log:
        refuse_infinite(table)
        table = with_empty_noted(with_clock(table, source))
        columns = {key: x for key, x in table.columns.items() if key != "t"}
        return cls(name, columns, table.columns["t"], table.repairs, sha256)

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

    def _facts(self) -> dict[str, str]:
        largest, rms = self.jitter
        gaps = self.gaps()
        known = {name: int(np.isfinite(x).sum()) for name, x in self.columns.items()}
        # below a nanosecond it is the rounding of t
        jitter = f"{1e3 * largest:.3g} ms max, {1e3 * rms:.3g} ms rms" if largest > 1e-9 else "none"
        facts = {
            "samples": f"{self.t.size} in {self.duration:.6g} s",
            "rate": f"{self.rate:.6g} Hz, jitter {jitter}",
            "columns": ", ".join(
                name if n == self.t.size else f"{name} ({n} samples)" for name, n in known.items()
            ),
        }
        if gaps:
            start, end = max(gaps, key=lambda gap: gap[1] - gap[0])
            facts["gaps"] = f"{len(gaps)}, longest {end - start:.3g} s at t = {start:.6g} s"
        return facts | {"repairs": "; ".join(self.repairs) or "none"}

    def __repr__(self) -> str:
        rows = [f"  {key:<8} {value}" for key, value in self._facts().items()]
        return "\n".join([f"Log {self.name!r}", *rows])

    def _blocks(self) -> tuple[Markup, ...]:
        facts = {key: value for key, value in self._facts().items() if key != "columns"}
        rows = [["column", "samples", "from", "to", "rms"]]
        for name in self.columns:
            _, x = self.series(name)
            size = (x.min(), x.max(), np.sqrt(np.mean(x**2))) if len(x) else ()
            rows.append([name, str(len(x)), *([f"{each:.4g}" for each in size] or ["–"] * 3)])
        return strong(f"Log {self.name}"), definitions(facts), table(rows, "Columns")


def _read_only(x: ArrayLike, log: str, column: str) -> Array:
    """A float64 array of shape (n_samples,) that nobody can change."""
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
