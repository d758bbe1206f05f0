"""`ident montecarlo` from its words to its files, and one line for bad input."""

from __future__ import annotations

from pathlib import Path

import pytest

import ident.montecarlo as montecarlo

ROBOT = Path(__file__).resolve().parents[2] / "robots" / "slider_crank"


@pytest.fixture
def run(spoken):
    """Status, output and error text of `ident montecarlo` on the slider-crank."""
    return lambda *words: spoken("montecarlo", ROBOT, ROBOT / "run.csv", *words)


def test_table_and_files(run, tmp_path):
    status, out, err = run(
        "--snr", "60,50", "--runs", "1", "--estimator", "paper", "--estimator", "least-squares",
        "--spacing", "0.01", "--truth", "rod.Ixx=0.004", "--jobs", "1",
        "--out", str(tmp_path / "o"),
    )  # fmt: skip
    assert status == 0, err
    assert "1 run at 60, 50 dB each, seed 0" in out
    assert "as given: rod.Ixx" in out
    assert sorted(path.suffix for path in (tmp_path / "o").iterdir()) == [
        ".csv", ".csv", ".html", ".json", ".png",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--snr", "forty"], "--snr forty: write numbers of dB"),
        (["--snr", "40,inf"], "SNR inf"),
        (["--runs", "0"], "runs 0; valid: a whole number, 1 or more"),
        (["--estimator", "defualt"], "did you mean 'default'"),
        (["--truth", "rod.Ixx"], "write NAME=NUMBER"),
        (["--estimator", "default", "--spacing", "0.01"], "add --estimator paper"),
        (["--spacing", "0"], "valid: above 0"),
        (["--wrench", "--jobs", "0"], "jobs 0"),
        (["--reactions", "nowhere.csv"], "nowhere.csv"),
    ],
)
def test_bad_input_is_one_line(run, words, said):
    status, out, err = run(*words)
    assert status == 1
    assert out == ""
    assert err.startswith("error: ")
    assert said in err
    assert err.count("\n") == 1


def test_what_is_done_is_kept_after_ctrl_c(run, tmp_path, monkeypatch):
    """The fourth draw of the noise does not end; of two runs at each ratio one is whole."""
    draws, rows = iter(range(3)), montecarlo.TrialPlan.rows

    def interrupted(plans, task):
        if next(draws, None) is None:
            raise KeyboardInterrupt
        return rows(plans, task)

    monkeypatch.setattr(montecarlo.TrialPlan, "rows", interrupted)
    words = ["--snr", "60,50", "--runs", "9", "--estimator", "least-squares", "--jobs", "1"]
    status, out, err = run(*words, "--out", str(tmp_path))
    assert status == 130
    assert "1 run at 60, 50 dB each" in out
    assert "1 of 9 runs are done and kept" in err
    assert "all of them, these too, with: ident montecarlo " in err
    rows = (tmp_path / "runs.csv").read_text().splitlines()[1:]
    assert {row.split(",")[1] for row in rows} == {"60.0", "50.0"}
