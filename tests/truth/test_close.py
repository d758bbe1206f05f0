"""Newton's steps towards closed loops."""

import numpy as np
import pytest

from ident.mechanism import load
from ident.motion.closures import LoopSolver, pseudo_inverse

LOOPS = {"slider_crank": ("theta",), "four_bar": ("crank",), "five_bar": ("left", "right")}


def near(name, robots, n=40):
    """A closer of the drives, configurations off the closed ones by up to 0.05, and targets."""
    mechanism, random = load(robots / name), np.random.default_rng(0)
    closer = LoopSolver(mechanism, LOOPS[name])
    q = mechanism.general + random.uniform(-0.05, 0.05, (n, mechanism.model.nq))
    return closer, q, closer.coordinates(q).value


@pytest.mark.parametrize("name", LOOPS)
def test_newton_closes_the_loops_at_the_given_coordinates(name, robots):
    closer, q, target = near(name, robots)
    found, left = closer.newton(q, target)
    assert left.max() < 1e-12
    assert np.abs(closer.mechanism.kinematics.closure_rows(found).value).max() < 1e-12
    np.testing.assert_allclose(closer.coordinates(found).value, target, atol=1e-12)


@pytest.mark.parametrize("name", LOOPS)
def test_a_singular_configuration_among_others_does_not_spoil_them(name, robots):
    closer, q, target = near(name, robots)
    whole, others = closer.newton(q, target)[0], np.arange(len(q)) != 3
    q[3] = 0.0  # links on one line
    found, left = closer.newton(q, target)
    assert left[others].max() < 1e-12
    np.testing.assert_allclose(found[others], whole[others], rtol=0, atol=1e-12)


def test_what_cannot_be_reached_is_said_to_be_left_open(robots):
    mechanism = load(robots / "five_bar")  # at zero all its links lie on one line
    q = np.zeros((1, mechanism.model.nq))
    _, left = LoopSolver(mechanism, mechanism.driven).newton(q, np.zeros((1, 2)))
    assert not left[0] < 1e-3


@pytest.mark.parametrize("name", LOOPS)
def test_steps_with_the_inverse_of_a_state_close_by_end_where_newton_does(name, robots):
    closer, q, target = near(name, robots)
    closed, _ = closer.newton(q, target)
    J, W = closer.mechanism.kinematics.closure_rows(closed).rate, closer.coordinates(closed).rate
    inverse = pseudo_inverse(np.concatenate([J, W], axis=1))
    inverse[3] *= -3.0  # leads away: this sample is Newton's
    again, left = closer.near(closed, inverse, target + 1e-3)
    assert left.max() < 1e-11
    np.testing.assert_allclose(again, closer.newton(closed, target + 1e-3)[0], rtol=0, atol=1e-10)
