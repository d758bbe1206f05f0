"""Sect. 3.1 of the paper: the pendulum in absolute coordinates, free of noise.

The truth is 0.2 kg m² and the reactions of its equation of motion (robots/pendulum/README.md).
"""

from dataclasses import replace

import numpy as np
import pytest

import ident
from ident import Multipliers

INERTIA = 0.2


@pytest.fixture(scope="module")
def pendulum(robots):
    mechanism = ident.load(robots / "pendulum")
    motion = ident.complete(mechanism, robots / "pendulum" / "run.csv")
    return mechanism, motion


@pytest.fixture(scope="module")
def reactions(robots):
    table = ident.read_log(robots / "pendulum" / "reactions.csv")
    return np.stack([table.columns["pin.x"], table.columns["pin.y"]], axis=1)


def identify(pendulum, basis, spacing=0.0):
    mechanism, motion = pendulum
    fit = ident.identify(replace(mechanism, multipliers=Multipliers(basis, spacing)), motion)
    (value,) = fit.parameters
    assert (value.name, value.unit, value.identifiable) == ("rod.Izz", "kg m²", True)
    return fit, value.value


def test_nothing_is_filtered_or_left_out(pendulum):
    _, motion = pendulum
    assert motion.band.cutoff is None
    assert motion.samples == 501
    assert motion.closure_error < 1e-10


def test_free_multipliers_are_exact(pendulum, reactions):
    fit, inertia = identify(pendulum, "free")
    assert inertia == pytest.approx(INERTIA, rel=1e-9)
    ((_, found),) = fit.multipliers
    assert np.abs(found - reactions).max() < 1e-9 * np.abs(reactions).max()


def test_the_papers_hats(pendulum, reactions):
    fit, inertia = identify(pendulum, "linear", 0.05)
    assert fit.problem.bands[0].basis.count == 101
    assert inertia == pytest.approx(INERTIA, rel=0.002)
    assert inertia == pytest.approx(0.200335, abs=1e-6)
    # hats between knots 50 ms apart: worst 4.0 N of 280 N, rms 1.0 N
    assert errors(fit, reactions) == pytest.approx((3.98, 0.993), rel=0.01)


def test_the_bias_of_hats_is_the_basis_and_falls_with_the_spacing(pendulum):
    # λ is missed by the 2nd order in the spacing, I by its square; none where each sample is a knot
    off = [abs(identify(pendulum, "linear", spacing)[1] - INERTIA) for spacing in (0.05, 0.025)]
    assert 10.0 < off[0] / off[1] < 40.0
    assert identify(pendulum, "linear", 0.01)[1] == pytest.approx(INERTIA, rel=1e-9)


@pytest.mark.parametrize(
    ("basis", "degree", "inertia", "worst", "rms"),
    [("cubic", 3, 1e-6, 0.06, 0.02), ("quintic", 5, 1e-8, 3e-3, 1e-3)],
)
def test_smooth_bases_of_as_many_functions(pendulum, reactions, basis, degree, inertia, worst, rms):
    fit, found = identify(pendulum, basis, 5 / (101 - degree))
    assert fit.problem.bands[0].basis.count == 101
    assert found == pytest.approx(INERTIA, rel=inertia)
    most, mean = errors(fit, reactions)  # [N]; the reactions reach 280 N
    assert most < worst
    assert mean < rms


def errors(fit, reactions):
    """Largest and root mean square difference of the multipliers [N]."""
    ((_, found),) = fit.multipliers
    return np.abs(found - reactions).max(), np.sqrt(((found - reactions) ** 2).mean())


def test_the_report_says_what_the_basis_does(pendulum):
    fit, _ = identify(pendulum, "linear", 0.05)
    assert any("0.05" in said or "50 ms" in said for said in fit.warnings), fit.warnings
    free, _ = identify(pendulum, "free")
    assert not any("basis" in said for said in free.warnings)
