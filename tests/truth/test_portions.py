"""A log in portions gives the fit of the log in one piece, however it is cut."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import import_module

import numpy as np
import polars as pl
import pytest

import ident
from helpers import ROBOTS
from ident.errors import FitError, IdentError
from ident.information.blocks import summed
from ident.pool import Done
from ident.streams.portions import absorbed

ROWS = 5000
EXACT = 1e-9  # relative: rounding


def log_of(mechanism, values, rows=ROWS, rate=500.0, noise=0.02, seed=0):
    """Exact positions, speeds and accelerations; noisy torques of planted values."""
    rng = np.random.default_rng(seed)
    t, columns = np.arange(rows) / rate, {}
    for name in mechanism.driven:
        w = 2 * np.pi * rng.uniform(0.1, 0.7, 3)[:, None]
        phase = rng.uniform(0, 2 * np.pi, 3)[:, None]
        columns[f"q.{name}"] = 0.4 * np.sin(w * t + phase).sum(axis=0)
        columns[f"v.{name}"] = 0.4 * (w * np.cos(w * t + phase)).sum(axis=0)
        columns[f"a.{name}"] = -0.4 * (w**2 * np.sin(w * t + phase)).sum(axis=0)
    motion = ident.Log.from_arrays("motion", t, columns)
    known = {name: 0.4 for effect in mechanism.effects for name in effect.names}
    tau = [ident.Noise("tau", noise, True)]
    return ident.simulate(mechanism, motion, values={**known, **values}, noise=tau, seed=seed)[0]


@pytest.fixture(scope="module")
def arm():
    return (
        ident.load(ROBOTS / "arm")
        .with_calibration("exact")
        .with_effect("viscous")
        .with_effect("coulomb")
    )


@pytest.fixture(scope="module")
def run(arm, tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "run.parquet"
    log_of(arm, {}).write(path)
    return path


def batch(mechanism, path, **options):
    motion = ident.complete(mechanism, ident.read_log(path, mechanism.columns), **options)
    return ident.identify(mechanism, motion, estimator="least-squares")


def off(fit, other):
    """Base parameters' largest difference in standard errors, and of the errors, relative."""
    assert np.array_equal(fit.estimate.base.independent, other.estimate.base.independent)
    beta, stderr = fit.estimate.solution.beta, np.sqrt(np.diag(fit.covariance))
    moved = np.abs(other.estimate.solution.beta - beta) / stderr
    wider = np.abs(np.sqrt(np.diag(other.covariance)) / stderr - 1)
    errors = [
        abs(getattr(other, kind)[joint].rms / error.rms - 1)
        for kind in ("train", "held_out")
        for joint, error in getattr(fit, kind).items()
    ]
    return moved.max(), max(wider.max(), *errors)


@pytest.mark.parametrize("samples", [1024, 1800])
@pytest.mark.parametrize("cutoff", [None, 5.0])
def test_exact_channels_give_the_fit_of_the_log_whatever_the_cut(arm, run, samples, cutoff):
    whole = batch(arm, run, cutoff=cutoff)
    parts = ident.gather(arm, run, cutoff=cutoff, samples=samples)
    assert parts.worked == len(parts.plan.parts[0].borders) - 1 > 1
    assert max(off(whole, parts.fit)) < EXACT
    x, y = whole.estimate.solution.x, parts.fit.estimate.solution.x
    np.testing.assert_allclose(y, x, rtol=0, atol=EXACT * np.abs(x).max())
    assert parts.fit.rows == whole.rows


def test_a_text_file_gives_the_same(arm, run, tmp_path):
    ident.read_log(run).write(tmp_path / "run.csv")
    found = ident.gather(arm, tmp_path / "run.csv", cutoff=None, samples=1024)
    assert max(off(batch(arm, run, cutoff=None), found.fit)) < EXACT


