"""Monte Carlo runs whose sensors have errors drawn from the priors of the calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.mechanism.calibration import Calibration
from ident.mechanism.causes import causes_of
from ident.montecarlo import monte_carlo
from ident.simulate.misread import misread
from identification import motion_log, plant, robot


@pytest.fixture(scope="module")
def arm():
    known = replace(robot("arm"), calibration=Calibration())
    return known.with_effect("viscous").with_effect("coulomb")


@pytest.fixture(scope="module")
def log(arm):
    return plant(arm, motion_log("arm", 100.0, 6.0), seed=1).log


def test_each_error_is_read_as_it_is_corrected(arm, log):
    causes = [*causes_of(arm, ("elbow", "wrist"), 100.0)]
    scale = {cause.name: cause.scale for cause in causes}
    size = {"gain of tau.elbow": 2.0, "zero of q.elbow": 1.0, "the clock": 1.0,
            "lateness of q.wrist": 1.0, "length elbow.x": 3.0}  # fmt: skip
    read = misread(log, causes, size)
    clock, inside = 1 + scale["the clock"], slice(10, -10)
    np.testing.assert_allclose(read.t * clock, log.t)
    before, after = log.columns, read.columns
    gain = 1 + 2 * scale["gain of tau.elbow"]
    np.testing.assert_allclose(after["tau.elbow"], gain * before["tau.elbow"])
    np.testing.assert_allclose(after["q.elbow"], before["q.elbow"] - scale["zero of q.elbow"])
    np.testing.assert_allclose(after["a.elbow"], clock**2 * before["a.elbow"])
    moved = after["q.wrist"][inside][1:], before["q.wrist"][inside][:-1]  # by a sample
    np.testing.assert_allclose(*moved, atol=1e-6)
    np.testing.assert_array_equal(after["tau.wrist"], before["tau.wrist"])


def test_intervals_of_all_hold_where_those_of_noise_do_not(arm, log):
    """By values that every run determines by themselves."""
    options = {"snr": 40, "runs": 8, "estimators": "least-squares", "channels": ("tau",), "jobs": 1}
    both = monte_carlo(arm, log, misread=True, **options)
    alone = monte_carlo(arm, log, **options)
    assert both.table["coverage"].mean() > 0.88
    assert (both.table["std"] / alone.table["std"]).median() > 2.0
    again = monte_carlo(arm, log, misread=True, **{**options, "runs": 2})
    first = both.samples.filter(both.samples["run"] < 2)
    assert again.samples.equals(first)
