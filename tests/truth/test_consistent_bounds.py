"""Bounds and the total mass in mechanism.toml, on the command line, and in what is written."""

import json
import sys

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.cli.app import main
from ident.errors import MechanismError

UNKNOWN = 'unknown = ["turret", "upper_arm", "forearm", "hand"]'


def arm(folder, lines):
    """The arm with further lines in [parameters]."""
    text = (ROBOTS / "arm" / "mechanism.toml").read_text()
    assert UNKNOWN in text
    (folder / "arm.urdf").write_text((ROBOTS / "arm" / "arm.urdf").read_text())
    (folder / "mechanism.toml").write_text(text.replace(UNKNOWN, lines))
    return folder


def run(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["ident", *map(str, words)])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def test_bounds_of_the_mechanism_count_in_a_consistent_fit_only(tmp_path):
    folder = arm(tmp_path, 'bounds = { "hand.m" = [0.25, inf] }\ntotal_mass = 8.0')
    mechanism = ident.load(folder)
    assert mechanism.consistency == ident.Consistency({"hand.m": (0.25, np.inf)}, 8.0)
    motion = ident.complete(mechanism, ROBOTS / "arm" / "run.csv")
    free = ident.identify(mechanism, motion)
    assert any("hold in a consistent fit only" in note for note in free.warnings)
    fit = ident.identify(mechanism, motion, consistent=True)
    assert fit.dynamic_parameters[::10].sum() == pytest.approx(8.0, rel=1e-6)
    other = ident.identify(mechanism, motion, consistent=ident.Consistency(total_mass=9.0))
    assert other.dynamic_parameters[::10].sum() == pytest.approx(9.0, rel=1e-6)
    assert other["hand.m"].value >= 0.25 - 1e-6


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ('bounds = { "hnd.m" = [0, 1] }', "did you mean 'hand'"),
        ('bounds = { "hand.mass" = [0, 1] }', "a link has no 'mass'"),
        ('bounds = { "hand.m" = [1, 0] }', "lower one first"),
        ('bounds = { "hand.m" = 3 }', "give two numbers"),
        ('bounds = { "hand.m" = [nan, 1] }', "lower one first"),
        ("bounds = 3", "bounds = 3; write"),
        ("total_mass = -2", "kilograms above 0"),
        ('total_mass = "heavy"', "a number of kilograms"),
        ("bouds = 3", "did you mean 'bounds'"),
    ],
)
def test_bad_bounds_in_mechanism_toml_are_one_line(tmp_path, lines, said):
    with pytest.raises(MechanismError, match=said) as error:
        ident.load(arm(tmp_path, lines))
    assert "\n" not in str(error.value)
    assert "[parameters]" in str(error.value)


def test_the_command_takes_bounds_and_writes_what_they_did(tmp_path, monkeypatch, capsys):
    log = ROBOTS / "arm" / "run.csv"
    options = ("--with", "viscous", "--with", "coulomb", "--out", tmp_path / "out")
    bounds = ("--bound", "hand.m=0.2:0.3", "--bound", "coulomb.elbow.Fc=1.5:", "--total-mass", "9")
    assert run(monkeypatch, "identify", ROBOTS / "arm", log, *options, *bounds) == 0
    said = capsys.readouterr()
    assert "physically consistent" in said.out
    assert "coulomb.elbow.Fc ≥ 1.5 N m" in said.out
    assert ", at bound" in said.out
    data = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert data["schema"] == "ident.fit/1"
    told = data["consistency"]
    assert told["bounds"] == {"hand.m": [0.2, 0.3], "coulomb.elbow.Fc": [1.5, None]}
    assert told["total_mass"] == 9.0
    assert "coulomb.elbow.Fc" in told["at_bound"]
    assert min(told["smallest_eigenvalues"].values()) > 0
    again = ident.read_fit(tmp_path / "out", ident.load(ROBOTS / "arm"))
    assert again.dynamic_parameters[::10].sum() == pytest.approx(9.0, rel=1e-6)
    assert "physically consistent" in (tmp_path / "out" / "report.html").read_text()
    plain = ("identify", ROBOTS / "arm", log, "--out", tmp_path / "plain")
    assert run(monkeypatch, *plain) == 0
    assert "consistency" not in json.loads((tmp_path / "plain" / "fit.json").read_text())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--bound", "hand.m"), "is no bound; write NAME=LOW:HIGH"),
        (("--bound", "hand.m=a:b"), "is no bound"),
        (("--bound", "hand.m=:"), "is no bound"),
        (("--bound", "hand.m=2:1"), "lower one first"),
        (("--bound", "hand.q=1:2"), "there is no such parameter"),
        (("--total-mass", "0"), "kilograms above 0"),
        (("--bound", "hand.m=2:", "--total-mass", "1"), "these limits contradict each other"),
    ],
)
def test_bad_bounds_on_the_command_line_are_one_line(monkeypatch, capsys, words, said):
    command = ("identify", ROBOTS / "arm", ROBOTS / "arm" / "run.csv")
    assert run(monkeypatch, *command, *words) == 1
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("error:")
    assert said in error
