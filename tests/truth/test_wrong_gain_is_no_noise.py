"""What a wrong gain or gear ratio leaves is the motion's, and never taken for coloured noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import ident
from helpers import ROBOTS
from ident.assess.fit import assess_fit
from ident.assess.good_enough import Reason
from ident.information.evidence import NOISY

RATE, SECONDS, HIGHEST = 200.0, 10.0, 0.5  # Hz, s, Hz
VALUES = {"Fv": 0.3, "Fc": 0.3}  # N m s/rad, N m


@pytest.fixture(scope="module")
def arm():
    return ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb")


def log_of(arm, seed):
    """Sums of five sines a joint that repeat nothing, positions with 0.1 mrad of noise, torques
    with 0.3 % of each; and what made the noise.
    """
    random = np.random.default_rng(seed)
    t, columns = np.arange(0, SECONDS, 1 / RATE), {}
    start = {"yaw": 0.0, "shoulder": -0.6, "elbow": 1.2, "wrist": 0.0}
    for joint, middle in start.items():
        w = 2 * np.pi * HIGHEST * random.uniform(0.2, 1.0, 5)
        phase, size = random.uniform(0, 2 * np.pi, 5), random.uniform(0.1, 0.4, 5)
        angle = w * t[:, None] + phase
        columns |= {
            f"q.{joint}": middle + np.sin(angle) @ size,
            f"v.{joint}": np.cos(angle) @ (w * size),
            f"a.{joint}": np.sin(angle) @ (-(w**2) * size),
        }
    motion = ident.Log.from_arrays("motion", t, columns)
    values = {name: VALUES[name.rpartition(".")[2]] for e in arm.effects for name in e.names}
    log = ident.simulate(arm, motion, values=values, columns=["q", "tau"], joints=[*start])[0]
    noisy = {
        name: x + (1e-4 if name[0] == "q" else 0.003 * np.std(x)) * random.standard_normal(len(x))
        for name, x in log.columns.items()
    }
    return t, noisy, random


def fitted(arm, t, columns):
    return ident.identify(arm, ident.complete(arm, ident.Log.from_arrays("run.csv", t, columns)))


@pytest.mark.parametrize("seed", [1, 4])
def test_a_wrong_gain_is_no_noise(arm, seed):
    """Of an arm of which only the last two bodies are unknown, so that they cannot follow it."""
    unknown = tuple(x for x in arm.unknown if x.split(".")[0] in ("forearm", "hand"))
    t, columns, _ = log_of(arm, seed)
    columns["tau.yaw"] = 1.08 * columns["tau.yaw"]
    fit = fitted(replace(arm, unknown=unknown), t, columns)
    assert fit.train["yaw"].rms > NOISY * fit.noise["yaw"]
    assessment = assess_fit(fit)
    assert assessment.good_enough.reason is Reason.LARGE
    assert "yaw" in assessment.left.joints
    assert [finding.code for finding in fit.poor] == ["poor fit"]
    compared = ident.compare(fit).residuals.values()
    assert all(residual.noise == fit.noise for residual in compared)


@pytest.mark.parametrize("correlation", [0.9, 0.97])
def test_noise_of_any_colour_is_noise(arm, correlation):
    """Of the same arm with right gains, whose torques have 3 % of noise that is slow."""
    t, columns, random = log_of(arm, 5)
    color = [np.sqrt(1 - correlation**2)], [1, -correlation]
    for name, x in columns.items():
        if name.startswith("tau."):
            slow = lfilter(*color, random.standard_normal(len(t)))
            columns[name] = x + 0.03 * np.std(x) * slow
    fit = fitted(arm, t, columns)
    assert all(fit.train[joint].rms < NOISY * noise for joint, noise in fit.noise.items())
