"""A mass behind a spring or a play, against integrators that know no closed form."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ident.information.oscillator import rates, sprung, with_play

STEP, N = 0.005, 2000
T = STEP * np.arange(N)
FREQUENCIES, PHASES = np.random.default_rng(0).uniform((0.2, 0.0), (8.0, 6.0), (12, 2)).T


def load(t):
    return 0.1 * np.sin(2 * np.pi * FREQUENCIES * np.asarray(t)[..., None] + PHASES).sum(axis=-1)


def inertia(t):
    return 0.0065 * (1 + 0.3 * np.sin(2 * np.pi * 0.7 * np.asarray(t)))


def test_rates_are_those_of_a_sine():
    x = np.sin(30 * T)
    first, second = rates(x, STEP)
    inside = slice(3, -3)
    np.testing.assert_allclose(first[inside], 30 * np.cos(30 * T)[inside], atol=2e-3)
    np.testing.assert_allclose(second[inside], -900 * x[inside], atol=0.02)


@pytest.mark.parametrize(
    ("compliance", "damping"), [(1 / 12, 0.01), (1 / 20, 0.3), (1 / 300, 0.05), (1e-6, 0.01)]
)
def test_a_spring_swings_as_an_integrator_has_it(compliance, damping):
    K, more = 1 / compliance + 0.3, 0.002
    carried = inertia(T), np.full(N, more), np.full(N, 0.3)
    loads = np.stack([load(T), np.cos(3 * T)], axis=1)
    delta, rate, acceleration = sprung(STEP, loads, carried, compliance, damping)[:, :, 0]

    def right(t, x):
        return [x[1], (load(t) - (damping + more) * x[1] - K * x[0]) / inertia(t)]

    start = delta[0], rate[0]
    exact = solve_ivp(right, (0, T[-1]), start, "LSODA", T, rtol=1e-9, atol=1e-12).y
    bend = np.array([right(t, x)[1] for t, x in zip(T, exact.T, strict=True)])
    settled = slice(200, -10)
    for x, true, close in ((delta, exact[0], 1e-3), (rate, exact[1], 2e-3)):
        assert np.std((x - true)[settled]) < close * np.std(true[settled])
    if compliance > 1e-3:  # of a stiffer one the acceleration is that of the load's bend
        assert np.std((acceleration - bend)[settled]) < 5e-3 * np.std(bend[settled])


def test_without_a_spring_the_slope_is_the_quasi_static_twist():
    carried = inertia(T), np.zeros(N), np.zeros(N)
    h = 1e-9
    slope = sprung(STEP, load(T)[:, None], carried, h, 0.01) / h
    started = sprung(STEP, load(T)[:, None], carried, h, 0.01, np.zeros(1)) / h
    np.testing.assert_allclose(started[0, 5:], slope[0, 5:], atol=1e-5)
    still = sprung(STEP, load(T)[:, None], carried, 0.0, 0.01)
    assert not still.any()
    np.testing.assert_allclose(slope[0, :, 0], load(T), atol=1e-5)


@pytest.mark.parametrize("width", [1e-4, 0.008, 0.05])
def test_a_mass_with_play_flies_and_lands(width):
    delta = with_play(STEP, load(T), inertia(T), width)
    fine, x, v = 50, 0.5 * width * np.sign(load(0.0)), 0.0
    force = np.interp(np.arange(N * fine) * STEP / fine, T, load(T) / inertia(T))
    stepped = np.empty(N)
    for i, a in enumerate(force):
        if i % fine == 0:
            stepped[i // fine] = x
        v += a * STEP / fine
        x += v * STEP / fine
        if abs(x) > width / 2:
            x, v = np.sign(x) * width / 2, 0.0
    assert np.abs(delta).max() == width / 2
    assert np.std(delta - stepped) < 0.02 * width


def test_a_play_that_no_load_crosses_is_one_side():
    heavy = 1.0 + 0.0 * T
    assert (with_play(STEP, heavy, heavy, 0.01) == 0.005).all()
    assert (with_play(STEP, -heavy, heavy, 0.01) == -0.005).all()


@pytest.mark.parametrize("still", [1, 20])
def test_a_play_without_load_for_a_while_changes_its_side(still):
    ends = np.ones(30)
    turning = np.concatenate([ends, np.zeros(still), -ends])
    delta = with_play(STEP, turning, np.ones(len(turning)), 1e-4)
    assert (delta[: 30 + still] == 5e-5).all()
    assert (delta[35 + still :] == -5e-5).all()


@pytest.mark.parametrize("damping", [60.0, 600.0])
def test_a_link_that_creeps_forgets_as_slowly_as_it_does(damping):
    """Its fast mode is over within a step, thousands of times; its slow one takes many."""
    step, inertia, compliance = 0.002, 1e-4, 0.002
    t = step * np.arange(400)
    load = np.sin(2 * np.pi * t / 0.12)
    carried = np.full(400, inertia), np.zeros(400), np.zeros(400)
    found = sprung(step, load[:, None], carried, compliance, damping, start=np.zeros(1))[0][:, 0]
    # D δ̇ + δ/c = L, as M is nothing beside D
    rate, wave = 1 / (damping * compliance), 2 * np.pi / 0.12
    a = 1 / (damping * (rate**2 + wave**2))
    expected = a * (rate * np.sin(wave * t) - wave * np.cos(wave * t) + wave * np.exp(-rate * t))
    assert np.abs(found - expected).max() < 0.03 * np.abs(expected).max()
