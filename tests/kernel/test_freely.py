"""Joints whose torque is the small remainder of large terms: one finding for all of them."""

from types import SimpleNamespace

import numpy as np
import pytest

from ident.fit import findings
from ident.information.blocks import Error
from ident.information.estimate import term_sizes
from ident.information.linear import Triangle


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


def test_terms_of_one_physics_may_cancel():
    """Moments of two parallel links have one column: only their sum acts."""
    t = np.linspace(0.0, 6.0, 200)
    gravity, inertia = np.cos(t), np.sin(3 * t)
    A = np.column_stack([gravity, gravity * (1 + 1e-3 * t), inertia])
    total = Triangle.of(A, A @ [1.0, 1.0, 1.0])
    x = np.array([50.0, -49.0, 1.0])
    apart = np.array([[50.0, 0.0], [-49.0, 0.0], [0.0, 1.0]])  # by term
    assert term_sizes([total], x) > 45
    assert term_sizes([total], apart) == pytest.approx(1.0, rel=0.2)
