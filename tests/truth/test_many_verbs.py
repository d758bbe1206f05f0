"""`diagnose`, `montecarlo` and `identify` over folders: what each log says; the command line."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import polars as pl
import pytest
from folders import arm, log_of, written

import ident
from helpers import ROBOTS
from ident.cli.app import main
from ident.errors import FitError

SWING = ROBOTS / "pendulum" / "run.csv"


@pytest.fixture(scope="module")
def without_elbow():
    """The model lacks the elbow's friction."""
    mechanism = ident.load(ROBOTS / "arm")
    for joint in ("yaw", "shoulder", "wrist"):
        mechanism = mechanism.with_effect(f"coulomb:{joint}")
    return mechanism


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two logs with friction in the elbow, one without, and one that is no log."""
    mechanism = arm()
    logs = {f"run_{i}.csv": log_of(mechanism, i, seconds=8) for i in range(2)}
    logs["run_2.csv"] = log_of(mechanism, 3, {"coulomb.elbow.Fc": 0.0}, seconds=8)
    found = written(tmp_path_factory.mktemp("logs"), logs)
    (found / "run_1b.csv").write_text("t,q.yaw\n0,1\n")
    return found


@pytest.fixture(scope="module")
def verdicts(without_elbow, folder):
    return ident.diagnose_each(without_elbow, folder, jobs=2)


def test_each_log_says_what_is_missing_in_it(verdicts):
    by_log = {each.log: each for each in verdicts.logs}
    assert list(by_log) == ["run_0.csv", "run_1.csv", "run_1b.csv", "run_2.csv"]
    for name in ("run_0.csv", "run_1.csv"):
        assert by_log[name].verdict == "missing"
        assert "coulomb:elbow" in by_log[name].named
        assert by_log[name].joint == "elbow"
        assert by_log[name].error_after < 0.1 * by_log[name].error_before
    assert (by_log["run_2.csv"].verdict, by_log["run_2.csv"].named) == ("nothing", ())
    assert "10 are needed" in by_log["run_1b.csv"].left_out


def test_together_they_say_it(verdicts):
    together = verdicts.together
    assert "coulomb:elbow" in {effect.label for effect in (together.best, *together.rivals)}
    assert "run_1b.csv: left out" in " ".join(verdicts.notes)


def test_jupyter_shows_each_log_and_all_together(verdicts):
    shown = verdicts._repr_html_()
    assert "each log by itself" in shown
    assert verdicts.together._repr_html_() in shown


def test_a_logs_verdict_is_that_of_the_log_alone(without_elbow, folder, verdicts):
    motion = ident.complete(without_elbow, ident.read_log(folder / "run_1.csv"))
    fit = ident.identify(without_elbow, motion, estimator="least-squares")
    alone = ident.diagnose(fit)
    (row,) = verdicts.table.filter(log="run_1.csv").to_dicts()
    assert row["verdict"] == alone.verdict
    assert row["named"].split() == [e.label for e in (alone.best, *alone.rivals)]
    assert row["error_before"] == pytest.approx(alone.candidates[0].error_before, rel=1e-9)


def test_verdicts_become_files(verdicts, tmp_path):
    names = {path.name for path in verdicts.write(tmp_path)}
    assert names == {"diagnosis.json", "logs.csv", "report.html"}
    assert "coulomb:elbow" in pl.read_csv(tmp_path / "logs.csv")["named"].to_list()[0]
    assert "Log by log" in (tmp_path / "report.html").read_text()


def test_no_log_left_to_diagnose(without_elbow, tmp_path):
    (tmp_path / "a.csv").write_text("t\n")
    with pytest.raises(FitError, match=r"none of 1 logs can be used; a\.csv"):
        ident.diagnose_each(without_elbow, tmp_path, jobs=1)


def test_of_logs_that_cannot_be_used_the_reason_of_most_is_said(without_elbow, tmp_path):
    (tmp_path / "a.csv").write_text("t\n")
    for name in ("b.csv", "c.csv"):
        (tmp_path / name).write_text("t,q.yaw\n0,0\n1,0\n")
    with pytest.raises(FitError, match=r"none of 3 logs.*; b\.csv: .*2 of them say the same"):
        ident.gather(without_elbow, tmp_path, jobs=1)


@pytest.fixture
def spoken(monkeypatch, capsys):
    """Status, output and error text of `ident`."""

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["ident", *map(str, words)])
        try:
            main()
            status = 0
        except SystemExit as stop:
            status = int(stop.code or 0)
        said = capsys.readouterr()
        return status, said.out, said.err

    return run


def test_identify_takes_a_folder(spoken, folder, tmp_path):
    status, out, err = spoken(
        "identify", ROBOTS / "arm", folder, "--with", "coulomb", "--jobs", "1", "--out",
        tmp_path / "out",
    )  # fmt: skip
    assert status == 0, err
    assert "coulomb.elbow.Fc" in out
    assert "run_2.csv disagrees with the others" in out
    assert "run_1b.csv: left out: " in err
    table = pl.read_csv(tmp_path / "out" / "logs.csv")
    assert table["log"].to_list() == ["run_0.csv", "run_1.csv", "run_2.csv", "run_1b.csv"]


def test_montecarlo_takes_a_folder(spoken, tmp_path):
    crank = ROBOTS / "slider_crank"
    (tmp_path / "run.csv").write_bytes((crank / "run.csv").read_bytes())
    (tmp_path / "no.csv").write_text("t\n")
    settings = ("--snr", "60", "--runs", "1", "--estimator", "paper", "--jobs", "1")
    status, out, err = spoken("montecarlo", crank, tmp_path, *settings)
    assert (status, "Monte Carlo of slider_crank on run.csv" in out) == (0, True), err
    assert "note: no.csv: left out: " in err
    (tmp_path / "run.csv").unlink()
    status, _, err = spoken("montecarlo", crank, tmp_path, *settings)
    assert status == 1
    assert err.startswith("error: none of 1 logs can be used: no.csv: ")


@pytest.mark.parametrize("command", ["identify", "diagnose"])
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--jobs", "0"], "jobs 0; valid: a whole number"),
        (["--jobs", "2", "--scheduler", "tcp://localhost:8786"], "give one of"),
        (["--scheduler", "nowhere"], "scheduler nowhere: does not answer"),
    ],
)
def test_what_is_wrong_with_the_pool_is_one_line(spoken, folder, command, words, said):
    status, out, err = spoken(command, ROBOTS / "arm", folder, *words)
    assert (status, out) == (1, "")
    assert err.startswith("error: ")
    assert said in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("command", ["identify", "diagnose", "montecarlo", "check"])
def test_a_folder_without_logs_is_said(spoken, tmp_path, command):
    status, _, err = spoken(command, ROBOTS / "arm", tmp_path)
    assert status == 1
    assert "holds no log; valid: files of .csv" in err


@pytest.mark.slow
def test_of_long_logs_stretches_are_judged_together(without_elbow, folder, monkeypatch):
    monkeypatch.setattr(sys.modules["ident.streams.many_logs"], "TOGETHER", 2000)
    monkeypatch.setattr(sys.modules["ident.streams.logs"], "SAMPLES", 1500)
    found = ident.diagnose_each(without_elbow, folder, jobs=2)
    said = "all logs together are judged on 1494 of their 2400 samples"  # 3 stretches of each
    assert said in found.notes
    assert "coulomb:elbow" in found.asked


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda m, fit: ident.diagnose_each(m, [SWING], jobs=1, done=()),
            "done is a tuple; give a",
        ),
        (lambda m, fit: ident.diagnose_each(m, [3], jobs=1), "int is no path"),
        (lambda m, fit: ident.diagnose_each(m, [SWING], jobs=1, alpha=2), "alpha = 2: 100 random"),
        (lambda m, fit: ident.diagnose(fit, alpha="x"), "alpha = 'x': is no number"),
        (lambda m, fit: ident.diagnose(fit, seed=-1), "seed -1; valid: a whole number, 0 or more"),
        (lambda m, fit: ident.grow(m, fit), "grow needs a motion, given: Fit"),
        (lambda m, fit: ident.excite(m, separate=("drag:elbow",)), "valid: two effects"),
        (lambda m, fit: fit.since("before"), "since needs a fit, given: str"),
        (lambda m, fit: fit.plot(9), "experiment 9; valid: 0 to 0"),
    ],
)
def test_python_refuses_what_it_is_given_in_words(call, words):
    mechanism = ident.load(ROBOTS / "pendulum")
    fit = ident.identify(mechanism, ident.complete(mechanism, SWING))
    with pytest.raises(ident.IdentError, match=re.escape(words)):
        call(mechanism, fit)


def test_verdicts_are_added_to_those_that_are_there():
    done = ["earlier"]
    arm = ident.load(ROBOTS / "pendulum")
    ident.diagnose_each(arm, [SWING], jobs=1, done=done)
    assert [str(each) == "earlier" for each in done] == [True, False]
