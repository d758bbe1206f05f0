"""Errors of the predicted torque: fitted, held out, in other logs, and of several models."""

from dataclasses import replace

import numpy as np
import pytest

import ident
from ident import FitError, Log, Noise
from ident.assess.fit import assess_fit
from ident.equations.problem import information_of, stacks_information
from ident.fit.files import residual_before
from ident.information.blocks import Information
from ident.information.chance import folds
from ident.show.fit import card
from identification import motion_log, plant, robot

NOISE = [Noise("tau", 0.02, relative=True)]


def noisy(name, *effects, seed=1, seconds=8.0, noise=NOISE):
    mechanism = robot(name)
    for kind in effects:
        mechanism = mechanism.with_effect(kind)
    return plant(mechanism, motion_log(name, 100.0, seconds), noise=noise, seed=seed)


# --- what an error is --------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["arm", "five_bar", "slider_crank"])
def test_the_error_is_that_of_the_prediction(name):
    """Unfiltered: rms of measured − predicted, and its share of the measured torque, in motion and
    over all samples.
    """
    fit = noisy(name, "viscous", "coulomb").fit()
    (said,) = fit.predict()
    for u, joint in enumerate(said.joints):
        error = fit.train[joint]
        for found, use in ((error, said.moving[:, u]), (error.with_standstill, slice(None))):
            rms = np.sqrt(np.mean(said.residual[use, u] ** 2))
            assert found.rms == pytest.approx(rms, rel=1e-9)
            share = rms / np.sqrt(np.mean(said.measured[use, u] ** 2))
            assert found.relative == pytest.approx(share, rel=1e-9)


def test_the_parts_of_a_prediction_add_up():
    fit = noisy("five_bar", "viscous", "coulomb").fit()
    (said,) = fit.predict()
    assert list(said.parts) == ["rigid bodies", *(e.label for e in fit.mechanism.effects)]
    np.testing.assert_allclose(sum(said.parts.values()), said.predicted, atol=1e-12)


def test_a_prediction_never_sees_the_torque():
    case = noisy("slider_crank", "viscous")
    fit = case.fit()
    (before,) = fit.predict()
    joint = before.joints[0]
    columns = dict(case.log.columns)
    columns[f"tau.{joint}"] = 5.0 + 0 * columns[f"tau.{joint}"]
    motion = ident.complete(fit.mechanism, Log.from_arrays("log", case.log.t, columns), cutoff=None)
    (after,) = fit.predict(motion)  # the other drive's force is an input, the same in both
    np.testing.assert_array_equal(after.predicted, before.predicted)


def test_samples_at_standstill_count_in_an_error_of_their_own_and_not_in_the_fit():
    case = noisy("arm", "viscous", "coulomb")
    fit = case.fit()
    rest = sum(block.rest.rows for block in fit.information)
    rows = sum(block.triangle.rows for block in fit.information)
    assert rest > 0
    assert rest + rows == 4 * len(case.log.t)
    assert fit.estimate.triangle.rows == rows
    assert any("at standstill" in said for said in fit.warnings)
    # a torque that only friction at rest explains: the error in motion does not see it
    motion = fit.motion
    (e,) = motion.experiments
    at = fit.mechanism.driven.index("elbow")
    still = np.abs(e.yd[:, at]) < e.still[at]
    assert still.any()
    tau = e.tau.copy()
    tau[still, at] += 5.0
    other = ident.identify(fit.mechanism, replace(motion, experiments=(replace(e, tau=tau),)))
    errors = other.train["elbow"], fit.train["elbow"]
    assert errors[0].rms == pytest.approx(errors[1].rms, rel=0.01)
    assert errors[0].with_standstill.rms > 1.05 * errors[1].with_standstill.rms
    np.testing.assert_allclose(
        other.estimate.solution.beta, fit.estimate.solution.beta, rtol=0.02, atol=1e-3
    )


def test_relative_is_null_without_torque(robots):
    """The pendulum is driven by nothing: there is a residual but nothing to compare it with."""
    mechanism = ident.load(robots / "pendulum")
    fit = ident.identify(mechanism, ident.complete(mechanism, robots / "pendulum" / "run.csv"))
    (error,) = fit.train.values()
    assert error.relative is None
    assert np.isfinite(error.rms)
    assert "–" in str(fit)


