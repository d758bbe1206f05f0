"""Errors of a calibration: intervals hold them, the budget names them, `exact` leaves them out."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident import Log, MechanismError, Noise
from ident.mechanism.calibration import KINDS, Calibration
from ident.mechanism.causes import causes_of
from identification import motion_log, plant, robot
from miscalibrated import misread


@pytest.fixture(scope="module")
def arm():
    known = replace(robot("arm"), calibration=Calibration())
    return known.with_effect("viscous").with_effect("coulomb")


@pytest.fixture(scope="module")
def clean(arm):
    return plant(arm, motion_log("arm", 200.0, 8.0), noise=[Noise("tau", 0.01, relative=True)])


@pytest.fixture(scope="module")
def fit(clean):
    return clean.fit(cutoff="auto")


def test_intervals_hold_errors_drawn_from_their_priors(arm):
    motion = motion_log("arm", 200.0, 8.0)
    cases = [misread(arm, motion, seed) for seed in range(8)]
    z = np.concatenate([case.off(case.fit()) for case in cases])
    assert 0.88 < (np.abs(z) < 1.96).mean() < 0.995
    exact = [replace(case, mechanism=arm.with_calibration("exact")) for case in cases]
    blind = np.concatenate([case.off(case.fit()) for case in exact])
    assert (np.abs(blind) < 1.96).mean() < 0.7


def test_the_calibrated_estimate_is_nearer_to_the_truth(arm):
    motion, ratios = motion_log("arm", 200.0, 8.0), []
    for seed in range(3):
        case = misread(arm, motion, 100 + seed)
        fit = case.fit()
        errors = []
        for values in (fit.calibrated, fit.estimate):
            x = np.array([case.values.get(name, 0.0) for name in fit.columns.names])
            errors.append(np.abs(values.base.combined(values.x - x)))
        ratios.append(np.log(errors[0] / errors[1]).mean())
    assert np.mean(ratios) < np.log(0.6)


def test_exact_is_least_squares_with_the_errors_of_noise(clean, fit, arm):
    exact = clean.fit(cutoff="auto", mechanism=arm.with_calibration("exact"))
    assert exact.budget is None
    np.testing.assert_array_equal(exact.covariance, fit.noise_covariance)
    np.testing.assert_array_equal(exact.estimate.x, fit.estimate.x)
    for value, both in zip(exact.base_parameters, fit.base_parameters, strict=True):
        assert value.value == value.as_logged == both.as_logged
        assert value.stderr == value.stderr_noise == both.stderr_as_logged


def test_a_budget_adds_up(fit):
    for value in fit.base_parameters:
        shares = fit.shares(value.name)
        assert sum(shares.values()) == pytest.approx(1.0)
        assert list(shares.values()) == sorted(shares.values(), reverse=True)
        assert shares["noise"] == pytest.approx((value.stderr_noise / value.stderr) ** 2)


def test_one_cause_left_is_the_one_in_the_budget(clean, arm):
    """Of a machine on which all is exact but the gain of one torque."""
    only = arm.with_calibration("all=exact,tau.wrist=10%")
    fit = clean.fit(cutoff="auto", mechanism=only)
    assert [cause.name for cause in fit.budget.causes] == ["gain of tau.wrist"]
    assert fit.budget.causes[0].scale == pytest.approx(0.1)
    near, far = fit.shares("coulomb.wrist.Fc"), fit.shares("viscous.yaw.Fv")
    assert near["gain of tau.wrist"] > 10 * far["gain of tau.wrist"]
    assert far["noise"] > 0.95


def test_what_is_known_exactly_is_no_cause(arm):
    known = arm.with_calibration("tau=exact,lateness=exact")
    kinds = {cause.kind for cause in causes_of(known, ("yaw", "elbow"), 100.0)}
    assert kinds == {"clock", "q", "length"}
    names = [cause.name for cause in causes_of(known, ("yaw", "elbow"), 100.0)]
    assert "zero of q.elbow" in names
    assert "zero of q.wrist" not in names
    grown = arm.with_effect("encoder_offset:elbow")
    names = [cause.name for cause in causes_of(grown, ("yaw", "elbow"), 100.0)]
    assert "zero of q.elbow" not in names  # the model has it


def test_an_error_far_outside_its_prior_is_named(arm):
    def size(cause, random):
        return 8.0 if cause.name == "gain of tau.elbow" else 0.0

    fit = misread(arm, motion_log("arm", 200.0, 8.0), 3, size=size).fit()
    codes = [finding.code for finding in fit.all_findings]
    values = dict(zip((c.name for c in fit.budget.causes), fit.budget.values, strict=True))
    assert max(values, key=lambda name: abs(values[name])) == "gain of tau.elbow"
    assert codes.count("calibration") <= 1


@pytest.mark.parametrize(
    ("text", "key", "number", "unit"),
    [
        ("tau=0.5%", "tau", 0.005, "1"),
        ("q=0.1deg", "q", np.pi / 1800, "rad"),
        ("q.elbow=2 mrad", "q.elbow", 0.002, "rad"),
        ("clock=50 ppm", "clock", 5e-5, "1"),
        ("lateness=2ms", "lateness", 0.002, "s"),
        ("lateness.tau.elbow=0.5 samples", "lateness.tau.elbow", 0.5, "sample"),
        ("length=0.2 mm", "length", 2e-4, "m"),
    ],
)
def test_amounts_have_units(text, key, number, unit):
    amount = Calibration.of(text).stated[key]
    assert amount.number == pytest.approx(number)
    assert amount.unit == unit


@pytest.mark.parametrize(
    "text", ["tau=3", "tau=3 deg", "torque=3%", "tau.elbw=3%", "tau", "all=3%", "q=-1deg", "tau=x"]
)
def test_what_is_no_amount_is_refused_with_a_valid_one(arm, text):
    with pytest.raises(MechanismError, match="--calibrated"):
        arm.with_calibration(text)


def test_all_exact_and_what_comes_later_counts(arm):
    assert arm.with_calibration("exact").calibration.exact
    assert arm.with_calibration("all=exact").calibration.exact
    one = arm.with_calibration("exact").with_calibration("tau=1%").calibration
    assert not one.exact
    assert {name for name, x in one.stated.items() if x.number == 0} == {*KINDS} - {"tau"}


def test_mechanism_toml_states_it(tmp_path):
    (tmp_path / "arm.urdf").write_bytes((ROBOTS / "arm" / "arm.urdf").read_bytes())
    toml = 'urdf = "arm.urdf"\n[calibration]\nclock = "exact"\ntau = { elbow = "0.5 %" }\n'
    (tmp_path / "mechanism.toml").write_text(toml)
    mechanism = ident.load(tmp_path)
    by_name = {cause.name: cause for cause in causes_of(mechanism, mechanism.driven, 100.0)}
    assert "the clock" not in by_name
    assert by_name["gain of tau.elbow"].scale == pytest.approx(0.005)
    assert by_name["gain of tau.wrist"].scale == pytest.approx(0.03)
    (tmp_path / "mechanism.toml").write_text(toml.replace("0.5 %", "0.5"))
    with pytest.raises(MechanismError, match="elbow"):
        ident.load(tmp_path)


def test_fit_json_has_both_errors_and_the_budget(fit, tmp_path, arm):
    fit.write(tmp_path)
    data = json.loads((tmp_path / "fit.json").read_text())
    entry = next(e for e in data["base_parameters"] if e["stderr"])
    assert entry["stderr"] > entry["stderr_noise"] > 0
    assert sum(entry["budget"].values()) == pytest.approx(1.0, abs=0.05)
    assert {cause["kind"] for cause in data["calibration"]} == {*KINDS}
    saved = ident.read_fit(tmp_path, arm)
    np.testing.assert_allclose(saved.dynamic_parameters, fit.dynamic_parameters, rtol=1e-6)


def test_a_consistent_fit_keeps_its_values_and_widens_its_errors(clean, arm):
    motion = ident.complete(arm, clean.log)
    fit = ident.identify(arm, motion, consistent=True)
    assert fit.calibrated is fit.estimate
    more = np.diag(fit.covariance) / np.diag(fit.noise_covariance)
    assert (more >= 1).all()
    assert np.median(more) > 4


@pytest.mark.parametrize("fault", ["a delay common to all", "heavy clipping"])
def test_intervals_hold_what_is_named(arm, clean, fault):
    """Base parameters of a log with a fault that its fit names are within three standard errors."""
    columns, t = dict(clean.log.columns), clean.log.t
    for name in [name for name in columns if name.startswith("tau.")]:
        x = columns[name]
        limit = 0.7 * np.abs(x).max()
        late = np.interp(t - 0.02, t, x)
        columns[name] = late if fault == "a delay common to all" else np.clip(x, -limit, limit)
    wrong = replace(clean, log=Log.from_arrays("run.csv", t, columns))
    fit = wrong.fit(cutoff="auto")
    found = np.array([value.value for value in fit.base_parameters])
    errors = np.array([value.stderr for value in fit.base_parameters])
    z = np.abs(found - wrong.base(fit)) / errors
    assert fit.health.findings
    assert (z < 3).all(), dict(zip((v.name for v in fit.base_parameters), z, strict=True))
