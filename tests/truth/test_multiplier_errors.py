"""Errors of multipliers: what a wrong prior of a body that no torque shows does to reactions."""

import numpy as np
import pytest

import ident


@pytest.fixture(scope="module")
def fits(robots):
    """The four-bar from its log with the URDF's prior, and with another one of what stays open."""
    mechanism = ident.load(robots / "four_bar").with_calibration("exact")
    for name in ("viscous", "coulomb"):
        mechanism = mechanism.with_effect(name)
    motion = ident.complete(mechanism, robots / "four_bar" / "run.csv")
    return mechanism, motion, ident.identify(mechanism, motion)


def test_a_prior_moves_multipliers_by_what_is_said(fits):
    _, motion, fit = fits
    errors, base = fit.multiplier_errors, fit.estimate.base
    names = [fit.columns.names[i] for i in base.dependent]
    moved = next(name for on in errors.resting.values() for name in on)
    at = names.index(moved)
    i = base.dependent[at]
    size = fit.problem.plausible[i]
    x = fit.estimate.x.copy()  # the same torques: base parameters stay
    x[i] += size
    x[base.independent] -= base.K[:, at] * size
    before, after = (fit.predict(motion), _predicted(fit, x, motion))
    np.testing.assert_allclose(after[0].predicted, before[0].predicted, atol=1e-6)
    shift = after[0].multipliers - before[0].multipliers
    rms = np.sqrt(np.nanmean(shift**2, axis=0))
    assert (rms <= 1.1 * errors.by_priors + 1e-9).all()
    assert (rms > 0.3 * errors.by_priors).any()


def _predicted(fit, x, motion):
    from ident.fit.prediction import predict

    return predict(fit.mechanism, motion, fit.problem.point_at(x))


def test_no_prior_is_named_where_all_bodies_are_known(robots):
    from dataclasses import replace

    mechanism = replace(ident.load(robots / "four_bar"), unknown=()).with_calibration("exact")
    mechanism = mechanism.with_effect("viscous")
    fit = ident.identify(mechanism, ident.complete(mechanism, robots / "four_bar" / "run.csv"))
    assert fit.multiplier_errors.resting == {}
    assert (fit.multiplier_errors.by_values >= 0).all()
