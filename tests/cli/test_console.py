"""Notes on the terminal: several of one kind are one line."""

import io

from rich.console import Console

from ident.cli import app as console
from ident.cli.app import merged


def test_notes_of_several_logs_are_one_line_with_ranges():
    said = "samples within 188 ms are left out"
    lines = [f"run{i}.csv: {n} {said}" for i, n in enumerate((96, 7, 12))]
    assert merged(lines) == ["run0.csv … run2.csv (3): 7 to 96 samples within 188 ms are left out"]


def test_notes_of_different_kinds_stay_as_they_are():
    lines = ["run.csv: q.yaw: spline", "no more than 3 logs", "run.csv: v.yaw: spline", "no more"]
    assert merged([*lines, *lines]) == lines


def test_numbers_within_names_are_no_numbers():
    assert len(merged(["a.csv: joint_1 is held", "a.csv: joint_2 is held"])) == 2


def test_the_first_line_goes_before_anything_else_is_written(monkeypatch, capsys):
    terminal = Console(file=io.StringIO(), force_terminal=True)
    monkeypatch.setattr(console, "errors", terminal)
    console.starting("check: starting")
    assert "check: starting …" in terminal.file.getvalue()
    console.result("mechanism arm")
    assert terminal.file.getvalue().endswith("\r\x1b[K")
    console.notes(["x"])
    assert terminal.file.getvalue().count("\x1b[K") == 1
    assert capsys.readouterr().out == "mechanism arm\n"


def test_notes_that_differ_in_the_joint_only_are_one():
    turning = [f"{joint} may turn on and on" for joint in ("shoulder", "elbow", "wrist")]
    assert merged(turning) == ["shoulder … wrist (3) may turn on and on"]
    counts = ["78 samples are left out", "9 samples are left out"]
    assert merged(counts) == counts