# --- held out ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["arm", "five_bar", "four_bar"])
def test_held_out_errors_are_larger_than_fitted_ones(name):
    fit = noisy(name, "viscous", "coulomb", seconds=12.0).fit(cutoff="auto")
    assert set(fit.held_out) == set(fit.train)
    for joint, error in fit.train.items():
        assert error.rms <= fit.held_out[joint].rms < 2 * error.rms


def test_held_out_is_cross_validation_over_stretches_of_time():
    """By hand: refit without each stretch, add up the squares."""
    fit = noisy("five_bar", "viscous").fit()
    d, prior = 2, fit.columns.prior
    parted = folds(fit.information, 10)
    assert len(parted) == 10
    base = fit.estimate.base
    left, n = np.zeros((2, d))
    for number, out in parted.items():
        rows = [c for other, part in parted.items() if other != number for c in part]
        A, b = [], []
        for u, total in enumerate(Information.of(rows, len(prior), d).totals):
            A.append(total.R / fit.estimate.sigma[u])
            b.append(total.d / fit.estimate.sigma[u])
        A, b = np.concatenate(A), np.concatenate(b)
        x = prior.copy()
        beta = np.linalg.lstsq(A[:, base.independent], b, rcond=None)[0]
        x[base.independent] = beta - base.K @ x[base.dependent]
        squares, _, rows = out.squares(x).in_motion
        left, n = left + squares, n + rows
    for u, joint in enumerate(fit.motion.independent):
        assert fit.held_out[joint].rms == pytest.approx(np.sqrt(left[u] / n[u]), rel=1e-6)


def test_stretches_of_a_basis_and_of_a_log_are_the_same_times():
    """A log with a gap: runs of samples are parts of one experiment, not experiments."""
    mechanism = replace(robot("five_bar"), multipliers=ident.Multipliers("linear", 0.02))
    case = plant(mechanism, motion_log("five_bar", 100.0, 12.0), noise=NOISE)
    keep = (case.log.t < 3.0) | (case.log.t > 3.6)
    log = Log.from_arrays(
        "gap.csv", case.log.t[keep], {k: x[keep] for k, x in case.log.columns.items()}
    )
    fit = ident.identify(mechanism, ident.complete(mechanism, log, cutoff=None))
    assert len(fit.problem.bands) == 2
    stacks = stacks_information(fit.problem.bands, fit.motion)
    fitting, scoring = (folds(each, 10) for each in (stacks, fit.information))
    assert set(fitting) == set(scoring)
    for number, part in fitting.items():
        mine, theirs = (
            (min(c.span[0] for c in cells), max(c.span[1] for c in cells))
            for cells in (part, scoring[number])
        )
        assert mine == pytest.approx(theirs, abs=0.7)
    for joint, error in fit.train.items():
        assert 0.98 * error.rms < fit.held_out[joint].rms < 2 * error.rms


# --- other logs --------------------------------------------------------------------------------


def test_validation_logs_are_scored_and_not_fitted():
    case = noisy("five_bar", "viscous", seed=1)
    others = [noisy("five_bar", "viscous", seed=1, noise=NOISE, seconds=s).log for s in (4.0, 6.0)]
    others = [Log.from_arrays(f"other {i}", x.t, dict(x.columns)) for i, x in enumerate(others)]
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    check = ident.complete(case.mechanism, others, cutoff=None)
    plain = ident.identify(case.mechanism, motion)
    fit = ident.identify(case.mechanism, motion, validate=check)
    np.testing.assert_array_equal(fit.estimate.solution.x, plain.estimate.solution.x)
    assert list(fit.validation) == ["other 0", "other 1"]
    for said, (_, errors) in zip(fit.predict(check), fit.validation.items(), strict=True):
        for u, joint in enumerate(said.joints):
            rms = np.sqrt(np.mean(said.residual[said.moving[:, u], u] ** 2))
            assert errors[joint].rms == pytest.approx(rms, rel=1e-9)
    assert "other 0" in str(fit)


