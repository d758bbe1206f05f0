"""States beside a state, to first order, against the mechanism completed anew there."""

from dataclasses import replace

import numpy as np
import pytest

import ident
from ident.motion.neighbours import Neighbours


@pytest.mark.parametrize("robot", ["four_bar", "slider_crank", "five_bar", "absolute"])
def test_a_neighbour_is_what_the_closures_complete(robots, robot):
    folder = robots / ("slider_crank" if robot == "absolute" else robot)
    mechanism = ident.load(folder)
    mechanism = ident.absolute(mechanism) if robot == "absolute" else mechanism
    log = ident.read_log(folder / "run.csv")
    log = replace(log, t=log.t[:400], columns={n: x[:400] for n, x in log.columns.items()})
    (e,) = ident.complete(mechanism, log).experiments
    e, names = e.thinned(5), e.independent
    step = 1e-5
    for order in range(3):
        neighbour = Neighbours(mechanism, e, names).shifted(names[-1], order, step)
        known = e.known(mechanism, names).copy()
        known[order][:, -1] += step
        exact = e.at(mechanism, known, names)
        for name in ("q", "v", "a", "yd", "ydd", "pinv", "leverage"):
            now, here, there = (getattr(x, name) for x in (neighbour, e, exact))
            change = np.abs(there - here).max()
            np.testing.assert_allclose(now - here, there - here, atol=2e-3 * change + 1e-11)
