"""The noun: what it answers, that it cannot change, and how it prints."""

import copy
import pickle
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from ident.errors import LogError
from ident.log import Log


@pytest.fixture
def log() -> Log:
    """1 kHz, one step of 1.5 ms, a gap of 0.2 s; torque at a fifth of the rate."""
    step = np.full(200, 1e-3)
    step[[10, 50]] = 1.5e-3, 0.2
    t = np.cumsum(step)
    tau = np.where(np.arange(200) % 5 == 0, np.sin(t), np.nan)
    return Log.from_arrays("run.csv", t, {"q.a": np.cos(t), "tau.a": tau})


def test_series_has_the_finite_samples_only(log: Log) -> None:
    t, tau = log.series("tau.a")
    np.testing.assert_array_equal(t, log.t[::5])
    np.testing.assert_array_equal(tau, np.sin(log.t[::5]))
    with pytest.raises(LogError, match=r"run\.csv: no column 'tau\.b'; did you mean 'tau\.a'"):
        log.series("tau.b")


def test_names(log: Log) -> None:
    assert "q.a" in log
    assert "q.b" not in log
    assert "t" not in log


def test_clock(log: Log) -> None:
    assert log.rate == pytest.approx(1000.0)
    assert log.duration == pytest.approx(197e-3 + 1.5e-3 + 0.2)
    largest, rms = log.jitter
    assert largest == pytest.approx(0.199)
    assert rms == pytest.approx(np.sqrt((0.199**2 + 0.0005**2) / 199))
    assert log.gaps() == [(log.t[49], log.t[50])]
    assert log.gaps(factor=1.2) == [(log.t[9], log.t[10]), (log.t[49], log.t[50])]
    assert log.gaps(factor=1000) == []


def test_nothing_can_change(log: Log) -> None:
    with pytest.raises(FrozenInstanceError):
        log.t = log.t + 1  # type: ignore[misc]
    with pytest.raises(TypeError):
        log.columns["q.b"] = log.t  # type: ignore[index]
    for x in (log.t, log.columns["q.a"]):
        with pytest.raises(ValueError, match="read-only"):
            x[0] = 1.0


def test_the_callers_arrays_are_not_held() -> None:
    t, q = np.arange(12.0), np.zeros(12)
    window = q.view()
    window.setflags(write=False)  # read-only, but its owner is not
    log = Log.from_arrays("made", t, {"q": q, "w": window})
    t[:], q[:] = 0.0, 1.0
    assert log.t[-1] == 11.0
    assert not log.columns["q"].any()
    assert not log.columns["w"].any()
    assert t.flags.writeable


@pytest.mark.parametrize("again", [copy.deepcopy, lambda log: pickle.loads(pickle.dumps(log))])
def test_copies_are_whole_and_immutable(log: Log, again: type) -> None:
    other = again(log)
    np.testing.assert_array_equal(other.t, log.t)
    np.testing.assert_array_equal(other.columns["tau.a"], log.columns["tau.a"])
    assert (other.name, other.repairs, list(other.columns)) == (
        log.name,
        log.repairs,
        list(log.columns),
    )
    assert not other.columns["q.a"].flags.writeable


@pytest.mark.parametrize("t", [[0.0, 1.0, 1.0], [0.0, np.nan, 1.0], [0.0], [2.0, 1.0]])
def test_the_constructor_holds_the_clock(t: list[float]) -> None:
    with pytest.raises(LogError, match="made: t must be finite and increase"):
        Log("made", {}, np.array(t))


def test_it_prints_itself(log: Log) -> None:
    assert repr(log).splitlines() == [
        "Log 'run.csv'",
        "  samples  200 in 0.3985 s",
        "  rate     1000 Hz, jitter 199 ms max, 14.1 ms rms",
        "  columns  q.a, tau.a (40 samples)",
        "  gaps     1, longest 0.2 s at t = 0.0505 s",
        "  repairs  none",
    ]


def test_html_is_escaped() -> None:
    t = np.repeat(np.arange(12.0), 2)
    page = Log.from_arrays("<b>.csv", t, {"<script>": t})._repr_html_()
    assert "&lt;b&gt;.csv" in page
    assert "&lt;script&gt;" in page
    assert "<script>" not in page
    assert "12 repeated time stamps" in page
