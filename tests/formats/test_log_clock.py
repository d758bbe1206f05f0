"""Time: repaired where that is safe, refused with a remedy where not."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from ident.errors import LogError
from ident.log import Column, Log, read_log

T = [k / 100 for k in range(12)]


def rows(t: Sequence[object], header: str = "t,q.a") -> str:
    return "\n".join([header, *(f"{stamp},{index}" for index, stamp in enumerate(t))])


def steps(step: float, n: int = 200) -> str:
    return rows([step * k for k in range(n)])


BAD = {
    "empty cells": (rows([*T[:3], "", "nan", *T[5:]]), ("2 rows", "line 5", "remove")),
    "backward": (rows([*T, *T]), ("line 14", "0.0 after 0.11", "split")),
    "backward by little": (
        rows([1.7e9 + stamp for stamp in [*T[:5], T[3], *T[5:]]]),
        ("line 7", "1700000000.03 after 1700000000.04", "split"),
    ),
    "too short": (rows(T[:9]), ("9 samples", "at least 10")),
    "all the same": (rows([1.0] * 30), ("1 sample ", "at least 10")),
    "milliseconds": (steps(1), ("0.001 makes 1000 Hz", 'column = "t", scale = 0.001')),
    "microseconds": (steps(1000), ("1e-06 makes 1000 Hz", "scale = 1e-06")),
    "nanoseconds": (steps(1e6), ("1e-09 makes 1000 Hz", "scale = 1e-09")),
    "milli or micro": (steps(20), ("0.001 makes 50 Hz or 1e-06 makes 50000 Hz", "= 0.001")),
    "no unit at all": (steps(1e15), ("no unit", "10 to 100000 Hz", "seconds")),
}


@pytest.mark.parametrize(("content", "says"), BAD.values(), ids=BAD)
def test_these_are_refused(
    csv: Callable[..., Path], refused: Callable[..., str], content: str, says: tuple[str, ...]
) -> None:
    refused(csv(content), says)


NAMELESS = {
    "by name": ("time", T, ("'time' looks", "name it t", '"t" = "time"')),
    "by unit": ("stamp_ms", range(200), ("'stamp_ms'", 'column = "stamp_ms", scale = 0.001')),
    "unit in brackets": ("T [s]", T, ("'T [s]'", '"t" = "T [s]"')),
    "quotes in its name": ('"time ""rig"""', T, (r'"t" = "time \"rig\""',)),
    "with a reset": ("timestamp", [*range(8)] * 2, ("'timestamp' looks", '"t" = "timestamp"')),
    "not even increasing": ("timestamp", [1, 2] * 6, ("'timestamp' goes up and down",)),
    "text": ("timestamp", ["12:00"] * 12, ("a column t [s] is needed", "'timestamp' holds text")),
    "none": ("q.b", [0, 1] * 6, ("none that looks like a time", "q.b and tau")),
}


@pytest.mark.parametrize(("name", "t", "says"), NAMELESS.values(), ids=NAMELESS)
def test_without_t_the_likely_column_is_named(
    csv: Callable[..., Path],
    refused: Callable[..., str],
    name: str,
    t: Sequence[object],
    says: tuple[str, ...],
) -> None:
    lines = [f"{stamp},{(-1) ** index}" for index, stamp in enumerate(t)]
    refused(csv("\n".join([f"{name},tau", *lines])), ("'t'", *says))


def test_an_increasing_column_is_a_likely_time(
    csv: Callable[..., Path], refused: Callable[..., str]
) -> None:
    content = "\n".join(["q.a,n,time", *(f"{(-1) ** k},{k},{k / 100}" for k in range(12))])
    refused(csv(content), ("'time' looks like a time (so do: n)",))


def test_remedy_takes_the_scale_there_is_into_account(
    csv: Callable[..., Path], refused: Callable[..., str]
) -> None:
    path = csv(rows([1e6 * k for k in range(200)], header="stamp,q.a"))
    says = ('column = "stamp", scale = 1e-09',)
    refused(path, says, {"t": Column("stamp", 0.001)})


