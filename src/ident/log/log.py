"""One recorded experiment, whose clock is checked.

Its `t` is finite, strictly increasing and in seconds; an error names the remedy where it is not.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ident.display import Displayed
from ident.errors import LogError, one_of
from ident.lazy import lazy
from ident.log.poses import FEWEST_POSES, are_poses
from ident.log.remember import once_a_series
from ident.log.storage import write_table
from ident.log.table import Array, Column, RawTable, check_name, frame_table, renamed
from ident.text import shortlist

if TYPE_CHECKING:
    import polars as pl
else:
    pl = lazy("polars")

if TYPE_CHECKING:
    import pandas as pd

FEWEST_SAMPLES = 10  # range
LISTED = 40  # shown: columns of a file in a message
# range: [s] a log of more than 100 samples with a median step outside is not in seconds: no machine
# is logged that slowly, and drives compute their torque at 50 kHz at most
SHORTEST_STEP, LONGEST_STEP = 2e-5, 0.5
USUAL_RATES = (10.0, 100e3)  # range: [Hz]
UNITS = (1e-3, 1e-6, 1e-9, 1e3, 1e6)  # range: [s] ms, us, ns; of stamps divided once too often
RESETS = 0.1  # range: share of steps back, above which a column is no clock that was reset
UNSTEADY, MOST_STEPS = 0.1, 0.5  # range: of the median step; share of steps that are as long
TIME_NAME = re.compile(r"time|stamp|clock|^t([^a-z]|$)|^(ts|secs?|seconds)$|_(ms|us|ns)$", re.I)
WORDS = {  # in names of columns that are a joint's position, speed or torque
    "q": re.compile(r"pos|angle|(?<![a-z])q(?![a-z])", re.I),
    "v": re.compile(r"vel|speed|(?<![a-z])(v|dq|qd)(?![a-z])", re.I),
    "tau": re.compile(r"eff|torq|trq|tau|moment|force|current|(?<![a-z])i(?![a-z])", re.I),
}
ORDERED = re.compile(r"cmd|command|target|desired|(?<![a-z])ref", re.I)  # not what was measured
SIMILAR_NAMES = 0.8  # range: likeness of names from which one is the other in another spelling


class NoTime(LogError):
    """A log without a time; `columns`: those that it has."""

    def __init__(self, message: str, columns: Iterable[str]) -> None:
        super().__init__(message)
        self.columns = tuple(columns)


def with_clock(table: RawTable, source: Column | None = None) -> RawTable:
    """Return a table of finite values and a strictly increasing `t`, whose column is `source`; of
    repeated stamps the first stays.
    """
    notes = _empty_columns(table)
    if "t" not in table.columns:
        poses = any(name.startswith("q.") for name in table.columns)
        also = "; if each row is a pose at which it rests: --poses, in Python poses=True" * poses
        raise NoTime(f"{table.file}: {_no_time(table)}{also}", table.columns)
    t = table.columns["t"]
    empty = np.flatnonzero(np.isnan(t))
    if empty.size:
        raise LogError(
            f"{table.file}: t is empty in {_count(empty.size, 'row')}, first at "
            f"{table.where(int(empty[0]))}; every row needs its time: remove these rows"
        )
    table = replace(table, repairs=(*table.repairs, *notes))
    step = np.diff(t)
    if (step < 0).any():
        row = int((step < 0).argmax()) + 1
        if _swings(step):
            raise LogError(
                f"{table.file}: t goes backward at {table.where(row)}: {float(t[row])} after "
                f"{float(t[row - 1])}, and on and off after that, so it is no clock but some other "
                'signal; map the column of times: [log] "t" = "…"'
            )
        raise LogError(
            f"{table.file}: t goes backward at {table.where(row)}: {float(t[row])} after "
            f"{float(t[row - 1])} (a clock reset, or two logs in one file?); split the file there"
        )
    repeats = np.flatnonzero(step == 0) + 1
    if repeats.size:
        note = (
            f"{_count(repeats.size, 'repeated time stamp')}, first at "
            f"{table.where(int(repeats[0]))}: the first value of each kept"
        )
        rows = pl.DataFrame(dict(table.columns)).fill_nan(None)
        rows = rows.group_by("t", maintain_order=True).agg(pl.all().drop_nulls().first())
        columns = {column.name: column.fill_null(np.nan).to_numpy() for column in rows}
        repairs = (*table.repairs, note)
        table = replace(table, columns=columns, repairs=repairs, lines=None)  # rows are no lines
        t = table.columns["t"]
    if t.size < FEWEST_SAMPLES:
        raise LogError(
            f"{table.file}: {_count(t.size, 'sample')} of different times; "
            f"at least {FEWEST_SAMPLES} are needed"
        )
    if t.size > 100 and not SHORTEST_STEP < np.median(np.diff(t)) <= LONGEST_STEP:
        raise LogError(f"{table.file}: {_wrong_unit(t, source or Column('t'))}")
    return table


def without_clock(table: RawTable) -> RawTable:
    """Return a table of poses, whose `t` is their number."""
    notes, count = _empty_columns(table), len(next(iter(table.columns.values()), ()))
    if count < FEWEST_POSES:
        raise LogError(f"{table.file}: {_count(count, 'pose')}; at least {FEWEST_POSES} are needed")
    columns = {**table.columns, "t": np.arange(count, dtype=float)}
    return replace(table, columns=columns, repairs=(*table.repairs, *notes))


def _empty_columns(table: RawTable) -> list[str]:
    """Return notes on columns without a value; refuse infinite ones."""
    notes = []
    for name, x in table.columns.items():
        if np.isinf(x).any():
            row = int(np.isinf(x).argmax())
            raise LogError(
                f"{table.file}: column {name!r}, {table.where(row)}: {x[row]} is no measurement; "
                "leave the cell empty (NaN) where there is no value"
            )
        if np.isnan(x).all():
            notes.append(f"column {name!r} is empty")
    return notes


def _wrong_unit(t: Array, source: Column) -> str:
    step = float(np.median(np.diff(t)))
    what = f"the median step of t is {step:g} s over {t.size} samples"
    fits = _scales(step)
    if not fits:
        low, high = USUAL_RATES
        return (
            f"{what}, and no unit of time makes a rate of {low:g} to {high:g} Hz of it; t must be "
            "in seconds"
        )
    rates = " or ".join(f"{scale:g} makes {1 / (scale * step):g} Hz" for scale in fits)
    return (
        f"{what}, so t is not in seconds: a factor of {rates}; in mechanism.toml: "
        f"{_entry(source.column, source.scale * fits[0])}"
    )


def _no_time(table: RawTable) -> str:
    if "t" in table.ignored:
        return f"column 't' {table.ignored['t']}; it must be a number of seconds"
    steps = {name: np.diff(x) for name, x in table.columns.items()}
    increasing = {name for name, step in steps.items() if step.size and (step > 0).all()}
    named = {name for name in steps if TIME_NAME.search(name)}
    falling = {n for n in named if _swings(steps[n])}
    # counts of an encoder that turns one way increase too, but not by the same steps
    steady = {n for n in increasing if _is_steady(steps[n])}
    marks = {n: 2 * (n in named - falling) + (n in (steady | named) & increasing) for n in steps}
    best, *others = sorted((n for n in marks if marks[n]), key=lambda n: -marks[n]) or [""]
    if not best:
        text = [name for name in table.ignored if TIME_NAME.search(name)]
        none = "".join(f"; column {name!r} {table.ignored[name]}" for name in text)
        none += "".join(f"; column {n!r} goes up and down, so it is no clock" for n in falling)
        return (
            "no time column 't', and none that looks like a time; a column t [s] is needed; "
            f"the file has: {shortlist([*table.columns], LISTED) or 'no column of numbers'}{none}"
        )
    step = float(np.median(steps[best])) if best in increasing else 0.0
    scale = (_scales(step) or [1.0])[0] if step > LONGEST_STEP else 1.0
    similar = f" (so do: {', '.join(others[:5])})" if others else ""
    return (
        f"no time column 't'; {best!r} looks like a time{similar}; name it t, "
        f"or write in mechanism.toml: {_entry(best, scale)}"
    )


def _swings(steps: Array) -> bool:
    """Return whether steps (n,) go up and down, more often than a clock that is reset."""
    least = min(float(np.mean(steps < 0)), float(np.mean(steps > 0))) if steps.size else 0.0
    return steps.size >= FEWEST_SAMPLES and least > RESETS


def _is_steady(steps: Array) -> bool:
    """Return whether most steps (n,) are the median one, as those of a clock are."""
    median = float(np.median(steps))
    return bool(np.mean(np.abs(steps - median) <= UNSTEADY * median) >= MOST_STEPS)


def _scales(step: float) -> list[float]:
    low, high = USUAL_RATES
    return [x for x in UNITS if low <= 1 / (x * step) < high and (x < 1) == (step > LONGEST_STEP)]


def _entry(column: str, scale: float) -> str:
    quoted = json.dumps(column, ensure_ascii=False)  # a TOML basic string too
    return f'[log] "t" = {quoted if scale == 1 else f"{{ column = {quoted}, scale = {scale:g} }}"}'


def entry_for(signal: str, joints: Sequence[str], columns: Iterable[str]) -> str:
    """Return the entry of [log] that columns suggest by joints' names or numbers, or ""."""
    names = sorted(columns, key=lambda name: bool(ORDERED.search(name)))
    for joint in joints:
        stem = joint.rstrip("0123456789")
        for before in ("", stem):  # joints may have only their numbers in common with columns
            tag = joint.removeprefix(before)
            of = [x for x in names if (re.findall(r"\d+", x) == [tag] if before else tag in x)]
            matching = next((x for x in of if WORDS[signal].search(x.replace(tag, ""))), "")
            if not matching:
                continue
            numbers, numbered = _by_number(
                joint, joints, matching, matching.index(tag) + len(tag), names
            )
            lone = (
                numbered.keys() - numbers.keys()
            )  # where columns count from 0, one more may be any
            if lone and ("0" in lone or numbers.keys() - numbered.keys()):
                pairs = [*zip(sorted(numbers, key=int), sorted(numbered, key=int), strict=False)]
                apart = {int(b) - int(a) for a, b in pairs}
                if len(numbers) != len(numbered) or apart not in ({1}, {-1}) or "0" not in pairs[0]:
                    continue  # which column is of which joint is open
                ends = (pairs[0], pairs[-1])
                return ", … ".join(f'"{signal}.{numbers[a]}" = "{numbered[b]}"' for a, b in ends)
            pattern = matching.replace(tag, "*")
            matching_joints = [
                x for x in joints if pattern.replace("*", x.removeprefix(before)) in names
            ]
            if len(matching_joints) > 1 and pattern.count("*") == 1:
                return f'"{signal}.{before}*" = "{pattern}"'
            return _lone(signal, joint, matching, joints)
    for joint in joints:  # in another spelling, with the same numbers
        number = re.findall(r"\d+", joint)
        by_spelling = {x.casefold(): x for x in names if re.findall(r"\d+", x) == number}
        if like := get_close_matches(f"{signal}.{joint}".casefold(), by_spelling, 1, SIMILAR_NAMES):
            return _lone(signal, joint, by_spelling[like[0]], joints)
    return ""


