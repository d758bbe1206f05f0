"""The command that goes on from a result: it runs as it is printed, or is not printed."""

import shlex
from dataclasses import replace

import pytest

import ident
from helpers import ROBOTS
from ident.display import Inputs, folder, inputs
from ident.show.card import add_command, next_command
from ident.show.fit import card


@pytest.fixture
def given():
    """Sets what the running command is given, until the test ends."""
    tokens = []

    def give(options=(), out="", logs=("a  b.csv", "c.csv"), like=()):
        tokens.append((inputs, inputs.set(Inputs("my arm", logs, tuple(options), like))))
        tokens.append((folder, folder.set(out)))

    yield give
    for variable, token in reversed(tokens):
        variable.reset(token)


def test_names_with_blanks_stay_in_one_piece(given):
    given(["--with", "coulomb"], out="o 1")
    words = shlex.split(next_command("monitor"))
    assert words[2:] == [
        "my arm", "NEXT.csv", "--like", "a  b.csv", "--like", "c.csv", "--with", "coulomb",
    ]  # fmt: skip
    assert shlex.split(next_command("compare"))[-2:] == ["--fit", "o 1/fit.json"]


def test_normal_running_stays_what_a_command_was_given_as_such(given):
    given(like=("normal.csv",))
    assert next_command("monitor") == "ident monitor 'my arm' NEXT.csv --like normal.csv"


def test_a_fit_that_was_not_written_is_written_first(given):
    given(["--with", "coulomb"])
    assert next_command("compare").startswith("ident identify 'my arm' 'a  b.csv' c.csv --with")


def test_no_command_where_the_verb_does_not_take_the_options(given):
    given(["--spacing", "0.1"])
    assert next_command("monitor") == ""
    assert next_command("diagnose").endswith("--spacing 0.1")
    given(["--lock", "wrist"])
    assert next_command("monitor").endswith("--lock wrist")


def test_what_an_incomplete_model_lacks_grows_where_it_is_unknown(given, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("fit.json", "identified/mechanism.toml"):
        file = tmp_path / "fit" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    token = inputs.set(Inputs("fit/identified", ("new.csv",), (), ()))
    try:
        assert next_command("grow") == "ident grow fit new.csv --out grown"
    finally:
        inputs.reset(token)


def test_the_cause_of_a_change_is_looked_for_with_known_bodies(given, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given(logs=("new.csv",))
    assert next_command("diagnose") == "ident diagnose 'my arm' new.csv"
    for name in ("fit.json", "identified/mechanism.toml"):
        file = tmp_path / "my arm" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    assert next_command("diagnose") == "ident diagnose 'my arm/identified' new.csv"


def test_what_was_given_with_stays_in_the_command_that_adds(given):
    arm = ident.load(ROBOTS / "arm")
    spring = arm.with_effect("spring:elbow").effects
    words = ["--with", "viscous", "--lock", "wrist", "--with", "my own.py:bump:elbow"]
    given([*words, "--allow-code"])
    assert shlex.split(add_command(arm, spring))[3:] == [
        "viscous", "my own.py:bump:elbow", "spring:elbow", "--allow-code",
    ]  # fmt: skip
    assert shlex.split(add_command(arm, spring, ["o 1/law.py:law:wrist"]))[-2] == (
        "o 1/law.py:law:wrist"
    )
    planned = shlex.split(next_command("excite"))
    assert planned[3:] == [*words, "--allow-code", "--out", "next.csv"]
    given(["--absolute", "--cutoff", "8"], out="out")
    assert shlex.split(next_command("compare"))[-1] == "--absolute"


def test_no_command_outside_of_a_command_line():
    assert next_command("diagnose") == ""
    arm = ident.load(ROBOTS / "arm")
    fit = ident.identify(arm, ident.complete(arm, ident.read_log(ROBOTS / "arm" / "run.csv")))
    assert card(fit).command == ""


def test_what_is_offered_overwrites_nothing(given, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given(out="last")
    assert shlex.split(next_command("identify"))[-2:] == ["--out", "last_2"]  # not yet written
    (tmp_path / "last_2").mkdir()
    (tmp_path / "next.csv").touch()
    assert shlex.split(next_command("identify"))[-1] == "last_3"
    assert shlex.split(next_command("excite"))[-1] == "next_2.csv"


def test_the_present_folder_is_a_mechanism_too(monkeypatch):
    monkeypatch.chdir(ROBOTS / "arm")
    mechanism = ident.load(".")
    assert add_command(mechanism, [ident.effect("spring", "elbow")]).startswith("ident add . ")


def test_a_folder_that_was_grown_is_diagnosed_with_its_bodies(given, tmp_path):
    grown = tmp_path / "grown"
    for name in ("mechanism.toml", "fit.json", "identified/mechanism.toml"):
        (grown / name).parent.mkdir(parents=True, exist_ok=True)
        (grown / name).touch()
    given(logs=("new.csv",))
    inputs.set(replace(inputs.get(), mechanism=str(grown)))
    assert shlex.split(next_command("diagnose"))[2:] == [f"{grown}/identified", "new.csv"]


def test_what_has_changed_since_a_fit_is_diagnosed_with_its_bodies(given):
    given(["--with", "coulomb", "--lock", "wrist"], logs=("new.csv",))
    inputs.set(replace(inputs.get(), fit="last month"))
    words = shlex.split(next_command("diagnose", known=True))
    assert words[2:] == ["last month/identified", "new.csv", "--lock", "wrist"]
    assert shlex.split(next_command("diagnose"))[2] == "my arm"