def test_splines_and_filter_reach_no_farther_than_the_margins(arm, run, tmp_path):
    log, rng = ident.read_log(run), np.random.default_rng(1)
    columns = {
        name: x + 2e-5 * rng.normal(size=ROWS) if name[0] == "q" else x
        for name, x in log.columns.items()
        if name[0] in "qt"
    }
    ident.Log.from_arrays("noisy", log.t, columns).write(tmp_path / "noisy.parquet")
    options = {"cutoff": 5.0, "smoothing": 0.02}
    whole = batch(arm, tmp_path / "noisy.parquet", **options)
    found = ident.gather(arm, tmp_path / "noisy.parquet", samples=1500, **options)
    assert found.worked > 1
    moved, others = off(whole, found.fit)
    assert moved < 1e-6  # standard errors
    assert others < 1e-6


@pytest.mark.parametrize("name", ["five_bar", "four_bar"])
def test_closed_loops_give_the_same_and_all_their_multipliers(name, tmp_path):
    mechanism, log = ident.load(ROBOTS / name), ROBOTS / name / "run.csv"
    if name == "four_bar":
        mechanism = mechanism.with_effect("coulomb")
    if name == "five_bar":  # nothing that a repeated motion repeats, which portions do not look for
        mechanism = mechanism.with_effect("viscous").with_effect("coulomb")
    whole, found = batch(mechanism, log), ident.gather(mechanism, log, samples=1024)
    assert found.worked == 2
    moved, others = off(whole, found.fit)
    assert moved < 1e-6
    assert others < 1e-6
    one, other = (pl.read_csv(x.write(tmp_path / str(i))[1]) for i, x in enumerate((whole, found)))
    assert one.columns == other.columns
    assert one.null_count().equals(other.null_count())
    for column in one.columns:
        if one[column].null_count() < len(one):
            np.testing.assert_allclose(other[column], one[column], rtol=0, atol=1e-6)


def test_a_portion_begins_where_the_one_before_ended_and_not_straight_from_the_start(tmp_path):
    mechanism = ident.load(ROBOTS / "four_bar").with_effect("coulomb")
    t = np.arange(6000) / 250
    q = 1.3 + 7 * t + 0.8 * np.sin(1.7 * t)  # 27 turns
    v, a = 7 + 0.8 * 1.7 * np.cos(1.7 * t), -0.8 * 1.7**2 * np.sin(1.7 * t)
    motion = ident.Log.from_arrays("turns", t, {"q.crank": q, "v.crank": v, "a.crank": a})
    planted = {name: 0.05 for effect in mechanism.effects for name in effect.names}
    noise = [ident.Noise("tau", 0.01, True)]
    log, _ = ident.simulate(mechanism, motion, values=planted, noise=noise)
    log.write(tmp_path / "t.parquet")
    found = ident.gather(mechanism, tmp_path / "t.parquet", cutoff=None, samples=1500)
    anchors = found.plan.parts[0].anchors
    assert len(anchors) == found.worked > 1
    closed = mechanism.kinematics.closure_rows(anchors).value
    assert np.abs(closed).max() < 1e-9
    assert anchors[-1][0] > 100  # rad: turns are counted on
    assert max(off(batch(mechanism, tmp_path / "t.parquet", cutoff=None), found.fit)) < EXACT


def test_a_stretch_in_which_a_column_is_empty_is_left_out(arm, run, tmp_path):
    log = ident.read_log(run)
    columns = {name: x.copy() for name, x in log.columns.items()}
    columns["tau.elbow"][1000:3400] = np.nan
    ident.Log.from_arrays("dropout", log.t, columns).write(tmp_path / "dropout.parquet")
    found = ident.gather(arm, tmp_path / "dropout.parquet", cutoff=None, samples=1024)
    assert any("rows 1984 to 3135: tau.elbow is empty" in note for note in found.notes)
    whole = batch(arm, tmp_path / "dropout.parquet", cutoff=None)
    assert abs(found.fit.rows - whole.rows) <= 10
    assert max(off(whole, found.fit)) < EXACT