def test_a_validation_log_is_judged_by_its_own_noise():
    """The torques of another day may be noisier than those of the fit."""
    case = noisy("arm", "viscous", seed=1)
    random, columns = np.random.default_rng(0), dict(case.log.columns)
    for name in (f"tau.{joint}" for joint in case.mechanism.driven):
        spread = np.std(columns[name])
        columns[name] = columns[name] + 0.08 * spread * random.normal(size=len(case.log.t))
    motion = ident.complete(case.mechanism, case.log)
    loud = Log.from_arrays("loud", case.log.t, columns)
    check = ident.complete(case.mechanism, loud, cutoff=motion.band.cutoff)
    fit = ident.identify(case.mechanism, motion, validate=check)
    for joint, noise in fit.noise.items():
        assert fit.floors["loud"][joint] == pytest.approx(4.1 * noise, rel=0.3)
    assert fit.validation["loud"]["yaw"].rms > 2 * fit.noise["yaw"]
    assert "Good enough on loud? Yes" in " ".join(str(fit).split())


# --- several models ----------------------------------------------------------------------------


def test_compare_gives_the_numbers_of_the_fits():
    full = noisy("arm", "viscous", "coulomb")
    good, bare = full.fit(cutoff="auto"), full.fit(mechanism=robot("arm"), cutoff="auto")
    compared = ident.compare(bare, good)
    for errors, fit in zip(compared.errors.values(), (bare, good), strict=True):
        assert set(errors) == set(fit.train)
        for joint, error in errors.items():
            assert error.rms == pytest.approx(fit.train[joint].rms, rel=1e-12)
            assert error.relative == pytest.approx(fit.train[joint].relative, rel=1e-12)
            assert error.unit == fit.train[joint].unit
    assert "falls in" in str(compared)
    figure = compared.plot()
    assert len(figure.axes) == 8


def test_compare_on_another_motion_is_its_validation():
    case, other = noisy("five_bar", "viscous"), noisy("five_bar", "viscous", seconds=4.0)
    check = ident.complete(case.mechanism, other.log, cutoff=None)
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    fit = ident.identify(case.mechanism, motion, validate=check)
    (errors,) = ident.compare(fit, motion=check).errors.values()
    (validation,) = fit.validation.values()
    for joint, error in errors.items():
        assert error.rms == pytest.approx(validation[joint].rms, rel=1e-12)


def test_compare_needs_something_to_compare(tmp_path):
    with pytest.raises(FitError, match="nothing to compare"):
        ident.compare()
    fit = noisy("five_bar").fit()
    fit.write(tmp_path)
    saved = ident.read_fit(tmp_path / "fit.json", fit.mechanism)
    with pytest.raises(FitError, match="has no motion"):
        ident.compare(saved)


# --- rows and pieces ---------------------------------------------------------------------------


def test_pieces_do_not_change_the_result(monkeypatch):
    """Rows in memory at once, and time blocks: bookkeeping only."""
    case = noisy("five_bar", "viscous", "coulomb", seconds=16.0)
    one = case.fit(cutoff="auto")
    monkeypatch.setattr("ident.equations.filter.CHUNK", 100)
    monkeypatch.setattr("ident.equations.problem.LENGTH", 50)
    other = case.fit(cutoff="auto")
    assert len(other.information) < len(one.information)
    np.testing.assert_allclose(
        other.estimate.solution.beta, one.estimate.solution.beta, rtol=1e-7, atol=1e-10
    )
    for joint, error in one.train.items():
        assert other.train[joint].rms == pytest.approx(error.rms, rel=1e-9)


def test_progress_is_told():
    case = noisy("five_bar")
    told = []
    motion = ident.complete(case.mechanism, case.log)
    ident.identify(case.mechanism, motion, progress=lambda what, share: told.append(share))
    assert told
    assert all(0.0 <= share <= 1.0 for share in told)


def test_a_log_too_short_for_the_filter_is_refused():
    case = noisy("five_bar", seconds=0.5)
    motion = ident.complete(case.mechanism, case.log, cutoff=3.0)
    with pytest.raises(
        FitError, match=r"no stretch is long enough .* more than ([\d.]+) s"
    ) as caught:
        ident.identify(case.mechanism, motion)
    least = float(str(caught.value).partition("more than ")[2].split()[0])
    longer = noisy("five_bar", seconds=1.5 * least)
    motion = ident.complete(longer.mechanism, longer.log, cutoff=3.0)
    assert ident.identify(longer.mechanism, motion).estimate.triangle.rows


