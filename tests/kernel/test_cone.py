"""Projections onto cones against closed forms, and smallest sets of contradicting limits."""

import numpy as np
import pytest

from ident.errors import FitError
from ident.information.cone import Limit, conflict, nearest, shortfall, smat, svec


def at_least(name, k, at, low):
    return Limit(name, "nonnegative", np.eye(k)[at : at + 1], np.array([-low]))


def at_most(name, k, at, high):
    return Limit(name, "nonnegative", -np.eye(k)[at : at + 1], np.array([high]))


def test_svec_keeps_the_inner_product_and_comes_back():
    rng = np.random.default_rng(0)
    M, N = (X + X.T for X in rng.normal(size=(2, 4, 4)))
    assert svec(M) @ svec(N) == pytest.approx(np.trace(M @ N))
    np.testing.assert_allclose(smat(svec(M)), M)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_the_nearest_semidefinite_matrix_is_the_one_without_negative_eigenvalues(size):
    """Higham 1988: eigenvalues are cut off. At any size, though the solver counts in ones."""
    rng = np.random.default_rng(1)
    x = size * rng.normal(size=10)
    found = nearest(np.eye(10), x, [Limit("P", "psd", np.eye(10), np.zeros(10))])
    e, V = np.linalg.eigh(smat(x))
    expected = svec(V @ np.diag(np.maximum(e, 0)) @ V.T)
    np.testing.assert_allclose(found.x, expected, atol=1e-6 * size)
    assert found.push[0] == pytest.approx(np.linalg.norm(x - expected), rel=1e-4)


def test_a_weighted_projection_onto_bounds_is_a_small_quadratic_programme():
    """On x₀ ≥ 1 the rest follows by least squares: x₁ from (x₀ fixed)."""
    R = np.array([[2.0, 1.0], [0.0, 1.0]])
    d = np.array([0.0, 0.0])
    found = nearest(R, d, [at_least("x ≥ 1", 2, 0, 1.0)])
    x1 = -2.0 * 1.0 / (1 + 1)  # d/dx₁ of (2 + x₁)² + x₁²
    np.testing.assert_allclose(found.x, [1.0, x1], atol=1e-7)


def test_limits_that_hold_anyway_push_nothing():
    found = nearest(np.eye(2), np.array([3.0, 4.0]), [at_least("x ≥ 1", 2, 0, 1.0)])
    np.testing.assert_allclose(found.x, [3.0, 4.0], atol=1e-7)
    assert found.push[0] < 1e-6


def test_the_smallest_contradicting_set_is_named():
    """a + b = 3, a ≤ 1, b ≤ 1 contradict; c and the others have nothing to do with it."""
    k = 3
    total = Limit("a + b = 3", "zero", np.array([[1.0, 1.0, 0.0]]), np.array([-3.0]))
    limits = [
        at_least("c ≥ 0", k, 2, 0.0),
        at_most("a ≤ 1", k, 0, 1.0),
        total,
        at_most("c ≤ 5", k, 2, 5.0),
        at_most("b ≤ 1", k, 1, 1.0),
        at_most("a ≤ 7", k, 0, 7.0),
    ]
    assert [limit.name for limit in conflict(limits, np.ones(k))] == ["a ≤ 1", "a + b = 3", "b ≤ 1"]
    assert shortfall(limits, np.ones(k)) == pytest.approx(1 / 3, rel=1e-3)
    assert conflict(limits[:-2], np.ones(k)) == []
    with pytest.raises(FitError, match="conic solver found no solution"):
        nearest(np.eye(k), np.zeros(k), limits)


def test_a_direction_that_nothing_determines_is_refused():
    with pytest.raises(FitError, match="neither in the data nor in the prior"):
        nearest(np.diag([1.0, 0.0]), np.zeros(2), [])
