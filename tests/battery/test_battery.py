"""A small part of the battery; `python tests/battery/score.py` runs the whole."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
pytest.importorskip("mujoco", reason="the battery's logs are simulated by MuJoCo")

from cases import Case, cases
from judge import judge
from scores import SCORES

DECIDES = {  # by category, the score that a case must pass
    "visible": "visible on serial arms: named first, right joint",
    "loop": "closed loops: true effect in the set of rivals",
    "clean": "clean: verdict `nothing`",
    "outside": "outside the library: no name, and not `nothing`",
    "parallelogram": "parallelogram: never one joint alone",
    "two": "two effects: both found",
    "invisible": "invisible or absorbed: said to be so",
}


@pytest.mark.parametrize("case", cases("ci"), ids=lambda case: case.name)
def test_a_hidden_effect(case: Case) -> None:
    """The verdict on a log of another program, with a wrong prior and noise on positions too."""
    result = judge(case)
    assert "error" not in result, result["error"]
    (score,) = (each for each in SCORES if each.title == DECIDES[case.category])
    assert all(ok for _, ok in score.of([result])), result