def test_more_joints_than_needed_are_fused_as_in_one_piece(tmp_path):
    mechanism = ident.load(ROBOTS / "slider_crank").with_calibration("exact")
    base = ident.read_log(ROBOTS / "slider_crank" / "run.csv")
    t, rng = np.arange(4000) / 1000, np.random.default_rng(0)
    columns = {name: np.tile(x[:2000], 2) for name, x in base.columns.items() if name[0] in "qva"}
    motion = ident.Log.from_arrays("motion", t, columns)
    log, _ = ident.simulate(mechanism, motion, joints=["theta", "s"])
    columns = {n: x + 1e-5 * rng.normal(size=4000) for n, x in log.columns.items() if n[0] in "qt"}
    ident.Log.from_arrays("both", t, columns).write(tmp_path / "both.parquet")
    options = {"cutoff": 40.0, "smoothing": 0.005}
    whole = batch(mechanism, tmp_path / "both.parquet", **options)
    found = ident.gather(mechanism, tmp_path / "both.parquet", samples=2000, **options)
    assert found.worked == 2
    assert off(whole, found.fit)[0] < 0.01


def test_gaps_and_jitter_cost_a_fraction_of_a_standard_error(arm, run, tmp_path):
    log, rng = ident.read_log(run), np.random.default_rng(2)
    kept = np.ones(ROWS, dtype=bool)
    kept[1500:1560] = kept[3100:3103] = False
    t = log.t[kept] + rng.uniform(-1e-4, 1e-4, kept.sum())
    columns = {n: np.interp(t, log.t, x) for n, x in log.columns.items() if n[0] in "qt"}
    columns["tau.elbow"][4000:4080] = np.nan
    ident.Log.from_arrays("gaps", t, columns).write(tmp_path / "gaps.parquet")
    options = {"cutoff": 5.0, "smoothing": 0.04}
    whole = batch(arm, tmp_path / "gaps.parquet", **options)
    found = ident.gather(arm, tmp_path / "gaps.parquet", samples=1500, **options)
    assert found.worked > 1
    assert abs(found.fit.rows - whole.rows) <= 5
    assert off(whole, found.fit)[0] < 0.3


def test_shapes_and_memory_settle_where_those_of_one_piece_do(arm, tmp_path):
    mechanism = arm.with_effect("stribeck:elbow").with_effect("hysteresis:wrist")
    planted = {
        "stribeck.elbow.vs": 0.2,
        "hysteresis.wrist.sigma": 20.0,
        "hysteresis.wrist.z0": 0.02,
    }
    log_of(mechanism, planted, rows=4000, rate=200.0).write(tmp_path / "run.parquet")
    whole = batch(mechanism, tmp_path / "run.parquet", cutoff=None)
    found = ident.gather(mechanism, tmp_path / "run.parquet", cutoff=None, samples=2000)
    assert off(whole, found.fit)[0] < 0.01
    for name in ("stribeck.elbow.vs", "hysteresis.wrist.z0"):
        value = found.fit[name]
        assert abs(value.value - planted[name]) < 4 * value.stderr
    assert any("one Gauss-Newton step over all samples" in note for note in found.notes)


def test_the_order_in_which_portions_end_changes_no_bit(arm, run, monkeypatch):
    pool = import_module("ident.pool")
    plan = ident.gather(arm, run, cutoff=None, samples=1024).plan
    done = [absorbed(plan, portion) for portion in plan.portions()]
    rng, first = np.random.default_rng(0), None
    for _ in range(3):
        ended = [Done(int(i), done[i]) for i in rng.permutation(len(done))]
        monkeypatch.setattr(pool, "spread", lambda *_, ended=ended, **__: (x for x in ended))
        over = pool.Workers().run(absorbed, done, plan, ["log"] * len(done), "rows")
        cells = list(summed({}, (block for _, (blocks, *_) in over for block in blocks)).values())
        first = first or cells
        for one, other in zip(first, cells, strict=True):
            assert np.array_equal(one.triangle.R, other.triangle.R)
            assert (one.torque, one.span) == (other.torque, other.span)
            assert one.triangle.rho == other.triangle.rho


