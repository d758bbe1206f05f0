"""The parts of the search for exciting motions that know no robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import linprog

from ident.excite.excitation import Criterion
from ident.excite.limits import LimitBox
from ident.excite.search import climb
from ident.excite.trajectory import Fourier


def test_criteria_are_standard_errors():
    W = np.random.default_rng(1).normal(size=(30, 5))
    C = np.linalg.inv(W.T @ W)
    value = Criterion.of_all(5, 0.0).at(W)
    assert value == pytest.approx(-0.5 * np.linalg.slogdet(C)[1] / 5)
    pair = Criterion.of_pair(5, [3], [4]).at(W)
    assert pair == pytest.approx(-np.mean(np.log(np.sqrt(C.diagonal()[3:]))))
    N = W / np.linalg.norm(W, axis=0)
    balanced = Criterion.of_all(5, 0.7).at(W)
    assert balanced == pytest.approx(value - 0.7 * np.log(np.linalg.cond(N)))
    assert Criterion.of_all(5, 0.0).at(np.hstack([W[:, :4], W[:, :1]])) is None


def test_series_begin_at_rest_and_are_the_derivatives():
    family = Fourier(4.0, 3, np.array([0.3, -1.0]), np.ones(2), np.full(2, 2.0), np.full(2, np.inf))
    x = np.random.default_rng(2).normal(size=family.shape)
    t = np.linspace(0, 8, 4001)
    y, v, a = family.states(x, family.basis(t))
    np.testing.assert_allclose(np.array([v[0], a[0]]), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.gradient(y, t, axis=0)[1:-1], v[1:-1], atol=1e-3)
    np.testing.assert_allclose(np.gradient(v, t, axis=0)[1:-1], a[1:-1], atol=1e-2)
    np.testing.assert_allclose(y[2000:], y[:2001], atol=1e-12)
    np.testing.assert_allclose(y[0], family.coefficients(x)[:, [0, 4, 5, 6]].sum(axis=1))


def test_nothing_between_samples_exceeds_the_bound():
    random, H, n = np.random.default_rng(3), 4, 60
    family = Fourier(1.0, H, np.zeros(1), np.ones(1), np.full(1, 1e9), np.full(1, np.inf))
    for _ in range(50):
        x = random.normal(size=family.shape)
        coarse = np.abs(family.states(x, family.basis(np.arange(n) / n))[0]).max()
        whole = np.abs(family.states(x, family.basis(np.linspace(0, 1, 6001)))[0]).max()
        assert whole <= coarse / family.between(n) + 1e-12


def test_excess_of_a_box():
    kinds = ("position", "speed", "singularity", "torque")
    quantities = tuple(("j", kind, "1") for kind in kinds)
    low, high = np.array([-1.0, -2.0, -np.inf, -np.inf]), np.array([2.0, 2.0, 5.0, np.inf])
    box = LimitBox(quantities, low, high)
    z = np.random.default_rng(4).uniform(-0.9, 1.9, size=(6, 4))
    assert box.excess(z).shape == (4,)
    assert box.excess(z).max() < 0 < box.excess(z + 2.0).max()
    assert box.excess(z)[0] == pytest.approx(max(-1 - z[:, 0].min(), z[:, 0].max() - 2) / 1.5)
    assert box.broken(z + np.array([0, 0, 9.0, 0])) == 2
    assert box.broken(z) is None


@pytest.mark.parametrize(
    "criterion",
    [Criterion.of_all(5, 0.7), Criterion.of_pair(5, [1], [2, 4])],
    ids=["all, balanced", "pair"],
)
def test_slope_of_a_criterion(criterion):
    random = np.random.default_rng(5)
    W, d = random.normal(size=(30, 5)), 1e-6 * random.normal(size=(30, 5))
    assert (criterion.slope(W) * d).sum() == pytest.approx(
        0.5 * (criterion.at(W + d) - criterion.at(W - d)), rel=1e-5
    )


@dataclass(frozen=True)
class Place:
    """A point of a problem of formulas."""

    x: np.ndarray
    z: np.ndarray
    J: float


def test_the_optimum_of_a_linear_problem():
    """Against scipy's linear programming: 200 limits of both sides, some of them absent."""
    random = np.random.default_rng(6)
    G, gain = random.normal(size=(200, 4)), random.normal(size=4)
    low, high = -random.uniform(1, 2, size=(2, 200)) * np.array([[1], [-1]])
    low[::3] = -np.inf
    high[::5] = np.inf

    def place(x, near=None):
        return Place(x, G @ x, float(gain @ x))

    *steps, found = climb(place(np.zeros(4)), place, lambda c: (gain, G), low, high, 1e-2)
    for each in (*steps, found):
        assert ((low < each.z) & (each.z < high)).all()
    finite = [x for x in (*np.c_[G, high], *np.c_[-G, -low]) if np.isfinite(x[-1])]
    least = linprog(-gain, np.array(finite)[:, :4], np.array(finite)[:, 4], bounds=(None, None))
    np.testing.assert_allclose(gain @ least.x, found.J, atol=1e-3)


def test_the_optimum_on_a_curved_limit():
    """The highest point of a ball; beyond x₀ = 0.9 there are no points at all."""
    gain = np.array([3.0, 1.0, 0.0])

    def place(x, near=None):
        return None if x[0] > 0.9 else Place(x, np.array([x @ x]), float(gain @ x))

    low, high, start = np.array([-np.inf]), np.array([0.5]), place(np.full(3, 0.1))
    *_, found = climb(start, place, lambda c: (gain, 2 * c.x[None]), low, high, 1e-2)
    np.testing.assert_allclose(found.x, gain * np.sqrt(0.5 / 10), atol=1e-3)