def _lone(signal: str, joint: str, column: str, joints: Sequence[str]) -> str:
    more = ", and so on for the others" if len(joints) > 1 else ""
    return f'"{signal}.{joint}" = "{column}"{more}'


def _by_number(
    joint: str, joints: Iterable[str], column: str, end: int, columns: Iterable[str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Return the joints and the columns that differ from these in a number alone, by that; in the
    column it stops at `end`.

    >>> _by_number("j1", ["j1", "j2"], "q1", 2, ["q0", "q1", "v0"])
    ({'1': 'j1', '2': 'j2'}, {'0': 'q0', '1': 'q1'})
    """
    stem = joint.rstrip("0123456789")
    start = end - len(joint) + len(stem)
    if start == end:
        return {}, {}
    both = []
    for before, after, names in ((stem, "", joints), (column[:start], column[end:], columns)):
        rule = re.compile(f"{re.escape(before)}(\\d+){re.escape(after)}")
        both.append({match[1]: name for name in names if (match := rule.fullmatch(name))})
    return both[0], both[1]


def _count(n: int, what: str) -> str:
    return f"{n} {what}" + ("" if n == 1 else "s")


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
        poses: whether each row is an average over a machine at rest; `t` is its number then.
    """

    name: str
    columns: Mapping[str, Array]
    t: Array
    repairs: tuple[str, ...] = ()
    sha256: str = ""
    poses: bool = False

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
        return cls.from_table(name, RawTable(name, arrays), poses=False)

    @classmethod
    def from_frame(
        cls,
        frame: Any,
        name: str = "frame",
        columns: Mapping[str, Column] | None = None,
        poses: bool | None = None,
    ) -> Log:
        """A log from a polars or pandas data frame, checked and repaired as a file is.

        Args:
            frame: a row a sample, columns named as a file's. A pandas index that is named `t`, or
                holds times, is `t`.
            name: what messages and tables call it.
            columns: ident's names to the frame's columns; poses: both as `read_log` takes them.

        Raises:
            LogError: where `read_log` would, and for anything but a data frame.
        """
        mapping = columns or {}
        table = frame_table(name, frame, {source.column for source in mapping.values()})
        return cls.from_table(name, table, mapping, poses=poses)

    @classmethod
    def from_table(
        cls,
        name: str,
        table: RawTable,
        columns: Mapping[str, Column] | None = None,
        sha256: str = "",
        poses: bool | None = None,
    ) -> Log:
        """Check and repair columns under the file's own names.

        Args:
            name: what messages and tables call it.
            table: of a file or of memory.
            columns: ident's names to the file's columns.
            sha256: of the file's bytes.
            poses: whether its rows are poses, without order; None decides it by the rows.

        Raises:
            LogError: where `read_log` would.
        """
        mapping = columns or {}
        table = renamed(table, mapping)
        if poses is None:
            poses = are_poses(table.columns, table.columns.get("t"))
        table = without_clock(table) if poses else with_clock(table, mapping.get("t"))
        values = {key: x for key, x in table.columns.items() if key != "t"}
        return cls(name, values, table.columns["t"], table.repairs, sha256, poses)

    def as_poses(self) -> Log:
        """The same rows as poses, each an average over a machine at rest."""
        return replace(self, t=np.arange(len(self.t), dtype=float), poses=True)

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
        if _is_whole(x):
            return self.t, x
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

        Column `t` comes first, unless rows are poses, then the others as stored. Raises LogError
        for another suffix and where the file cannot be written.
        """
        time = {} if self.poses else {"t": self.t}
        write_table(Path(path), {**time, **self.columns})

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    def __reduce__(self) -> tuple[type[Log], tuple[object, ...]]:
        # a mappingproxy cannot be pickled, and unpickled arrays are writable
        return Log, (
            self.name, dict(self.columns), self.t, self.repairs, self.sha256, self.poses,
        )  # fmt: skip


@once_a_series
def _is_whole(x: Array) -> bool:
    """Return whether a series has a value in every sample."""
    return bool(np.isfinite(x).all())


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
