"""Joints whose torque is the small remainder of large terms: one finding for all of them."""

from types import SimpleNamespace

import numpy as np

from ident.fit import findings
from ident.information.blocks import Error


def test_joints_that_swing_freely_are_one_finding(monkeypatch):
    monkeypatch.setattr(findings, "term_sizes", lambda totals, x: np.array([11.0, 1.0, 20.0]))
    problem = SimpleNamespace(
        information=SimpleNamespace(totals=()), mechanism=SimpleNamespace(driven=("a", "b", "c"))
    )
    errors = {name: Error(0.2, 0.2, "N m") for name in "abc"}  # torques of 1 N m
    (found,) = findings._swinging(problem, SimpleNamespace(x=None), errors)
    assert found.where == ("tau.a", "tau.c")
    assert "tau.b" not in str(found)
    explained = {name: Error(0.01, 0.01, "N m") for name in "abc"}  # the unit is right
    assert not [*findings._swinging(problem, SimpleNamespace(x=None), explained)]
