"""`ident excite` through its entry point: what it writes is taken by `check` and `simulate`."""

from __future__ import annotations

import json
import shutil
from itertools import islice

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.excite import search
from ident.excite.design import DesignProblem

QUICK = ("--duration", "8", "--periods", "2", "--harmonics", "2", "--rate", "50", "--tries", "1")


@pytest.fixture
def run(spoken, monkeypatch, tmp_path):
    """A command in an empty folder: status, output and error text."""
    monkeypatch.chdir(tmp_path)
    return spoken


def test_excite_check_simulate_identify(run, tmp_path):
    arm = ROBOTS / "arm"
    limits = ("--speed", "yaw=1", "--speed", "wrist=2", "--range", "elbow=-1:1.5", "--torque", "40")
    more = ("--noise", "yaw=0.1", "--reserve", "30%", "--acceleration", "9", "--plot", "x.png")
    status, out, err = run("excite", arm, *QUICK, *limits, *more, "--out", "x.csv")
    assert status == 0, err
    assert "identifies 22 base parameters of 40 unknowns" in out
    assert "wrote x.csv" in err
    assert (tmp_path / "x.png").stat().st_size > 1000
    status, out, err = run("check", arm, "x.csv")
    assert status == 0, err
    assert "this motion identifies 22 base parameters" in out
    assert run("simulate", arm, "x.csv", "--noise", "tau=1%", "--out", "made.csv")[0] == 0
    status, out, err = run("identify", arm, "made.csv")
    assert status == 0, err
    assert "rank 22 of 40 unknowns" in out


def test_separate_from_the_command(run):
    words = ("--separate", "coulomb:crank", "coulomb:rocker", *QUICK)
    status, out, err = run("excite", ROBOTS / "four_bar", *words)
    assert status == 0, err
    assert "coulomb:crank and coulomb:rocker: cosine 0." in out


def test_a_fit_has_its_own_noise_and_friction(run, tmp_path):
    arm, friction = ROBOTS / "arm", ("--with", "viscous", "--with", "coulomb")
    assert run("identify", arm, arm / "run.csv", *friction, "--out", "fit")[0] == 0
    left = json.loads((tmp_path / "fit/fit.json").read_text())["error"]["unfiltered"]
    status, out, err = run("excite", "fit", *QUICK, "--out", "x.csv")
    assert status == 0, err
    assert f"noise of yaw {left['yaw']['rms']:.3g}, " in out
    assert run("simulate", "fit/identified", "x.csv", "--out", "made.csv")[0] == 0
    planned, made = (ident.read_log(tmp_path / name).columns for name in ("x.csv", "made.csv"))
    moving = np.abs(planned["v.yaw"]) > 0.2
    assert np.allclose(planned["tau.yaw"][moving], made["tau.yaw"][moving], atol=1e-6)
    status, out, err = run("excite", "fit", *QUICK, "--noise", "yaw=0.5")
    assert "noise of yaw 0.5, shoulder 0.0" in out


def test_a_grown_folder_has_the_masses_of_its_fit(run, tmp_path):
    """mechanism.toml and the URDF beside fit.json still have those of the drawing."""
    arm, friction = ROBOTS / "arm", ("--with", "viscous", "--with", "coulomb")
    assert run("identify", arm, arm / "run.csv", *friction, "--out", "fit")[0] == 0
    grown = tmp_path / "grown"
    grown.mkdir()
    shutil.copy(tmp_path / "fit" / "fit.json", grown)
    urdf = (arm / "arm.urdf").read_text().replace('<mass value="', '<mass value="1')
    (grown / "arm.urdf").write_text(urdf)
    effects = "".join(
        f'[[effect]]\nkind = "{kind}"\njoint = "{joint}"\n'
        for kind in ("viscous", "coulomb")
        for joint in ("yaw", "shoulder", "elbow", "wrist")
    )
    (grown / "mechanism.toml").write_text('urdf = "arm.urdf"\n' + effects)
    assert run("excite", grown, *QUICK, "--out", "x.csv")[0] == 0
    assert run("simulate", "fit/identified", "x.csv", "--out", "made.csv")[0] == 0
    planned, made = (ident.read_log(tmp_path / name).columns for name in ("x.csv", "made.csv"))
    moving = np.abs(planned["v.yaw"]) > 0.2
    assert np.allclose(planned["tau.yaw"][moving], made["tau.yaw"][moving], atol=1e-6)


