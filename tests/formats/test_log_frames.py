"""Data frames in and out: the same checks and repairs as files."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import ident
from helpers import ROBOTS
from ident.errors import LogError
from ident.log import Column, Log, read_log

pd = pytest.importorskip("pandas")

N = 20
T = 0.01 * np.arange(N)
X = np.sin(T)
GAPPY = np.where(np.arange(N) % 3, X, np.nan)
KINDS: dict[str, Callable[..., Any]] = {"polars": pl.DataFrame, "pandas": pd.DataFrame}


@pytest.mark.parametrize("kind", KINDS)
def test_a_frame_is_what_its_file_would_be(kind: str, tmp_path: Path) -> None:
    cells = {
        "t": [*T[:5], T[4], *T[6:]],
        "q.a": GAPPY,
        "n": range(N),
        "on": [True, False] * (N // 2),
        "mode": ["auto"] * N,
        "digits": [str(k) for k in range(N)],
        "void": [None] * N,
    }
    log = Log.from_frame(KINDS[kind](cells), "run.csv")
    pl.DataFrame(cells, strict=False).fill_nan(None).write_csv(tmp_path / "run.csv")
    file = read_log(tmp_path / "run.csv")
    np.testing.assert_array_equal(log.t, file.t)
    assert set(log.columns) == set(file.columns)
    for name, x in file.columns.items():
        np.testing.assert_array_equal(log.columns[name], x)
    assert [r.replace("line 7", "index 5") for r in file.repairs] == list(log.repairs)


@pytest.mark.parametrize("kind", KINDS)
def test_there_and_back(kind: str) -> None:
    log = Log.from_arrays("made", T + 1.7e9, {"q.a": GAPPY, "tau.a": X})
    back = Log.from_frame(getattr(log, kind)())
    assert back.t.tobytes() == log.t.tobytes()
    assert list(back.columns) == list(log.columns)
    for name, x in log.columns.items():
        np.testing.assert_array_equal(back.columns[name], x)
    assert back.repairs == ()


def test_frames_say_what_is_empty() -> None:
    log = Log.from_arrays("made", T, {"q.a": GAPPY})
    assert log.polars().columns == ["t", "q.a"]
    assert log.polars()["q.a"].null_count() == int(np.isnan(GAPPY).sum())
    assert log.pandas().index.name == "t"
    assert log.pandas()["q.a"].isna().sum() == np.isnan(GAPPY).sum()


STAMPS = [datetime(2026, 1, 2) + timedelta(milliseconds=10 * k) for k in range(N)]
INDICES = {
    "named t": pd.Index(T, name="t"),
    "durations": pd.to_timedelta(T + 5, unit="s"),
    "stamps": pd.DatetimeIndex(STAMPS),
    "stamps of a name": pd.DatetimeIndex(STAMPS, name="stamp"),
    "stamps of a zone": pd.DatetimeIndex([s.replace(tzinfo=UTC) for s in STAMPS]),
}


@pytest.mark.parametrize("index", INDICES.values(), ids=INDICES)
def test_a_pandas_index_that_is_a_time(index: Any) -> None:
    log = Log.from_frame(pd.DataFrame({"q.a": X}, index=index))
    np.testing.assert_allclose(log.t - log.t[0], T, atol=1e-9)
    assert set(log.columns) == {"q.a"}


def test_other_indices() -> None:
    """One that counts is nothing; one with a name is a column; `t` among the columns is `t`."""
    frame = pd.DataFrame({"t": T, "q.a": X}, index=pd.DatetimeIndex(STAMPS))
    np.testing.assert_array_equal(Log.from_frame(frame).t, T)
    frame = pd.DataFrame({"q.a": X}, index=pd.Index(1e3 * T, name="stamp_ms"))
    with pytest.raises(LogError, match="'stamp_ms' looks like a time"):
        Log.from_frame(frame)
    log = Log.from_frame(frame, columns={"t": Column("stamp_ms", 1e-3)})
    np.testing.assert_allclose(log.t, T, atol=1e-15)
    frame = pd.DataFrame({"q.a": X}, index=pd.DatetimeIndex(STAMPS, name="stamp"))
    log = Log.from_frame(frame, columns={"t": Column("stamp", 2.0)})
    np.testing.assert_allclose(log.t, 2 * T, atol=1e-9)
    many = pd.MultiIndex.from_arrays([range(N), range(N)], names=["a", "b"])
    assert set(Log.from_frame(pd.DataFrame({"t": T, "x": X}, index=many)).columns) == {"x"}


def test_types_of_pandas() -> None:
    frame = pd.DataFrame(
        {
            "t": T,
            "int": pd.array([1, None] * (N // 2), dtype="Int64"),
            "bool": pd.array([True, None] * (N // 2), dtype="boolean"),
            "float": pd.array([1.5, None] * (N // 2), dtype="Float32"),
            "text": pd.array(["1", None] * (N // 2), dtype="string"),
            "object": pd.Series([1, 2.5] * (N // 2), dtype=object),
            "kind": pd.Categorical(["a", "b"] * (N // 2)),
            "list": [[1, 2]] * N,
        }
    )
    log = Log.from_frame(frame)
    assert set(log.columns) == {"int", "bool", "float", "text", "object"}
    for name in ("int", "bool", "text"):
        np.testing.assert_array_equal(log.columns[name], [1, np.nan] * (N // 2))
    np.testing.assert_array_equal(log.columns["float"], [1.5, np.nan] * (N // 2))
    np.testing.assert_array_equal(log.columns["object"], [1, 2.5] * (N // 2))


BAD: dict[str, tuple[Any, str]] = {
    "a dict": ({"t": T}, "dict is no data frame"),
    "an array": (T, "ndarray is no data frame"),
    "a series": (pd.Series(T), "Series is no data frame"),
    "lazy": (pl.LazyFrame({"t": T}), r"frame\.collect\(\)"),
    "empty polars": (pl.DataFrame(), "no time column"),
    "empty pandas": (pd.DataFrame(), "no time column"),
    "no rows": (pd.DataFrame({"t": [], "x": []}), "at least 10"),
    "numbers as names": (pd.DataFrame(np.zeros((N, 2))), "column 0 is not named by text"),
    "two levels": (pd.DataFrame({("t", "s"): T}), "not named by text"),
    "doubled": (pd.DataFrame(np.zeros((N, 2)), columns=["t", "t"]), "two columns are named 't'"),
    "backward": (pl.DataFrame({"t": -T}), "goes backward at index 1"),
    "infinite": (pd.DataFrame({"t": T, "x": [np.inf] * N}), "'x', index 0: inf"),
    "text among numbers": (pd.DataFrame({"t": T, "x": ["1"] * 19 + ["?"]}), r"index 19: '\?'"),
    "empty time": (pd.DataFrame({"t": [np.nan] * N}), "t is empty in 20 rows"),
}  # fmt: skip


@pytest.mark.parametrize(("frame", "says"), BAD.values(), ids=BAD)
def test_frames_that_are_refused(frame: Any, says: str) -> None:
    with pytest.raises(LogError, match=says) as caught:
        Log.from_frame(frame, "mine")
    assert str(caught.value).startswith("mine: ")
    assert "\n" not in str(caught.value)


def test_pandas_is_not_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    code = (
        "import sys, ident; log = ident.read_log(sys.argv[1]); ident.Log.from_frame(log.polars()); "
        "assert 'pandas' not in sys.modules and 'rosbags' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code, ROBOTS / "arm" / "run.csv"], check=True)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(LogError, match="pip install pandas"):
        Log.from_arrays("made", T, {"x": X}).pandas()


@pytest.mark.parametrize("kind", KINDS)
def test_a_frame_is_completed_as_its_file_is(kind: str) -> None:
    file = ROBOTS / "arm" / "run.csv"
    mechanism = ident.load(ROBOTS / "arm")
    frame = pl.read_csv(file) if kind == "polars" else pd.read_csv(file)
    (e,) = ident.complete(mechanism, frame).experiments
    np.testing.assert_array_equal(e.q, ident.complete(mechanism, file).experiments[0].q)
    assert len(ident.complete(mechanism, [frame, file]).experiments) == 2
    with pytest.raises(LogError, match="int is no data frame"):
        ident.complete(mechanism, 3)
