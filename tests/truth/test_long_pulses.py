"""Pulses at reversals of servos are kept while they are short beside what a filter passes."""

from dataclasses import replace

import numpy as np
import pytest
from test_command_hold import fit_of_servos

from ident.fit.drives import without_long_pulses

pytest.importorskip("polars")
pytest.importorskip("mujoco")


@pytest.fixture(scope="module")
def fit():
    return fit_of_servos(6200, 10.0)


def pulses(fit, estimate):
    at = [i for i, name in enumerate(fit.columns.names) if name.startswith("reversal_pulses")]
    return estimate.x[at], estimate.fixed[at]


def test_short_ones_are_kept(fit):
    values, fixed = pulses(fit, fit.estimate)
    assert len(values) == 6
    assert (values != 0).all()
    assert not fixed.any()


def test_long_ones_are_none(fit):
    band = replace(fit.motion.band, cutoff=30 * fit.motion.band.cutoff)
    passing = replace(fit.problem, motion=replace(fit.motion, band=band))
    values, fixed = pulses(fit, without_long_pulses(passing, fit.estimate))
    assert fixed.all()
    assert np.all(values == 0)


def test_without_a_filter_nothing_is_long(fit):
    band = replace(fit.motion.band, cutoff=None)
    passing = replace(fit.problem, motion=replace(fit.motion, band=band))
    assert without_long_pulses(passing, fit.estimate) is fit.estimate
