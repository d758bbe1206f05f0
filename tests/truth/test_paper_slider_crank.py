"""Sect. 3.2 of the paper: the spatial slider-crank in joint coordinates, free of noise."""

from dataclasses import replace

import numpy as np
import pytest

import ident
from ident import Multipliers
from ident.equations.rows import Scene, full_rows
from ident.equations.unknowns import Columns

TRUTH = {"rod.Ixx": 4e-3, "rod.Iyy": 4e-4, "rod.Izz": 4e-3}  # kg m², table 1


@pytest.fixture(scope="module")
def crank(robots):
    mechanism = ident.load(robots / "slider_crank")
    return mechanism, ident.complete(mechanism, robots / "slider_crank" / "run.csv")


@pytest.fixture(scope="module")
def reactions(robots):
    table = ident.read_log(robots / "slider_crank" / "reactions.csv")
    return np.stack([table.columns[f"ball.{axis}"] for axis in "xyz"], axis=1)


def identify(crank, basis, spacing=0.0):
    """The fit, and how far each inertia is off [%]."""
    mechanism, motion = crank
    fit = ident.identify(replace(mechanism, multipliers=Multipliers(basis, spacing)), motion)
    values = {value.name: value.value for value in fit.parameters}
    assert list(values) == list(TRUTH)
    return fit, np.array([100 * (values[name] / true - 1) for name, true in TRUTH.items()])


def test_free_multipliers_are_exact(crank, reactions):
    fit, off = identify(crank, "free")
    assert np.abs(off).max() < 1e-8  # %
    ((_, found),) = fit.multipliers
    assert np.abs(found - reactions).max() < 1e-9 * np.abs(reactions).max()
    assert max(error.relative for error in fit.train.values()) < 1e-9


def test_the_papers_hats_have_their_known_bias(crank, reactions):
    fit, off = identify(crank, "linear", 0.005)
    assert fit.problem.bands[0].basis.count == 401
    np.testing.assert_allclose(off, [-0.847, 35.95, -0.745], atol=0.02)
    # the reactions reach 79 N: worst 1.45 N where they jump, rms 0.055 N
    assert multiplier_errors(fit, reactions) == pytest.approx((1.445, 0.0554), rel=0.01)


def test_hats_are_solved_by_the_dense_stack_too(crank):
    """Row by row the paper's eq. 8, [Γ | JᵀB] [p; a] = τ, by NumPy's least squares."""
    mechanism, motion = crank
    few = slice(0, 301)  # 1204 equations of 3 + 61 · 3 unknowns
    (e,) = motion.experiments
    columns = Columns.of(mechanism)
    A, b, _ = full_rows(Scene.of(mechanism, columns, e), few)
    J_T = mechanism.kinematics.closure_rows(e.q[few]).rate.transpose(0, 2, 1)
    knots = np.arange(61) * 0.005
    hat = np.maximum(0, 1 - np.abs(e.t[few, None] - knots) / 0.005)
    dense = np.einsum("nvm,nk->nvkm", J_T, hat).reshape(301 * 4, 61 * 3)
    stack = np.hstack([A.reshape(301 * 4, 3), dense])
    x = np.linalg.lstsq(stack, b.reshape(-1), rcond=None)[0][:3]
    at = mechanism.joint_index["theta"]
    logged = {f"{c}.theta": y[few, at] for c, y in (("q", e.y), ("v", e.yd), ("a", e.ydd))}
    logged |= {f"tau.{name}": e.tau[few, i] for i, name in enumerate(mechanism.driven)}
    cut = ident.Log.from_arrays("cut.csv", e.t[few], logged)
    short = ident.complete(mechanism, cut, cutoff=None)
    hats = replace(mechanism, multipliers=Multipliers("linear", 0.005))
    found = ident.identify(hats, short).estimate.solution.x
    np.testing.assert_allclose(found, x, rtol=1e-8)


@pytest.mark.parametrize(
    ("basis", "most", "worst", "rms"),
    [
        ("cubic", [0.003, 0.12, 0.003], 0.1, 0.004),
        ("quintic", [0.0004, 0.015, 0.0004], 0.04, 0.002),
    ],
)
def test_smooth_bases_are_far_better(crank, reactions, basis, most, worst, rms):
    fit, off = identify(crank, basis, 0.005)
    assert (np.abs(off) < most).all(), off
    largest, mean = multiplier_errors(fit, reactions)  # [N]
    assert largest < worst
    assert mean < rms


def multiplier_errors(fit, reactions):
    ((_, found),) = fit.multipliers
    return np.abs(found - reactions).max(), np.sqrt(((found - reactions) ** 2).mean())
