"""Check that `t` is finite, strictly increasing and in seconds; name the remedy where it is not."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ident.errors import LogError
from ident.log.table import Array, Column, RawTable

FEWEST_SAMPLES = 10
LONGEST_STEP = 0.5  # [s] a log of more than 100 samples with a longer median step is not in seconds
USUAL_RATES = (10.0, 100e3)  # [Hz]
SMALLER_UNITS = (1e-3, 1e-6, 1e-9)  # [s] ms, us, ns
TIME_NAME = re.compile(r"time|stamp|clock|^t([^a-z]|$)|^(ts|secs?|seconds)$|_(ms|us|ns)$", re.I)


def with_clock(table: RawTable, source: Column | None = None) -> RawTable:
    """Return the table with a strictly increasing `t` [s]; of repeated stamps the first stays.

    `table` is under ident's names; `source` is the file's column of `t`, for the message.
    """
    if "t" not in table.columns:
        raise LogError(f"{table.file}: {_no_time(table)}")
    t = table.columns["t"]
    empty = np.flatnonzero(np.isnan(t))
    if empty.size:
        raise LogError(
            f"{table.file}: t is empty in {_count(empty.size, 'row')}, first at "
            f"{table.where(int(empty[0]))}; every row needs its time: remove these rows"
        )
    step = np.diff(t)
    if (step < 0).any():
        row = int((step < 0).argmax()) + 1
        raise LogError(
            f"{table.file}: t goes backward at {table.where(row)}: {float(t[row])} after "
            f"{float(t[row - 1])} (a clock reset, or two logs in one file?); split the file there"
        )
    repeats = np.flatnonzero(step == 0) + 1
    if repeats.size:
        run = np.concatenate([[0], np.cumsum(step > 0)])  # (n_rows,) which stamp a row belongs to
        note = (
            f"{_count(repeats.size, 'repeated time stamp')}, first at "
            f"{table.where(int(repeats[0]))}: the first value of each kept"
        )
        columns = {name: _first_of_runs(x, run) for name, x in table.columns.items()}
        repairs = (*table.repairs, note)
        table = replace(table, columns=columns, repairs=repairs, lines=None)  # rows are no lines
        t = table.columns["t"]
    if t.size < FEWEST_SAMPLES:
        raise LogError(
            f"{table.file}: {_count(t.size, 'sample')} of different times; "
            f"at least {FEWEST_SAMPLES} are needed"
        )
    if t.size > 100 and np.median(np.diff(t)) > LONGEST_STEP:
        raise LogError(f"{table.file}: {_wrong_unit(t, source or Column('t'))}")
    return table


def _first_of_runs(x: Array, run: NDArray[np.int64]) -> Array:
    first = np.full(int(run[-1]) + 1, np.nan)
    known = np.flatnonzero(~np.isnan(x))[::-1]
    first[run[known]] = x[known]  # of several, the last assignment stays: the run's first
    return first


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
    marks = {name: 2 * bool(TIME_NAME.search(name)) + (name in increasing) for name in steps}
    best, *others = sorted((n for n in marks if marks[n]), key=lambda n: -marks[n]) or [""]
    if not best:
        text = [name for name in table.ignored if TIME_NAME.search(name)]
        none = "".join(f"; column {name!r} {table.ignored[name]}" for name in text)
        return (
            "no time column 't', and none that looks like a time; a column t [s] is needed; "
            f"the file has: {', '.join(table.columns) or 'no column of numbers'}{none}"
        )
    step = float(np.median(steps[best])) if best in increasing else 0.0
    scale = (_scales(step) or [1.0])[0] if step > LONGEST_STEP else 1.0
    alike = f" (so do: {', '.join(others[:5])})" if others else ""
    return (
        f"no time column 't'; {best!r} looks like a time{alike}; name it t, "
        f"or write in mechanism.toml: {_entry(best, scale)}"
    )


def _scales(step: float) -> list[float]:
    low, high = USUAL_RATES
    return [scale for scale in SMALLER_UNITS if low <= 1 / (scale * step) < high]


def _entry(column: str, scale: float) -> str:
    quoted = json.dumps(column, ensure_ascii=False)  # a TOML basic string too
    return f'[log] "t" = {{ column = {quoted}, scale = {scale if scale == 1 else f"{scale:g}"} }}'


def _count(n: int, what: str) -> str:
    return f"{n} {what}" + ("" if n == 1 else "s")
