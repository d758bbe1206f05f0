"""Torques and motion weighed together: gains, rows, bias, scatter, coverage, what is refused."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import ident
from ident import Multipliers
from ident.equations.filter import STANDING
from ident.equations.motion_noise import gain, linear_runs, rows_cutoff
from ident.equations.rows import Scene, rows
from ident.equations.unknowns import Columns, Point
from ident.motion.smoothing import along, finer
from ident.motion.spline import Smooth

TRUTH = {"rod.Ixx": 4e-3, "rod.Iyy": 4e-4, "rod.Izz": 4e-3}  # kg m²


def noisy(log, snr, seed):
    """White noise on all columns, `snr` dB below their rms."""
    random = np.random.default_rng(seed)
    columns = {
        name: x + np.sqrt(np.mean(x**2)) * 10 ** (-snr / 20) * random.standard_normal(len(x))
        for name, x in log.columns.items()
    }
    return ident.Log.from_arrays(log.name, log.t, columns)


@pytest.fixture(scope="module")
def crank(robots):
    folder = robots / "slider_crank"
    return ident.load(folder), ident.read_log(folder / "run.csv")


def test_gains_of_a_tree_are_the_derivatives_of_inverse_dynamics(robots):
    mechanism = ident.load(robots / "arm")
    (e,) = ident.complete(mechanism, robots / "arm" / "run.csv").experiments
    some = e.thinned(250)
    names = tuple(joint.name for joint in mechanism.joints)
    G = gain(mechanism, some, names, Point.prior(mechanism), None)
    data = mechanism.model.createData()
    for k in range(len(some)):
        exact = pin.computeRNEADerivatives(mechanism.model, data, some.q[k], some.v[k], some.a[k])
        for order in range(3):
            M = exact[order]
            if order == 2:
                M = np.triu(M) + np.triu(M, 1).T
            np.testing.assert_allclose(G[k, :, :, order], -M, atol=2e-4 * np.abs(M).max())


@pytest.mark.parametrize("snr", [60, 20])
def test_rows_are_linear_about_the_motion(crank, snr):
    """b − A x + F G B δ foretells the rows of a motion moved by δ, closures and all."""
    mechanism, log = crank
    motion = ident.complete(mechanism, noisy(log, snr, 0))
    (e,) = motion.experiments
    columns, point = Columns.of(mechanism), Point.prior(mechanism)
    fine, x = finer(mechanism, e, 2), Columns.of(mechanism).prior
    (part,) = linear_runs(mechanism, columns, (0, e), fine, point)
    cutoff = rows_cutoff(fine, e.rate)

    def lacking(experiment):
        scene = Scene.of(mechanism, columns, experiment, point, cutoff)
        return np.concatenate([p.b - p.A @ x for p in rows(scene, cutoff, STANDING)])

    segment, spline, c = part.segment, part.spline, part.c
    step = 1e-7 * np.random.default_rng(0).standard_normal(c.shape)
    moved = replace(spline, c=c + step)
    there = along(mechanism, e, Smooth(fine.names, fine.spacing, ((segment, moved),), ()))
    reached = step[part.first[:, None] + np.arange(part.L.shape[1])]
    foretold = np.einsum("nwiu,nwi->nu", part.L, reached)
    gone = lacking(there) - lacking(e)
    assert np.linalg.norm(gone - foretold) < 1e-4 * np.linalg.norm(foretold)


def test_forty_decibels_are_no_bias_and_intervals_cover(crank):
    """Of sensors that are exact but for their noise."""
    mechanism, log = crank
    mechanism = mechanism.with_calibration("exact")
    off = {"auto": [], "least-squares": []}
    covered = []
    for seed in range(8):
        motion = ident.complete(mechanism, noisy(log, 40, seed))
        for estimator, found in off.items():
            fit = ident.identify(mechanism, motion, estimator=estimator)
            found.append([fit[name].value / true - 1 for name, true in TRUTH.items()])
            if estimator == "auto":
                covered += [
                    abs(fit[name].value - true) < 2 * fit[name].stderr
                    for name, true in TRUTH.items()
                ]
    auto, plain = (np.array(off[name])[:, [0, 2]] for name in off)
    assert (np.abs(auto.mean(axis=0)) < 0.006).all()  # 1 % of scatter over √8, doubled
    assert (auto.std(axis=0) < 0.012).all()
    assert (auto.std(axis=0) < 0.6 * plain.std(axis=0)).all()
    assert np.mean(covered) > 0.8


def test_intervals_cover_with_errors_of_calibration_too(crank):
    """Of sensors that may be off and are not: causes' columns are whitened as the rows are."""
    mechanism, log = crank
    exact = mechanism.with_calibration("exact")
    true = np.array(
        [v.value for v in ident.identify(exact, ident.complete(exact, log)).base_parameters]
    )
    z, errors = [], []
    for seed in range(6):
        fit = ident.identify(mechanism, ident.complete(mechanism, noisy(log, 40, seed)))
        assert fit.likelihood is not None
        z.append([(v.value - x) / v.stderr for v, x in zip(fit.base_parameters, true, strict=True)])
        errors.append(fit.budget.values)
    assert np.mean(np.abs(z) < 2) > 0.8
    assert np.sqrt(np.mean(np.square(errors))) < 1  # of their priors


