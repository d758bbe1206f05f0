"""Intervals hold the truth where the data are wrong and said to be: late, clipped, repeated."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import ident
from ident import Log, Noise
from ident.fit.residual_maps import Periods
from identification import motion_log, plant, robot


def planted(name, seconds, rate=200.0, seed=0):
    mechanism = robot(name).with_effect("viscous").with_effect("coulomb")
    noise = [Noise("tau", 0.01, relative=True), Noise("q", 1e-5)]
    case = plant(mechanism, motion_log(name, rate, seconds), noise=noise, seed=seed)
    kept = {k: x for k, x in case.log.columns.items() if k[:2] in ("q.", "ta")}
    return case, Log.from_arrays("run.csv", case.log.t, kept)


def off(case, fit):
    return np.abs(fit.estimate.solution.beta - case.base(fit)) / np.sqrt(np.diag(fit.covariance))


def test_the_errors_hold_a_delay_that_is_named():
    case, log = planted("five_bar", 8.0, 250.0)
    columns = {k: x[:-3] if k[:3] == "tau" else x[3:] for k, x in log.columns.items()}
    late = Log.from_arrays("late.csv", log.t[3:], columns)
    fit = ident.identify(case.mechanism, ident.complete(case.mechanism, late))
    (delay,) = (each for each in fit.health.findings if each.code == "delay")
    assert "standard errors hold what it does" in delay.meaning
    assert (off(case, fit) < 1.96).mean() > 0.8
    alone = np.abs(fit.estimate.solution.beta - case.base(fit)) / np.sqrt(np.diag(fit.scatter))
    assert (alone < 1.96).mean() < 0.8
    clean = ident.identify(case.mechanism, ident.complete(case.mechanism, log))
    np.testing.assert_array_equal(clean.covariance, clean.scatter)


def test_portions_and_streams_leave_out_what_is_clipped(tmp_path):
    case, log = planted("arm", 24.0, 100.0)
    columns = dict(log.columns)
    for name in (name for name in columns if name.startswith("tau.")):
        limit = np.quantile(np.abs(columns[name]), 0.9)
        columns[name] = np.clip(columns[name], -limit, limit)
    path = tmp_path / "clipped.csv"
    Log.from_arrays("clipped.csv", log.t, columns).write(path)
    whole = ident.identify(case.mechanism, ident.complete(case.mechanism, path))
    parts = ident.gather(case.mechanism, path, samples=1024).fit
    assert (off(case, whole) < 1.96).mean() > 0.9
    assert (off(case, parts) < 1.96).mean() > 0.9
    online = ident.Online(case.mechanism, like=ident.complete(case.mechanism, path))
    online.update(ident.read_log(path))
    names = [each.name for each in whole.base_parameters]
    truth = dict(zip(names, case.base(whole), strict=True))
    same = [each for each in online.finish().base_parameters if each.name in truth]
    assert len(same) > 20
    assert np.mean([abs(x.value - truth[x.name]) / x.stderr < 2 for x in same]) > 0.85


def test_what_a_motion_repeats_is_one_witness_in_portions_and_streams(tmp_path):
    """Steps of an encoder, the same in each of five periods."""
    case, log = planted("five_bar", 20.0, 100.0)
    step = 2 * np.pi / 2**9
    columns = {k: step * np.round(x / step) if k[0] == "q" else x for k, x in log.columns.items()}
    path = tmp_path / "again.csv"
    Log.from_arrays("again.csv", log.t, columns).write(path)
    whole = ident.identify(case.mechanism, ident.complete(case.mechanism, path))
    parts = ident.gather(case.mechanism, path, samples=512).fit
    for fit in (whole, parts):
        assert "repeated errors" in {each.code for each in fit.all_findings}
        assert min(fit.repeated.period.values()) == pytest.approx(4.0, rel=0.01)
        assert np.diag(fit.covariance / fit.scatter).min() > 1.5
    stderr = []
    for repeated in (whole.repeated, None):
        like = ident.identify(case.mechanism, whole.motion)
        like.__dict__["repeated"] = repeated
        online = ident.Online(case.mechanism, like=like)
        online.update(ident.read_log(path))
        stderr.append([each.stderr for each in online.finish().base_parameters])
    assert np.min(np.divide(*stderr)) > 1.2


def test_the_design_effect_grows_with_the_periods():
    again = Periods({"run": 4.0}, {"a": 0.6, "b": 0.4}, 0.3)
    assert again.variance(2.0) == 1.0
    assert again.variance(20.0) == pytest.approx(3.0)
    assert replace(again, rho={"a": 1.0}).variance(20.0) == pytest.approx(5.0)


@pytest.mark.parametrize("smoothing", [0.06, 0.02])
def test_the_noise_floor_is_what_noise_leaves_in_the_filtered_rows(smoothing):
    """The model that made a log of positions and torques leaves its noise, filtered."""
    noise = [Noise("tau", 0.01, relative=True), Noise("q", 1e-3)]
    case = plant(robot("arm"), motion_log("arm", 200.0, 12.0), noise=noise, seed=2)
    columns = case.log.polars().to_dict(as_series=False)
    some = {name: x for name, x in columns.items() if name.startswith(("q.", "tau."))}
    log = Log.from_arrays("positions", columns["t"], some)
    motion = ident.complete(case.mechanism, log, smoothing=smoothing, cutoff=5.0)
    fit = ident.identify(case.mechanism, motion, estimator="least-squares")
    for joint, floor in fit.noise.items():
        assert floor == pytest.approx(fit.errors["train"][joint].rms, rel=0.2)


def test_the_errors_hold_dry_friction_that_builds_up_with_speed(tmp_path):
    """Fc sat(v/w) in place of Fc sign(v): rows at reversals move Fc and Fv."""
    smooth = ident.user_effect("smooth", lambda s: {"Fc": ca.fmin(1, ca.fmax(-1, s.v / 0.06))})
    machine = robot("arm").with_effect("viscous") + smooth(("elbow",))
    values = {"smooth.elbow.Fc": 1.0, **{f"viscous.{j}.Fv": 0.4 for j in machine.driven}}
    noise = [Noise("tau", 0.002, relative=True)]
    case = plant(machine, motion_log("arm", 200.0, 12.0), values, noise=noise, seed=4)
    model = robot("arm").with_effect("viscous").with_effect("coulomb:elbow")
    fit = ident.identify(model, ident.complete(model, case.log))
    found = {v.name: v for e in fit.effects for v in e.parameters}
    friction = found["coulomb.elbow.Fc"]
    (i,) = np.flatnonzero(fit.estimate.base.independent == fit.columns.index["coulomb.elbow.Fc"])
    alone = fit.scatter[i, i] ** 0.5
    assert friction.stderr > 1.5 * alone
    assert abs(friction.value - 1.0) < 2.5 * friction.stderr
    (finding,) = (each for each in fit.all_findings if each.code == "reversals")
    assert finding.where == ("elbow",)
    fit.write(tmp_path)  # nothing is unknown in it, so that nothing moves
    known = ident.load(tmp_path / "identified")
    again = ident.identify(known, ident.complete(known, case.log))
    assert "reversals" in {each.code for each in again.all_findings}
    assert again.covariance.shape == (0, 0)
    wide = ident.identify(model.with_effect("friction_width:elbow"), fit.motion)
    found = {v.name: v.value for e in wide.effects for v in e.parameters}
    assert found["coulomb.elbow.Fc"] == pytest.approx(1.0, rel=0.01)
    assert found["friction_width.elbow.Fw"] == pytest.approx(1.0, rel=0.1)
    assert found["friction_width.elbow.w"] == pytest.approx(0.06, rel=0.1)
