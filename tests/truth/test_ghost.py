"""Ghosts: to first order where a simulation with the measured torques takes the machine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.fit.ghost import drift


@pytest.fixture(scope="module", params=["arm", "four_bar"])
def fitted(request):
    """A model without the friction of the machine, which is seen to leave the motion."""
    mechanism = ident.load(ROBOTS / request.param)
    motion = ident.complete(mechanism, ROBOTS / request.param / "run.csv")
    short = replace(motion, experiments=(motion.experiments[0].at_samples(slice(100, 260)),))
    return ident.identify(mechanism, motion, estimator="least-squares"), short


def test_a_ghost_is_where_the_simulation_is(fitted):
    fit, short = fitted
    (prediction,) = fit.predict(short)
    (positions,), window = drift([prediction], longest=0.06)
    (run,) = ident.replay(fit, motion=short, window=window).runs["fit"]
    e = prediction.scene.e
    columns = [fit.mechanism.joint(name).index for name in run.joints]
    known = np.isfinite(run.simulated).all(axis=1)
    known[list(run.starts)] = False  # there the simulation has the end of the window before
    away = (positions - e.q)[:, columns][known]
    simulated = (run.simulated - run.measured)[known]
    size = np.sqrt((simulated**2).mean(axis=0))
    off = np.sqrt(((away - simulated) ** 2).mean(axis=0))
    moved = size > 0.1 * size.max()
    assert moved.any()
    assert (off[moved] < 0.2 * size[moved]).all(), (off, size)


def test_a_true_model_has_no_ghost(fitted):
    fit, short = fitted
    (prediction,) = fit.predict(short)
    true = replace(prediction, measured=prediction.predicted)
    (positions,), _ = drift([true])
    np.testing.assert_allclose(positions, prediction.scene.e.q, atol=1e-9)
