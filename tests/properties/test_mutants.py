"""A small part of `run.py`: the same mutants every time."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from mutants import SHARES
from outcomes import FAULTS

from run import KINDS, drawn, outcome_in_library, outcome_of_command


def test_mutants_through_the_library():
    outcomes = drawn(outcome_in_library, 60, 0, KINDS)
    faults = [each for each in outcomes if each.verdict in FAULTS]
    assert not faults
    assert len({each.kind for each in outcomes}) > len(SHARES) / 2
    assert {"error", "finding", "same"} <= {each.verdict for each in outcomes}


def test_mutants_through_the_command():
    assert not [x for x in drawn(outcome_of_command, 4, 0, KINDS) if x.verdict in FAULTS]


@pytest.mark.slow
def test_many_mutants_through_the_library():
    assert not [x for x in drawn(outcome_in_library, 500, 1, KINDS) if x.verdict in FAULTS]