def test_a_refined_fit_converges_and_says_so(crank):
    mechanism, log = crank
    motion = ident.complete(mechanism, noisy(log, 30, 1))
    fit = ident.identify(mechanism, motion, estimator="likelihood")
    assert fit.likelihood.settled
    assert 1 < fit.likelihood.steps < 8
    assert "converged" in str(fit)
    torque = np.sqrt(np.mean(log.columns["tau.theta"] ** 2)) * 10 ** (-30 / 20)
    assert fit.likelihood.sigma[0] == pytest.approx(torque, rel=0.2)
    # the motion that torques agree with is nearer to the truth than the smoothed one
    at = mechanism.joint_index["theta"]
    before, after = (m.experiments[0] for m in (motion, fit.likelihood.motion))
    inner = slice(20, -20)
    errors = [np.std((e.ydd[:, at] - log.columns["a.theta"])[inner]) for e in (before, after)]
    assert errors[1] < 0.8 * errors[0]


def test_shapes_are_refined_too(robots):
    """Stribeck friction in an arm whose encoders are noisy by 1 mrad."""
    mechanism = ident.load(robots / "arm")
    planted = {}
    for kind, value in (("viscous", 0.5), ("coulomb", 1.0)):
        mechanism = mechanism.with_effect(kind)
        planted |= {name: value for e in mechanism.effects for name in e.names if kind in name}
    mechanism = mechanism.with_effect("stribeck:elbow")
    planted |= {"stribeck.elbow.Fs": 0.8, "stribeck.elbow.vs": 0.3}
    log = ident.read_log(robots / "arm" / "run.csv")
    exact, _ = ident.simulate(mechanism, log, values=planted)
    random = np.random.default_rng(0)
    columns = {
        name: x + (1e-3 if name[0] == "q" else 0.01 * np.std(x)) * random.standard_normal(len(x))
        for name, x in exact.columns.items()
        if name.startswith(("q.", "tau."))
    }
    motion = ident.complete(mechanism, ident.Log.from_arrays("run.csv", exact.t, columns))
    fit = ident.identify(mechanism, motion, estimator="likelihood")
    for name in ("stribeck.elbow.Fs", "stribeck.elbow.vs"):
        value = fit[name]
        assert abs(value.value - planted[name]) < 3.5 * value.stderr, str(value)
        assert value.stderr < 0.1 * planted[name]


def test_a_motion_is_not_bent_to_hide_what_is_missing(robots):
    """Friction that the model lacks: noise does not explain the residual, least squares stays."""
    mechanism = ident.load(robots / "slider_crank").with_effect("coulomb:theta")
    log = ident.read_log(robots / "slider_crank" / "run.csv")
    made, _ = ident.simulate(mechanism, log, values={"coulomb.theta.Fc": 0.05})
    motion = ident.complete(mechanism, noisy(made, 40, 0))
    bare = ident.load(robots / "slider_crank")
    fit = ident.identify(bare, motion)
    assert fit.likelihood is None
    right = ident.identify(mechanism, motion)
    assert right.likelihood is not None
    assert right["coulomb.theta.Fc"].value == pytest.approx(0.05, rel=0.02)


def test_nothing_is_weighed_where_noise_is_small(robots):
    mechanism = ident.load(robots / "arm").with_effect("viscous").with_effect("coulomb")
    fit = ident.identify(mechanism, ident.complete(mechanism, robots / "arm" / "run.csv"))
    assert fit.likelihood is None


def test_what_cannot_be_refined_is_refused(crank):
    mechanism, log = crank
    with pytest.raises(ident.FitError, match="taken as logged"):
        ident.identify(mechanism, ident.complete(mechanism, log), estimator="likelihood")
    motion = ident.complete(mechanism, noisy(log, 40, 0))
    hats = replace(mechanism, multipliers=Multipliers("linear", 0.005))
    with pytest.raises(ident.FitError, match="free multipliers"):
        ident.identify(hats, motion, estimator="likelihood")
    with pytest.raises(ident.FitError, match="least-squares"):
        ident.identify(mechanism, motion, estimator="least-square")


def test_two_logs_are_weighed_together(crank):
    mechanism, log = crank
    logs = [ident.Log.from_arrays(f"{k}.csv", log.t, noisy(log, 40, k).columns) for k in range(2)]
    one = ident.identify(mechanism, ident.complete(mechanism, logs[:1]))
    both = ident.identify(mechanism, ident.complete(mechanism, logs))
    assert both.likelihood is not None
    assert both["rod.Ixx"].stderr < 0.9 * one["rod.Ixx"].stderr
    assert abs(both["rod.Ixx"].value - TRUTH["rod.Ixx"]) < 3 * both["rod.Ixx"].stderr