@pytest.fixture
def stopped(monkeypatch):
    """Ctrl-C after three steps of the first search."""
    ascent = search.ascent

    def until(*given):
        yield from islice(ascent(*given), 3)
        raise KeyboardInterrupt

    monkeypatch.setattr(search, "ascent", until)


def test_ctrl_c_keeps_the_best_motion(run, tmp_path, stopped):
    arm = ROBOTS / "arm"
    status, out, err = run("excite", arm, *QUICK, "--out", "x.csv", "--plot", "x.png")
    assert status == 130
    assert "identifies 22 base parameters" in out
    assert "the search was interrupted" in out
    assert "interrupted: x.csv has the best motion so far" in err
    assert (tmp_path / "x.png").stat().st_size > 1000
    assert run("check", arm, "x.csv")[0] == 0


def test_ctrl_c_without_a_file_overwrites_none(run, tmp_path, stopped):
    (tmp_path / "arm_excited.csv").write_text("of yesterday")
    status, _, err = run("excite", ROBOTS / "arm", *QUICK)
    assert status == 130
    assert "arm_excited1.csv has the best motion so far" in err
    assert (tmp_path / "arm_excited.csv").read_text() == "of yesterday"
    assert run("check", ROBOTS / "arm", "arm_excited1.csv")[0] == 0


def test_ctrl_c_before_the_first_motion(run, tmp_path, monkeypatch):
    def drawn(self, random, criterion):
        raise KeyboardInterrupt

    monkeypatch.setattr(DesignProblem, "draw", drawn)
    status, out, err = run("excite", ROBOTS / "arm", *QUICK, "--out", "x.csv")
    assert (status, out) == (130, "")
    assert "no file was written" in err
    assert not (tmp_path / "x.csv").exists()


WRONG = {
    "--speed fast": ("--speed", "fast"),
    "give one number for all drives": ("--speed", "1", "--speed", "2"),
    "--noise 3": ("--noise", "3"),
    "--range elbow": ("--range", "elbow"),
    "--reserve much": ("--reserve", "much"),
    "no joint 'elbwo'": ("--range", "elbwo=0:1"),
    "unknown suffix": ("--out", "x.txt"),
    "the limits leave no motion": ("--torque", "1"),
}


@pytest.mark.parametrize(("said", "words"), WRONG.items(), ids=WRONG)
def test_wrong_words_are_one_line(run, said, words):
    status, out, err = run("excite", ROBOTS / "arm", *QUICK, *words)
    assert (status, out) == (1, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert said in err


def test_a_hand_that_the_log_lacks_is_held(run, tmp_path):
    """The wrist's name is that of a hand, and [log] has the other joints alone."""
    (tmp_path / "arm.urdf").write_bytes((ROBOTS / "arm" / "arm.urdf").read_bytes())
    lines = [
        f'"{kind}.{joint}" = {{ column = "{kind}_{joint}" }}\n'
        for joint in ("yaw", "shoulder", "elbow")
        for kind in ("q", "tau")
    ]
    toml = tmp_path / "mechanism.toml"
    toml.write_text('urdf = "arm.urdf"\n\n[log]\n"t" = { column = "t" }\n' + "".join(lines))
    status, _, err = run("excite", tmp_path, *QUICK, "--out", "x.csv")
    assert status == 0, err
    assert "wrist: not logged, and parts of a hand; held" in err.partition("note: wrote")[2]
    assert "q.wrist" not in (tmp_path / "x.csv").read_text().partition("\n")[0]