def test_the_fit_is_one_like_any_other_and_counts_all_samples(arm, run, tmp_path, monkeypatch):
    logs = import_module("ident.streams.logs")  # as if the log were far too long for pictures
    monkeypatch.setattr(logs, "SAMPLES", 1500)
    monkeypatch.setattr(logs.LogOnDisk.stretches, "__defaults__", (1500,))
    found = ident.gather(arm, run, cutoff=None, samples=1024)
    fit = found.fit
    assert [len(e) for e in fit.motion.experiments] == [500, 500, 500]
    assert max(off(batch(arm, run, cutoff=None), fit)) < EXACT
    assert fit.rows == ROWS
    paths = found.write(tmp_path / "out")
    assert {path.name for path in paths} >= {"fit.json", "report.html", "identified.urdf"}
    told = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert (told["samples"], told["logs"], told["rows"]) == (ROWS, ["run.parquet"], ROWS)
    assert any("pictures" in note and "1500 of them" in note for note in told["warnings"])
    saved = ident.read_fit(tmp_path / "out", arm)
    assert saved.point.unknowns(fit.columns) == pytest.approx(fit.estimate.solution.x)
    assert f"{ROWS} rows of {ROWS} samples" in str(found)
    assert found.plan.parts[0].file.sha256[:12] in (tmp_path / "out" / "report.html").read_text()


def test_another_log_is_judged_without_being_fitted(arm, run, tmp_path):
    other = tmp_path / "other.parquet"
    log_of(arm, {}, seed=1).write(other)
    motion = ident.complete(arm, ident.read_log(other), cutoff=None)
    whole = ident.identify(arm, ident.complete(arm, ident.read_log(run), cutoff=None),
                           estimator="least-squares", validate=motion)  # fmt: skip
    found = ident.gather(arm, run, cutoff=None, samples=1024, validate=[other]).fit
    assert found.validation.keys() == {"other.parquet"}
    for joint, error in whole.validation["other.parquet"].items():
        assert found.validation["other.parquet"][joint].rms == pytest.approx(error.rms, rel=1e-9)


def test_limits_hold_in_portions_too(arm, run):
    motion = ident.complete(arm, ident.read_log(run), cutoff=None)
    whole = ident.identify(arm, motion, estimator="least-squares", consistent=True)
    found = ident.gather(arm, run, cutoff=None, samples=1024, consistent=True).fit
    x = whole.estimate.solution.x
    np.testing.assert_allclose(found.estimate.solution.x, x, atol=1e-5 * np.abs(x).max())


def test_what_counts_from_the_first_sample_is_refused(arm, run):
    with pytest.raises(FitError, match=r"drift:elbow.*first sample"):
        ident.gather(arm.with_effect("drift:elbow"), run)


def test_a_broken_stretch_far_inside_is_found_and_named_by_its_line(arm, run, tmp_path):
    path = tmp_path / "run.csv"
    ident.read_log(run).write(path)
    lines = path.read_text().splitlines()
    lines[4321] = lines[4321].replace(",", ",x", 1)
    path.write_text("\n".join(lines))
    with pytest.raises(IdentError, match=r"run\.csv.*line 4322") as caught:
        ident.gather(arm, path, cutoff=None, samples=1024)
    assert "\n" not in str(caught.value)


def test_stamps_repeated_across_a_cut_are_one(arm, run, tmp_path, monkeypatch):
    survey = import_module("ident.streams.logs")
    monkeypatch.setattr(survey, "LOOK", 1024)
    twice = pl.read_parquet(run)
    twice = pl.concat([twice[:1024], twice[1023:]])
    twice.write_parquet(tmp_path / "twice.parquet")
    found = ident.gather(arm, tmp_path / "twice.parquet", cutoff=None, samples=1024)
    assert found.plan.parts[0].clock.even
    assert max(off(batch(arm, run, cutoff=None), found.fit)) < EXACT


