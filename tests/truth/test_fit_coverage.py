"""value ± 1.96 standard errors covers the truth in about 95 of 100 logs, in a simulation study.

Noise is on the torques alone, white or a first-order autoregression at the log's rate. Noise on
positions biases as well, which no standard error can show.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import ident
from ident import Fit
from identification import motion_log, plant, robot

BURN = 200


def coverage(name, rho, runs, *, cutoff="auto", level=0.01, seed=0):
    """|value − truth| / standard error (runs, rank) of the base parameters, and their names."""
    mechanism = robot(name).with_effect("viscous").with_effect("coulomb")
    case = plant(mechanism, motion_log(name, 250.0, 12.0), seed=seed)
    (clean,) = ident.complete(mechanism, case.log, cutoff=None).experiments
    rng = np.random.default_rng(seed)
    motion, found = None, []
    size = level * clean.tau.std(axis=0)
    fit: Fit | None = None
    for _ in range(runs):
        white = rng.standard_normal((BURN + len(clean), clean.tau.shape[1]))
        noise = lfilter([np.sqrt(1 - rho**2)], [1, -rho], white, axis=0)[BURN:]
        if motion is None:  # the filter is chosen from a noisy log, then kept
            columns = dict(case.log.columns)
            for i, joint in enumerate(mechanism.driven):
                columns[f"tau.{joint}"] = clean.tau[:, i] + size[i] * noise[:, i]
            log = ident.Log.from_arrays("log", clean.t, columns)
            motion = ident.complete(mechanism, log, cutoff=cutoff)
        e = replace(motion.experiments[0], tau=clean.tau + size * noise)
        fit = ident.identify(mechanism, replace(motion, experiments=(e,)))
        off = fit.estimate.solution.beta - case.base(fit)
        found.append(np.abs(off) / np.sqrt(np.diag(fit.covariance)))
    assert fit is not None
    names = [v.name for v in fit.base_parameters]
    return np.array(found), np.array([n.split(".")[0] in ("viscous", "coulomb") for n in names])


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_intervals_cover_the_truth(rho):
    """Filtered and decimated as by default; loose, since 60 runs are few."""
    z, effects = coverage("five_bar", rho, 60)
    for part in (z[:, effects], z[:, ~effects]):
        assert 0.88 <= (part < 1.96).mean() <= 0.995
    assert np.median(z) == pytest.approx(0.674, abs=0.15)  # of a normal distribution


@pytest.mark.slow
@pytest.mark.parametrize("cutoff", ["auto", None])
@pytest.mark.parametrize("rho", [0.0, 0.9])
@pytest.mark.parametrize("name", ["five_bar", "four_bar", "arm"])
def test_intervals_cover_the_truth_at_length(name, rho, cutoff):
    z, effects = coverage(name, rho, 400, cutoff=cutoff)
    for what, part in (("effects", z[:, effects]), ("bodies", z[:, ~effects])):
        share = (part < 1.96).mean()
        print(
            name,
            rho,
            cutoff,
            what,
            f"{100 * share:.1f} %",
            f"worst {100 * (part < 1.96).mean(axis=0).min():.1f} %",
        )
        assert 0.90 <= share <= 0.99
        assert ((part < 1.96).mean(axis=0) >= 0.86).all()
