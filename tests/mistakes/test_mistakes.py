"""A small part of the table of mistakes; `python tests/mistakes/table.py` makes the whole."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from kinds import MADE
from subjects import Case, clean, subjects
from verdict import judge

ACCEPTED = ("error", "named", "doubt", "right")
NAMED = (  # on the arm, by the right name
    "all torques in lb in",
    "one torque without its gear ratio of 101",
    "sign of all torques",
    "two torques exchanged",
    "one torque always zero",
    "two positions exchanged",
    "two joints' names exchanged in the log",
    "gravity upside down",
    "time in ms",
    "one joint moved alone",
)


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Case:
    subject = next(each for each in subjects() if each.name == "arm")
    return clean(subject, tmp_path_factory.mktemp("arm"))


@pytest.mark.parametrize("name", NAMED)
def test_a_mistake_is_named(arm, name, tmp_path):
    (mistake,) = (each for each in MADE if each.name == name)
    verdict = judge(arm, mistake, tmp_path)
    assert verdict.outcome in ("error", "named"), verdict.said


@pytest.mark.parametrize("name", ["clock 10 % slow", "one length 10 % too long"])
def test_what_hardly_shows_is_not_called_something_else(arm, name, tmp_path):
    (mistake,) = (each for each in MADE if each.name == name)
    assert judge(arm, mistake, tmp_path).outcome in ACCEPTED


def test_there_are_sixty_kinds():
    assert len({each.name for each in MADE}) == len(MADE) >= 60
