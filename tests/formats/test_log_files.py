"""Parquet, NumPy archives, writing, and files that cannot be opened."""

import hashlib
import json
import os
import zipfile
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from ident.errors import LogError
from ident.log import Column, Log, read_log

SUFFIXES = [".csv", ".parquet", ".npz"]


@pytest.fixture
def log() -> Log:
    """Awkward on purpose: all magnitudes, mixed rates, names that formats stumble over."""
    rng = np.random.default_rng(1)
    wild = rng.integers(-(2**63), 2**63, 400, dtype=np.int64).view(np.float64)
    wild[~np.isfinite(wild)] = -0.0
    tau = rng.normal(size=400)
    tau[np.arange(400) % 5 > 0] = np.nan
    t = 1.7e9 + np.cumsum(rng.uniform(0.9e-3, 1.1e-3, 400))
    names = {"q.a": wild, "tau.a": tau, "file": 1 / (1 + np.arange(400)), 'a, "b"; c': tau}
    return Log.from_arrays("made", t, names | {"wrench.tool.fx": np.full(400, 5e-324)})


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".CSV"])
def test_written_and_read_again_bit_for_bit(log: Log, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    log.write(path)
    back = read_log(path)
    assert list(back.columns) == list(log.columns)
    assert back.t.tobytes() == log.t.tobytes()
    for name, x in log.columns.items():
        np.testing.assert_array_equal(np.isnan(back.columns[name]), np.isnan(x))
        known = ~np.isnan(x)
        assert back.columns[name][known].tobytes() == x[known].tobytes()
    assert back.name == path.name
    assert back.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert back.repairs == ()


def test_csv_is_plain_to_read(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    x = [0.1] + [np.nan] * 11
    Log.from_arrays("made", np.arange(12.0), {"q.a": x, "b": np.arange(12)}).write(path)
    assert path.read_text().splitlines()[:3] == ["t,q.a,b", "0.0,0.1,0.0", "1.0,,1.0"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_failed_write_leaves_what_was_there(
    log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    path = tmp_path / f"run{suffix}"
    path.write_text("before")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(LogError, match=r"run\.[a-z]+: cannot be written \(No space"):
        log.write(path)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "says"),
    [("run.xlsx", "valid: .csv, .parquet, .npz"), ("none/run.csv", "No such file"), ("run", "''")],
)
def test_where_a_log_cannot_be_written(log: Log, tmp_path: Path, name: str, says: str) -> None:
    with pytest.raises(LogError) as caught:
        log.write(tmp_path / name)
    assert says in str(caught.value)
    assert "run" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_parquet_types(tmp_path: Path) -> None:
    start = datetime(2026, 1, 2)
    frame = pl.DataFrame(
        {
            "t": [start + timedelta(milliseconds=10 * k) for k in range(12)],
            "age": [timedelta(seconds=5 + k) for k in range(12)],
            "n": pl.Series(range(12), dtype=pl.UInt16),
            "x": pl.Series([None, *range(11)], dtype=pl.Float32),
            "on": [True, False, None] * 4,
            "mode": ["auto"] * 12,
            "digits": [str(k) for k in range(12)],
            "kind": pl.Series(["a"] * 12, dtype=pl.Categorical),
            "cov": [[1.0, 2.0]] * 12,
            "tags": [["a"]] * 12,
            "void": [None] * 12,
        }
    )
    frame.write_parquet(tmp_path / "run.parquet")
    log = read_log(tmp_path / "run.parquet")
    k = np.arange(12.0)
    np.testing.assert_allclose(log.t, k / 100, rtol=1e-15)
    np.testing.assert_array_equal(log.columns["age"], k)
    np.testing.assert_array_equal(log.columns["n"], k)
    np.testing.assert_array_equal(log.columns["x"], [np.nan, *k[:11]])
    np.testing.assert_array_equal(log.columns["on"], [1, 0, np.nan] * 4)
    np.testing.assert_array_equal(log.columns["digits"], k)
    assert set(log.columns) == {"age", "n", "x", "on", "digits", "cov.0", "cov.1", "void"}
    said = "; ".join(log.repairs)
    for part in (
        "column 't' held Datetime",
        "now seconds since its first value",
        "column 'age' held Duration",
        "column 'mode' holds text ('auto'), left out",
        "column 'kind' holds text ('a'), left out",
        "column 'tags' holds List(String), left out",
        "column 'void' is empty",
    ):
        assert part in said


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_stamps_keep_their_resolution(tmp_path: Path, unit: str) -> None:
    ticks = 1_700_000_000_000_000_001 + np.arange(12)
    stamps = pl.Series(ticks if unit == "ns" else ticks % 10**15).cast(pl.Datetime(unit))  # type: ignore[arg-type]
    pl.DataFrame({"stamp": stamps}).write_parquet(tmp_path / "run.parquet")
    log = read_log(tmp_path / "run.parquet", {"t": Column("stamp")})
    np.testing.assert_array_equal(log.t, np.arange(12) / {"ms": 1e3, "us": 1e6, "ns": 1e9}[unit])


def test_time_series_of_mujocos_identification(tmp_path: Path) -> None:
    t = 0.01 * np.arange(12)
    data = np.arange(60.0).reshape(12, 5)
    signals = {
        "elbow_qpos": [2, [0]], "elbow_qvel": [3, [1]], "servo_ctrl": [5, [2]],
        "force": [0, [3, 4]],
    }  # fmt: skip
    path = tmp_path / "series.npz"
    np.savez(path, times=t, data=data, signal_mapping=np.asarray(json.dumps(signals)))
    log = read_log(path, {"ref.elbow": Column("servo_ctrl")})
    assert np.array_equal(log.t, t)
    for name, place in {"q.elbow": 0, "v.elbow": 1, "ref.elbow": 2}.items():
        assert np.array_equal(log.columns[name], data[:, place])
    np.savez(path, times=t, data=data, signal_mapping=np.asarray('{"q": [2, [7]]}'))
    with pytest.raises(LogError, match=r"signal 'q' is at .7., and 'data' has 5 columns"):
        read_log(path)


def test_npz_types(tmp_path: Path) -> None:
    k = np.arange(12)
    stamp = np.datetime64("2026-01-02") + k * np.timedelta64(10, "ms")
    np.savez(
        tmp_path / "run.npz",
        t=stamp,
        n=k.astype(">i2"),
        wide=k.astype(np.longdouble),
        on=k > 5,
        mode=np.array(["auto"] * 12),
        raw=np.array([b"x"] * 12),
    )
    log = read_log(tmp_path / "run.npz")
    np.testing.assert_allclose(log.t, k / 100, rtol=1e-15)
    np.testing.assert_array_equal(log.columns["n"], k)
    np.testing.assert_array_equal(log.columns["wide"], k)
    np.testing.assert_array_equal(log.columns["on"], k > 5)
    assert set(log.columns) == {"n", "wide", "on"}
    assert [repair.split()[1] for repair in log.repairs] == ["'t'", "'mode'", "'raw'"]


ARRAYS = {
    "2-D": ({"q": np.zeros((12, 3))}, ("'q'", "(12, 3)", "1-D")),
    "scalar": ({"fs": np.float64(100)}, ("'fs'", "()", "1-D")),
    "lengths": ({"q": np.zeros(11)}, ("'t' has 12", "'q' has 11", "NaN")),
    "objects": ({"q": np.array([None] * 12)}, ("'q'", "pickles", "1-D arrays of numbers")),
    "complex": ({"q": np.zeros(12, complex)}, ("'q'", "complex128", "1-D arrays of numbers")),
    "infinite": ({"q": np.array([0.0] * 11 + [np.inf])}, ("'q'", "index 11", "inf")),
    "text among numbers": ({"q": np.array(["1"] * 11 + ["x"])}, ("'q'", "index 11", "'x'")),
}


@pytest.mark.parametrize(("arrays", "says"), ARRAYS.values(), ids=ARRAYS)
def test_archives_that_are_refused(
    tmp_path: Path,
    refused: Callable[..., str],
    arrays: dict[str, np.ndarray],
    says: tuple[str, ...],
) -> None:
    path = tmp_path / "run.npz"
    np.savez(path, t=np.arange(12) / 100, **arrays)
    refused(path, says)


def test_an_archive_of_something_else(tmp_path: Path, refused: Callable[..., str]) -> None:
    with zipfile.ZipFile(tmp_path / "run.npz", "w") as archive:
        archive.writestr("word/document.xml", "<xml/>")
    refused(tmp_path / "run.npz", ("'word/document.xml' is not an array", "1-D"))


def test_other_things_than_logs(tmp_path: Path, refused: Callable[..., str]) -> None:
    for suffix, says in ((".parquet", "Parquet"), (".npz", "np.savez")):
        path = tmp_path / f"run{suffix}"
        for content in (b"", b"t,q\n0,1\n", b"PAR1 PAR1", b"PK\3\4 cut off"):
            path.write_bytes(content)
            refused(path, ("not a", says))
    with (tmp_path / "one.npz").open("wb") as stream:
        np.save(stream, np.arange(12.0))
    refused(tmp_path / "one.npz", ("single array", "np.savez"))


def test_a_panic_of_the_parquet_reader_is_an_error_like_any_other(
    tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def panic(*_: object) -> None:  # damaged pages do this, and it is no Exception
        raise pl.exceptions.PanicException("assertion failed: offset + length <= self.length")

    monkeypatch.setattr(pl, "read_parquet", panic)
    (tmp_path / "run.parquet").write_bytes(b"PAR1")
    refused(tmp_path / "run.parquet", ("damaged", "write it again"))


def test_paths_that_are_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "run.csv").write_text("")
    (tmp_path / "folder.csv").mkdir()
    refused(tmp_path / "rum.csv", ("no such file", "did you mean 'run.csv'"))
    refused(tmp_path / "none" / "run.csv", ("no such file", "no folder"))
    refused(tmp_path / "folder.csv", ("folder", "name one file", ".npz"))
    refused(tmp_path / "run.txt", ("'.txt'", "valid: .csv, .parquet, .npz"))
    refused(tmp_path / "run", ("no such file", "did you mean 'run.csv'"))
    (tmp_path / "bare").write_text("")
    refused(tmp_path / "bare", ("''", "valid: .csv, .parquet, .npz"))
    refused(tmp_path / "run.csv" / "run.csv", ("cannot be read", "Not a directory"))


def test_permission(
    tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(*_: object) -> None:  # root may read everything, so no real file shows it
        raise PermissionError(13, "Permission denied")

    (tmp_path / "run.csv").write_text("t\n")
    monkeypatch.setattr(Path, "open", denied)
    refused(tmp_path / "run.csv", ("cannot be read (Permission denied)", "that you may read"))
