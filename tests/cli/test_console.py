"""Notes on the terminal: several of one kind are one line."""

import io

from ident.cli import app as console
from ident.cli.app import merged


class Terminal(io.StringIO):
    """Takes all that is written."""

    def isatty(self) -> bool:
        return True


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
    monkeypatch.setattr("sys.stderr", terminal := Terminal())
    console.starting("check: starting")
    assert "check: starting …" in terminal.getvalue()
    console.result("mechanism arm")
    assert terminal.getvalue().endswith("\r\x1b[K")
    console.notes(["x"])
    assert terminal.getvalue().count("\x1b[K") == 1
    assert capsys.readouterr().out == "mechanism arm\n"


def test_a_style_is_for_terminals_that_want_it(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    for want, wish in ((True, ""), (False, "1")):
        monkeypatch.setattr("sys.stdout", terminal := Terminal())
        monkeypatch.setenv("NO_COLOR", wish)
        console.styled("ident check run[0].csv", fg="cyan")
        assert ("\x1b[36m" in terminal.getvalue()) is want
        assert "run[0].csv" in terminal.getvalue()


def test_notes_that_differ_in_the_joint_only_are_one():
    turning = [f"{joint} may turn on and on" for joint in ("shoulder", "elbow", "wrist")]
    assert merged(turning) == ["shoulder … wrist (3) may turn on and on"]
    counts = ["78 samples are left out", "9 samples are left out"]
    assert merged(counts) == counts
