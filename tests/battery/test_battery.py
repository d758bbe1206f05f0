"""A small part of the battery; `python tests/battery/score.py` runs the whole."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
pytest.importorskip("mujoco", reason="the battery's logs are simulated by MuJoCo")

from cases import Case, cases, effects
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
    result = judge(case, whole=False)
    assert "error" not in result, result["error"]
    (score,) = (each for each in SCORES if each.title == DECIDES[case.category])
    assert all(ok for _, ok in score.of([result])), result


def test_three_effects_of_one_joint_of_which_none_is_credible_alone() -> None:
    """Found together as a path that random residuals do not have."""
    (hidden,) = effects("drift:shoulder + torque_offset:shoulder + hysteresis:shoulder")
    case = Case(
        "three", "two", "arm3", hidden, 1.0, noise=0.01, encoder=0.001, motion=71, seed=9010
    )
    result = judge(case, whole=False)
    assert "error" not in result, result["error"]
    assert all(each in result["added"] for each in result["hidden"]), result["added"]