def test_a_short_log_is_said_with_the_length_that_would_do():
    case = noisy("arm", "viscous", seconds=0.8)
    motion = ident.complete(case.mechanism, case.log, cutoff=8.0)
    fit = ident.identify(case.mechanism, motion)
    (found,) = (x for x in fit.findings if x.code in ("short log", "few equations"))
    assert "equations for" in found.meaning
    wanted = float(found.remedy.partition("about ")[2].split()[0])
    longer = noisy("arm", "viscous", seconds=wanted)
    motion = ident.complete(longer.mechanism, longer.log, cutoff=8.0)
    fit = ident.identify(longer.mechanism, motion)
    assert not any(x.code in ("short log", "few equations") for x in fit.findings)


def test_blocks_cover_every_row_once():
    case = noisy("arm", "coulomb")
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    fit = ident.identify(case.mechanism, motion)
    blocks = information_of(case.mechanism, fit.columns, motion)
    for u in range(4):
        mine = [block for block in blocks if block.coordinate == u]
        assert sum(block.rows for block in mine) == len(case.log.t)
        (e,) = motion.experiments
        measured = e.tau[:, fit.mechanism.driven.index(motion.independent[u])]
        assert sum(sum(block.torque) for block in mine) == pytest.approx(measured @ measured)
    assert fit.rows == len(case.log.t)


# --- errors that every period repeats ----------------------------------------------------------


def test_steps_of_an_encoder_that_a_repeated_motion_repeats_are_one_witness():
    """Of five equal periods the fit is no better than of one, and says so."""
    mechanism = robot("five_bar").with_effect("viscous")
    case = plant(mechanism, motion_log("five_bar", 100.0, 20.0), noise=NOISE, seed=4)
    step = 2 * np.pi / 2**10

    def logged(zero):
        columns = {k: x for k, x in case.log.columns.items() if k[:2] in ("q.", "ta")}
        for name in (name for name in columns if name[0] == "q"):
            columns[name] = step * (np.round(columns[name] / step + zero) - zero)
        return ident.identify(
            mechanism, ident.complete(mechanism, Log.from_arrays("q.csv", case.log.t, columns))
        )

    again = logged(0.3)
    every = logged(np.repeat(np.random.default_rng(0).uniform(size=5), len(case.log.t) / 5))
    said = [each for each in again.all_findings if each.code == "repeated errors"]
    assert said
    assert "every 4 s" in str(said[0])
    assert not [each for each in every.all_findings if each.code == "repeated errors"]
    assert again["viscous.left.Fv"].stderr > 1.4 * every["viscous.left.Fv"].stderr
    clean = case.fit()  # noise of the torques is another one in every period
    assert not [each for each in clean.all_findings if each.code == "repeated errors"]


def test_errors_before_and_now_are_of_one_validation_log():
    mechanism = robot("arm").with_effect("viscous")
    case = plant(mechanism, motion_log("arm", 100.0, 6.0))
    other = plant(mechanism, motion_log("arm", 100.0, 6.0, period=3.0))
    shifted = Log.from_arrays("other.csv", other.log.t, dict(other.log.columns))
    motions = [ident.complete(mechanism, log, cutoff=None) for log in (case.log, shifted)]
    fit = ident.identify(mechanism, motions[0], validate=motions[1])
    a = assess_fit(fit)
    before = ident.identify(mechanism, motions[1])
    expected = residual_before(before).errors
    for bar in a.errors:
        assert bar.before.rms == pytest.approx(expected[bar.joint].rms)
        assert bar.after == fit.validation["other.csv"][bar.joint]
    assert a.subject == "arm, fitted to arm.csv, on other.csv"


def test_parameters_of_a_fit_far_above_its_noise_are_not_to_be_trusted():
    """A spring is missing, and no sensor is accused of it."""
    sprung = robot("arm").with_effect("viscous").with_effect("spring:shoulder")
    given = {"spring.shoulder.k": 8.0, "spring.shoulder.b": 0.0}
    noise = [Noise("tau", 0.001, relative=True), Noise("q", 1e-5)]
    case = plant(sprung, motion_log("arm", 100.0, 8.0), given, noise=noise)
    lacking = case.fit(cutoff="auto", mechanism=sprung.without("spring:shoulder"))
    assert lacking.untrusted
    first = lacking.all_findings[0]
    assert first.code == "poor fit"
    assert "not to be trusted" in first.meaning
    assert "calibration" not in {finding.code for finding in lacking.all_findings}
    assert assess_fit(lacking).untrusted
    assert "not to be trusted" in str(card(lacking).sure)
    right = case.fit(cutoff="auto")
    assert not right.untrusted