def test_repeated_stamps_keep_the_first_and_say_so(read: Callable[..., Log]) -> None:
    t = [*T[:4], T[3], T[3], *T[4:], T[-1]]
    log = read(rows(t))
    np.testing.assert_array_equal(log.t, T)
    np.testing.assert_array_equal(log.columns["q.a"], [0, 1, 2, 3, 6, 7, 8, 9, 10, 11, 12, 13])
    assert log.repairs == ("3 repeated time stamps, first at line 6: the first value of each kept",)


def test_merged_loggers_share_stamps_without_losing_either() -> None:
    t = np.repeat(T, 2)
    q, tau = np.full(24, np.nan), np.full(24, np.nan)
    q[0::2], tau[1::2] = np.arange(12), -np.arange(12)
    log = Log.from_arrays("merged", t, {"q.a": q, "tau.a": tau})
    np.testing.assert_array_equal(log.columns["q.a"], np.arange(12))
    np.testing.assert_array_equal(log.columns["tau.a"], -np.arange(12))
    assert "12 repeated" in log.repairs[0]


def test_slow_but_short_logs_and_epoch_stamps_are_kept(read: Callable[..., Log]) -> None:
    assert read(steps(10.0, n=50)).rate == pytest.approx(0.1)
    epoch = [1.7e9 + stamp for stamp in T]
    log = read(rows(epoch))
    np.testing.assert_array_equal(log.t, epoch)
    assert log.repairs == ()


ARRAYS = {
    "backward": (T[::-1], {}, ("index 1", "0.1 after 0.11", "split")),
    "nan": ([*T[:5], np.nan, *T[6:]], {}, ("1 row,", "index 5", "remove")),
    "infinite": (T, {"q.a": [*T[:5], np.inf, *T[6:]]}, ("'q.a'", "index 5", "inf", "NaN")),
    "length": (T, {"q.a": T[:5]}, ("'q.a'", "5 values", "t has 12")),
    "shape": (T, {"q.a": np.zeros((12, 2))}, ("'q.a'", "(12, 2)", "(n_samples,)")),
    "ragged": (T, {"q.a": [[1.0], [1.0, 2.0]]}, ("'q.a'", "(n_samples,)")),
    "complex": (T, {"q.a": np.ones(12) * 1j}, ("'q.a'", "complex", "numbers")),
    "text": (T, {"q.a": ["x"] * 12}, ("'q.a'", "numbers")),
    "t twice": (T, {"t": T}, ("'t'", "argument")),
    "name": (T, {"q\na": T}, ("'q\\na'", "one line")),
    "no name": (T, {" ": T}, ("' '", "one line")),
}


@pytest.mark.parametrize(("t", "columns", "says"), ARRAYS.values(), ids=ARRAYS)
def test_arrays_are_checked_as_files_are(
    t: list[float], columns: dict[str, object], says: tuple[str, ...]
) -> None:
    with pytest.raises(LogError) as caught:
        Log.from_arrays("made", t, columns)  # type: ignore[arg-type]
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert [part for part in ("made: ", *says) if part not in message] == []


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("count", np.cumsum(np.random.default_rng(0).integers(3, 8, 400)), "none that looks like"),
        ("time", (2048 + 600 * np.sin(np.arange(400) / 20)).round(), "'time' goes up and down"),
        ("ticks", 1000 + 5 * np.arange(400) + np.arange(400) % 2, "'ticks' looks like a time"),
    ],
)
def test_counts_of_an_encoder_are_no_clock(tmp_path, name, values, said):
    path = tmp_path / "log.csv"
    lines = [f"{int(value)},{np.sin(0.1 * k)}" for k, value in enumerate(values)]
    path.write_text("\n".join([f"{name},q.a", *lines]))
    with pytest.raises(LogError, match=said):
        read_log(path)
