"""Robots as they ship: a few of those that `python benchmarks/robots.py` has in its table."""

import sys

import pytest

from helpers import ROBOTS, J, tree_urdf, write_mechanism
from ident.mechanism import load
from ident.mechanism.load import unlogged_hands

sys.path.insert(0, str(ROBOTS.parent / "benchmarks"))
from robots import measured, title, urdfs


@pytest.mark.parametrize("name", ["ur/ur5_robot", "panda/panda", "solo/solo"])
def test_a_shipped_robot_identifies_its_own_log(name):
    """The log is Pinocchio's own, of the file as it is; the Panda's second finger mimics."""
    path = next((path for path in urdfs() if title(path) == name), None)
    if path is None:
        pytest.skip("needs the robots' files: pip install example-robot-data")
    row = measured(path)
    assert row["passed"], row


def test_hands_of_which_nothing_is_logged(tmp_path):
    """Joints beyond a hand belong to it; one that is logged, or carries a logged one, does not."""
    joints = [
        J("elbow"), J("hand_turn", parent="elbow"), J("a", parent="hand_turn"),
        J("finger", parent="elbow"), J("camera", parent="finger"), J("spare", parent="elbow"),
    ]  # fmt: skip
    mechanism = load(write_mechanism(tmp_path, tree_urdf(joints)))
    hands = unlogged_hands(mechanism, ["q.elbow"])
    assert sorted(hands) == ["a", "camera", "finger", "hand_turn"]
    assert sorted(unlogged_hands(mechanism, ["q.elbow", "q.a"])) == ["camera", "finger"]
    assert unlogged_hands(mechanism, ["tau.finger", "v.hand_turn"]) == ()