def test_a_clock_that_is_set_back_between_two_pieces_is_refused(arm, run, tmp_path, monkeypatch):
    survey = import_module("ident.streams.logs")
    monkeypatch.setattr(survey, "LOOK", 1024)
    log = pl.read_parquet(run)
    pl.concat([log[:1024], log[500:]]).write_parquet(tmp_path / "back.parquet")
    with pytest.raises(IdentError, match="goes backward at row 1024"):
        ident.gather(arm, tmp_path / "back.parquet")


def test_a_wrench_that_is_not_logged_for_a_while_is_not_taken_for_none(arm, run, tmp_path):
    log = ident.read_log(run)
    columns = {name: x.copy() for name, x in log.columns.items()}
    columns["wrench.forearm.fz"] = np.sin(log.t)
    columns["wrench.forearm.fz"][1000:3400] = np.nan
    ident.Log.from_arrays("wrench", log.t, columns).write(tmp_path / "wrench.parquet")
    found = ident.gather(arm, tmp_path / "wrench.parquet", cutoff=None, samples=1024)
    assert max(off(batch(arm, tmp_path / "wrench.parquet", cutoff=None), found.fit)) < EXACT


@pytest.mark.parametrize("log", ["A0_swingup_11.csv", "A0_swingup_12.csv"])
def test_a_real_log_with_jittering_stamps_gives_the_same(shared_data, tmp_path, log):
    data = shared_data / "dfki_double_pendulum"
    (tmp_path / "pendulum.urdf").write_bytes((data / "double_pendulum_A0.urdf").read_bytes())
    columns = {"q": "pos", "v": "vel", "tau": "tau"}
    named = [
        f'"{ours}.Joint{i}" = {{ column = "{theirs}_meas{i}" }}'
        for ours, theirs in columns.items()
        for i in (1, 2)
    ]
    (tmp_path / "mechanism.toml").write_text(
        'urdf = "pendulum.urdf"\n[log]\nt = { column = "time" }\n' + "\n".join(named)
    )
    mechanism = ident.load(tmp_path).with_effect("viscous").with_effect("coulomb")
    whole, found = batch(mechanism, data / log), ident.gather(mechanism, data / log, samples=1024)
    assert found.worked > 3
    moved, others = off(whole, found.fit)
    assert moved < 1e-6
    assert others < 1e-6


def test_multipliers_are_free_in_portions():
    crank = ident.load(ROBOTS / "slider_crank")
    hats = replace(crank, multipliers=ident.Multipliers("linear", 0.005))
    log = ROBOTS / "slider_crank" / "run.csv"
    found, free = (ident.gather(each, log, samples=700) for each in (hats, crank))
    assert any("multipliers are free" in note for note in found.notes)
    np.testing.assert_allclose(found.fit.estimate.x, free.fit.estimate.x, rtol=EXACT)


def test_a_consistent_fit_of_what_is_not_linear_is_refused():
    crank = ident.load(ROBOTS / "slider_crank")
    crank = crank.with_effect("coulomb:theta").with_effect("stribeck:theta")
    with pytest.raises(ident.FitError, match="'stribeck:theta' is not linear"):
        ident.gather(crank, ROBOTS / "slider_crank" / "run.csv", consistent=True)


def test_an_absurd_sample_is_named_with_its_row_and_turns_no_parameter(tmp_path):
    mechanism = ident.load(ROBOTS / "five_bar").with_effect("viscous")
    log = log_of(mechanism, {})
    columns = {name: x.copy() for name, x in log.columns.items()}
    columns["q.left"][2500], columns["tau.right"][700] = 100.0, 1e20
    log.write(tmp_path / "good.parquet")
    ident.Log.from_arrays("odd", log.t, columns).write(tmp_path / "odd.parquet")
    good, odd = (
        ident.gather(mechanism, tmp_path / f"{name}.parquet", samples=1024)
        for name in ("good", "odd")
    )
    assert any("q.left = 100 in row 2501 " in note for note in odd.notes)
    assert any("tau.right = 1e+20 in row 701 " in note for note in odd.notes)
    for value in good.fit.base_parameters:
        assert abs(odd.fit[value.name].value - value.value) < 0.1 * value.stderr
