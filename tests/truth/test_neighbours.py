"""States beside a state, to first order, against the mechanism completed anew there."""

import numpy as np
import pytest

import ident
from ident.motion.neighbours import Neighbours


@pytest.mark.parametrize("robot", ["four_bar", "slider_crank", "five_bar"])
@pytest.mark.parametrize("order", range(3))
@pytest.mark.parametrize("absolute", [False, True])
def test_a_neighbour_is_what_the_closures_complete(robots, robot, order, absolute):
    mechanism = ident.load(robots / robot)
    mechanism = ident.absolute(mechanism) if absolute else mechanism
    motion = ident.complete(mechanism, robots / robot / "run.csv")
    e, names = motion.experiments[0].thinned(25), motion.experiments[0].independent
    step = 1e-5
    neighbour = Neighbours(mechanism, e, names).shifted(names[-1], order, step)
    known = e.known(mechanism, names).copy()
    known[order][:, -1] += step
    exact = e.at(mechanism, known, names)
    for name in ("q", "v", "a", "yd", "ydd", "pinv", "leverage"):
        now, here, there = (getattr(x, name) for x in (neighbour, e, exact))
        change = np.abs(there - here).max()
        np.testing.assert_allclose(now - here, there - here, atol=2e-3 * change + 1e-11)
