"""The command that goes on from a result: it runs as it is printed, or is not printed."""

import shlex

import pytest

import ident
from helpers import ROBOTS
from ident.progress import Inputs, folder, inputs
from ident.show.card import next_command
from ident.show.fit import card


@pytest.fixture
def given():
    """Sets what the running command is given, until the test ends."""
    tokens = []

    def give(options=(), out="", logs=("a  b.csv", "c.csv")):
        tokens.append((inputs, inputs.set(Inputs("my arm", logs, tuple(options)))))
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


def test_a_fit_that_was_not_written_is_written_first(given):
    given(["--with", "coulomb"])
    assert next_command("compare").startswith("ident identify 'my arm' 'a  b.csv' c.csv --with")


def test_no_command_where_the_verb_does_not_take_the_options(given):
    given(["--lock", "wrist"])
    assert next_command("monitor") == ""
    assert next_command("diagnose").endswith("--lock wrist")


def test_no_command_outside_of_a_command_line():
    assert next_command("diagnose") == ""
    arm = ident.load(ROBOTS / "arm")
    fit = ident.identify(arm, ident.complete(arm, ident.read_log(ROBOTS / "arm" / "run.csv")))
    assert card(fit).command == ""
