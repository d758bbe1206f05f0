"""Knots where noise is not white: chosen by the torques, and moved by the cut-off."""

import numpy as np
import polars as pl
import pytest
from scipy.signal import lfilter

import ident
from helpers import ROBOTS

FRICTION = 0.3  # N m s/rad, N m: of all joints


@pytest.fixture(scope="module")
def arm():
    return ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb")


@pytest.fixture(scope="module", params=[(0.8, 1e-3), (0.95, 1e-3)])
def log(request, arm):
    """Positions with noise of a correlation from sample to sample, and a size [rad]."""
    rho, size = request.param
    values = {name: FRICTION for effect in arm.effects for name in effect.names}
    clean, _ = ident.simulate(
        arm, ident.read_log(ROBOTS / "arm" / "run.csv"), values=values, columns=["q", "tau"],
        seed=1, noise=[ident.Noise("tau", 0.01, True)],
    )  # fmt: skip
    random, columns = np.random.default_rng(1), dict(clean.columns)
    for name in columns:
        if name.startswith("q."):
            white = random.standard_normal(len(clean.t))
            noise = lfilter([np.sqrt(1 - rho**2)], [1, -rho], white)
            columns[name] = columns[name] + size * noise
    return pl.DataFrame({"t": clean.t, **columns})


def error(arm, motion):
    """The mean error of friction [N m s/rad, N m]."""
    point = ident.identify(arm, motion, estimator="least-squares").point
    names = [name for effect in arm.effects for name in effect.names]
    return np.mean([abs(point.values[name] - FRICTION) for name in names])


def test_torques_choose_knots_that_noise_does_not_mislead(arm, log, monkeypatch):
    motion = ident.complete(arm, log)
    assert any("noise of the positions is not white" in note for note in motion.notes)
    assert motion.band.cutoff <= 0.5 / motion.experiments[0].smooth.spacing + 1e-9
    monkeypatch.setattr("ident.motion.motion.doubtful", lambda *_: False)
    white = ident.complete(arm, log)
    assert error(arm, motion) < 0.5 * error(arm, white)


def test_a_cutoff_moves_the_knots(arm, log):
    (e,) = ident.complete(arm, log, cutoff=0.2).experiments
    assert e.smooth.spacing >= 0.5 * 0.999  # s: a tenth of the cut-off's period, or more
