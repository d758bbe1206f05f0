"""Rows that are made as samples come are those that a batch makes of the whole log."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from streaming import FIELDS, HOW, blocks, given, samples, together

import ident
from helpers import ROBOTS
from ident import FitError, Log, LogError, MotionError, Noise
from ident.equations.rows import Scene, rows
from ident.equations.unknowns import Columns, Point
from ident.log import Column
from ident.motion.signals import measure
from ident.streams.samples import SampleParser
from ident.streams.stream import Stream
from identification import motion_log, plant, robot


def batch(mechanism, motion, columns, point=None, number=0):
    scene = Scene.of(mechanism, columns, motion.experiments[number], point, motion.band.cutoff)
    return together(list(rows(scene, motion.band.cutoff)))


def streamed(mechanism, motion, columns, how="one by one", point=None, log=None, **options):
    stream = Stream(mechanism, columns, motion, point, **options)
    made = [rows for each in given(log or motion.logs[0], how) for rows in stream.push(each)]
    return stream, together([*made, *stream.flush()])


def assert_same(found, expected, tolerance=1e-11):
    for name in FIELDS:
        a, b = np.asarray(getattr(found, name), float), np.asarray(getattr(expected, name), float)
        assert a.shape == b.shape, name
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * max(1.0, np.abs(b).max()))


def made(name, effects=(), rate=200.0, seconds=1.5, noise=0.0):
    mechanism = robot(name)
    for effect in effects:
        mechanism = mechanism.with_effect(effect)
    said = [Noise("tau", noise, relative=True)] if noise else []
    return plant(mechanism, motion_log(name, rate, seconds), noise=said)


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("cutoff", [None, 12.0])
@pytest.mark.parametrize("name", ["arm", "four_bar", "five_bar", "slider_crank", "pendulum"])
def test_rows_of_a_batch(name, cutoff, how):
    case = made(name, ["viscous", "coulomb"])
    motion = ident.complete(case.mechanism, case.log, cutoff=cutoff)
    columns = Columns.of(case.mechanism)
    stream, found = streamed(case.mechanism, motion, columns, how)
    assert_same(found, batch(case.mechanism, motion, columns))
    assert stream.lost == (0, "")
    assert stream.samples == len(case.log.t)


def test_a_sample_is_read_under_the_robots_names_and_under_idents():
    mapping = {"q.a": Column("encoder", 2.0, 0.5), "q.b": Column("q.a")}
    parser = SampleParser("arm", mapping, ("q.a", "q.b"))
    for t, sample in enumerate([
        {"encoder": 1.0, "q.a": 3.0}, {"encoder": 1.0, "q.b": 3.0}, {"q.a": 3.0, "encoder": 1.0}
    ]):  # fmt: skip
        assert parser({"t": t, **sample}).tolist() == [[t, 2.5, 3.0]]
    with pytest.raises(MotionError, match="no column 'encoder'"):  # "q.a" is the robot's, of q.b
        parser({"t": 3.0, "q.a": 3.0, "q.b": 3.0})


def test_friction_in_a_closures_own_joint_and_measured_wrenches():
    case = made("four_bar", ["coulomb:closure.pin", "viscous:closure.pin"])
    t = case.log.t
    columns = dict(case.log.columns) | {"wrench.rocker_link.fx": np.sin(9 * t)}
    log = Log.from_arrays("pushed.csv", t, columns)
    motion = ident.complete(case.mechanism, log, cutoff=None)
    assert motion.experiments[0].wrench is not None
    unknown = Columns.of(case.mechanism)
    _, found = streamed(case.mechanism, motion, unknown)
    assert_same(found, batch(case.mechanism, motion, unknown))


@pytest.mark.parametrize("latency", [0.0, 0.005, 1.0])
def test_latency_changes_when_and_not_what(latency):
    case = made("five_bar")
    motion = ident.complete(case.mechanism, case.log, cutoff=20.0)
    columns = Columns.of(case.mechanism)
    stream = Stream(case.mechanism, columns, motion, latency=latency)
    parts, most = [], 0.0
    for sample in samples(case.log):
        for rows_ in stream.push(sample):
            most = max(most, sample["t"] - rows_.t[-1])
            parts.append(rows_)
    assert_same(together([*parts, *stream.flush()]), batch(case.mechanism, motion, columns))
    assert most <= stream.lag + 1e-9


def test_the_lag_is_reached_and_no_more():
    """Every sample at once, every row kept: half the filter, to the sample."""
    case = made("arm")
    motion = ident.complete(case.mechanism, case.log, cutoff=90.0)
    columns = Columns.of(case.mechanism)
    stream = Stream(case.mechanism, columns, motion, latency=0.0)
    lags = [s["t"] - r.t[-1] for s in samples(case.log) for r in stream.push(s)]
    np.testing.assert_allclose(lags, stream.lag, atol=1e-9)
    assert stream.lag > 0


def without(log, left_out):
    kept = np.ones(len(log.t), dtype=bool)
    kept[left_out] = False
    return Log.from_arrays("lost.csv", log.t[kept], {k: x[kept] for k, x in log.columns.items()})


def test_nothing_is_filtered_across_a_gap():
    """What comes before and after it are two logs."""
    case = made("arm", seconds=3.0)
    whole = ident.complete(case.mechanism, case.log, cutoff=12.0)
    log = without(case.log, slice(250, 280))
    parts = [without(case.log, slice(250, None)), without(case.log, slice(0, 280))]
    two = ident.complete(case.mechanism, parts, cutoff=12.0)
    columns = Columns.of(case.mechanism)
    _, found = streamed(case.mechanism, whole, columns, log=log)
    before, after = (batch(case.mechanism, two, columns, number=i) for i in range(2))
    expected = together([before, replace(after, sample=after.sample + 280)])
    assert_same(replace(found, informed=expected.informed), expected, 1e-9)


def test_a_sample_that_is_missing_is_interpolated():
    case = made("arm", seconds=3.0)
    log = without(case.log, [100, 101, 300])
    whole = ident.complete(case.mechanism, case.log, cutoff=12.0)
    columns = Columns.of(case.mechanism)
    _, found = streamed(case.mechanism, whole, columns, log=log)
    expected = batch(case.mechanism, whole, columns)
    assert found.A.shape == expected.A.shape
    np.testing.assert_allclose(found.t, expected.t, atol=1e-9)
    assert np.abs(found.A - expected.A).max() < 0.01 * np.abs(expected.A).max()


def test_jittering_stamps_are_put_on_a_uniform_clock():
    case = made("arm", seconds=3.0)
    rng = np.random.default_rng(3)
    t = case.log.t + 3e-4 * rng.uniform(-1, 1, len(case.log.t))
    moved = {k: np.interp(t, case.log.t, x) for k, x in case.log.columns.items()}
    log = Log.from_arrays("jitter.csv", t, moved)
    even = ident.complete(case.mechanism, case.log, cutoff=12.0)
    columns = Columns.of(case.mechanism)
    _, found = streamed(case.mechanism, even, columns, log=log)
    expected = batch(case.mechanism, even, columns)
    assert abs(len(found.t) - len(expected.t)) <= 1
    np.testing.assert_allclose(np.diff(found.t), 0.02, rtol=1e-3)
    for u in range(found.b.shape[1]):
        at = np.interp(found.t, expected.t, expected.b[:, u])
        assert np.abs(found.b[:, u] - at).max() < 0.01 * np.abs(at).max()


def test_derivatives_of_positions_alone():
    """Exact positions: the splines against the analytic rates, through the rows."""
    case = made("five_bar", rate=500.0)
    positions = {k: x for k, x in case.log.columns.items() if k[0] not in "va"}
    log = Log.from_arrays("q.csv", case.log.t, positions)
    exact = ident.complete(case.mechanism, case.log, cutoff=None)
    motion = ident.complete(case.mechanism, log, cutoff=None, smoothing=None)
    columns = Columns.of(case.mechanism)
    stream, found = streamed(case.mechanism, motion, columns)
    expected = batch(case.mechanism, exact, columns)
    np.testing.assert_array_equal(found.sample, expected.sample[: -stream._around])
    off = np.abs(found.A - expected.A[: len(found.A)]).max()
    assert off < 1e-6 * np.abs(expected.A).max()


def noisy(channels, seconds=6.0, jitter=0.0):
    """The arm's log with noise in some of its channels, and with stamps that jitter."""
    case = made("arm", rate=500.0, seconds=seconds)
    rng = np.random.default_rng(0)
    noise = {"q": 1e-4, "v": 1e-2, "a": 0.3, "t": 0.0}
    t = case.log.t + jitter * rng.uniform(-1, 1, len(case.log.t))
    columns = {
        k: np.interp(t, case.log.t, x) + noise[k[0]] * rng.normal(size=len(x))
        for k, x in case.log.columns.items()
        if k[0] in channels or k.startswith("tau")
    }
    return case.mechanism, Log.from_arrays("noisy.csv", t, columns)


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize(("channels", "jitter"), [("q", 0), ("qv", 0), ("qva", 0), ("q", 3e-4)])
def test_noisy_motion_is_smoothed_by_the_splines_of_a_batch(channels, jitter, how):
    mechanism, log = noisy(channels, jitter=jitter)
    motion = ident.complete(mechanism, log)
    motion = replace(motion, band=replace(motion.band, cutoff=None))
    unknown = Columns.of(mechanism)
    stream, found = streamed(mechanism, motion, unknown, how)
    expected = batch(mechanism, motion, unknown)
    at = np.searchsorted(expected.t, found.t - 1e-6)
    np.testing.assert_allclose(expected.t[at], found.t, atol=3e-6)
    assert len(found.t) >= len(expected.t) - stream._around
    lag = round(4 * motion.experiments[0].smooth.spacing * 500)  # where a batch's spline ends
    off = (found.A - expected.A[at])[:-lag]
    noise = 0.05 if jitter else 0.02  # of the noise that is left in the accelerations
    assert np.abs(off).max() < noise * np.abs(expected.A).max()
    assert np.sqrt(np.mean(off**2)) < 2e-3 * np.sqrt(np.mean(expected.A**2))


def test_before_a_gap_no_sample_is_lost():
    """What a batch uses at the ends of runs a stream uses too, once the run is over."""
    mechanism, log = noisy("q")
    motion = ident.complete(mechanism, log)
    motion = replace(motion, band=replace(motion.band, cutoff=None))
    stream = Stream(mechanism, Columns.of(mechanism), motion)
    cut = without(log, slice(1500, 1600))
    found = together([*stream.push(cut), *stream.flush(last=True)])
    ends = round(2 * motion.experiments[0].smooth.spacing * 500)
    for first, stop in ((0, 1500), (1600, len(log.t))):
        inside = (found.t >= log.t[first]) & (found.t <= log.t[stop - 1])
        assert abs(inside.sum() - (stop - first - 2 * ends)) <= 4


@pytest.mark.parametrize("how", HOW)
def test_one_wrong_time_is_left_out_and_not_all_after_it(how):
    case = made("arm", seconds=3.0)
    motion = ident.complete(case.mechanism, case.log, cutoff=12.0)
    t = case.log.t.copy()
    t[[200, 400]] = 1e9, -3.0
    log = SimpleNamespace(t=t, columns=case.log.columns)  # no Log: that would sort it
    parts = blocks(log, {"one by one": [1], "blocks": [7, 64], "whole": [600]}[how])
    columns = Columns.of(case.mechanism)
    stream = Stream(case.mechanism, columns, motion)
    made_, left_out, start = [], [], 0
    for part in parts:
        try:
            made_ += stream.push(part)
        except LogError as error:
            left_out.append((start, str(error)))
        else:
            left_out += [(start + row, why) for row, why in stream.left_out]
        start += len(part["t"])
    assert [row for row, _ in left_out] == [200, 400]
    assert "t = 1e+09 s comes before one at" in left_out[0][1]
    assert "t = -3 s comes after one at" in left_out[1][1]
    expected = batch(case.mechanism, motion, columns)
    found = together([*made_, *stream.flush()])
    np.testing.assert_allclose(found.t, expected.t, atol=1e-9)
    assert np.abs(found.A - expected.A).max() < 0.01 * np.abs(expected.A).max()


def test_effects_of_the_present_sample():
    """Implicit, correcting and held ones, at a point that is not the prior."""
    mechanism = robot("arm")
    for effect in ("viscous", "load_friction:elbow", "torque_gain:yaw", "encoder_offset:wrist"):
        mechanism = mechanism.with_effect(effect)
    mechanism = mechanism.with_effect("gravity_tilt").with_effect("stribeck:yaw", {"vs": 0.1})
    motion = ident.complete(mechanism, made("arm").log, cutoff=12.0)
    point = Point.prior(mechanism).with_values(
        {"encoder_offset.wrist.delta": 0.01, "gravity_tilt.x": 0.02, "gravity_tilt.y": 0.0,
         "viscous.yaw.Fv": 0.5, "torque_gain.yaw.g": 0.05}
    )  # fmt: skip
    columns = Columns.of(mechanism)
    _, found = streamed(mechanism, motion, columns, point=point)
    assert_same(found, batch(mechanism, motion, columns, point), 1e-9)


@pytest.mark.parametrize("effect", ["delay:elbow", "closure_compliance:tip"])
def test_effects_that_look_around_have_margins(effect):
    name = "five_bar" if "closure" in effect else "arm"
    mechanism = robot(name).with_effect(effect)
    motion = ident.complete(mechanism, made(name, seconds=3.0).log, cutoff=30.0)  # every row kept
    point = Point.prior(mechanism).with_values({n: 1e-3 for n in mechanism.effects[0].names})
    columns = Columns.of(mechanism)
    _, found = streamed(mechanism, motion, columns, point=point, latency=0.1)
    expected = batch(mechanism, motion, columns, point)
    common, mine, theirs = np.intersect1d(found.sample, expected.sample, return_indices=True)
    assert len(common) > 400
    away = slice(30, -30)  # of the log's ends, which a batch has no neighbours for
    for name in ("A", "b"):
        x, y = getattr(found, name)[mine][away], getattr(expected, name)[theirs][away]
        np.testing.assert_allclose(x, y, atol=1e-5 * np.abs(y).max())


@pytest.mark.parametrize(
    "effect", ["hysteresis:elbow", "drift:elbow", "backlash:elbow", "elasticity:elbow"]
)
def test_what_cannot_be_had_sample_by_sample_is_refused(effect):
    mechanism = robot("arm").with_effect(effect)
    motion = ident.complete(mechanism, made("arm").log, cutoff=None)
    with pytest.raises(FitError, match=rf"{effect}.*leave out"):
        Stream(mechanism, Columns.of(mechanism), motion)


def test_positions_where_the_loop_does_not_close_are_left_out():
    case = made("four_bar", seconds=1.0)
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    stream = Stream(case.mechanism, Columns.of(case.mechanism), motion, latency=0.05)
    good = [r for s in given(case.log, "blocks") for r in stream.push(s)]
    t = 1.0 + np.arange(1, 31) / 200.0
    wild = {k: np.full(30, 1e5 if k[0] == "q" else 0.0) for k in case.log.columns}
    assert not stream.push({"t": t, **wild})
    lost, why = stream.lost
    assert lost == 30
    assert "jumps" in why
    again = {"t": case.log.t + 2.0, **case.log.columns}
    after = [*stream.push(again), *stream.flush()]
    np.testing.assert_allclose(together(after).A, together(good).A, atol=1e-9)


# --- what comes in -----------------------------------------------------------------------------


def opened(mapping=None):
    case = made("slider_crank")
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    stream = Stream(case.mechanism, Columns.of(case.mechanism), motion)
    return stream, list(samples(case.log))


def test_a_bad_sample_is_refused_and_the_rest_goes_on():
    stream, good = opened()
    stream.push(good[0])
    with pytest.raises(LogError, match=r"q\.theta = nan in the sample at t = 0\.005"):
        stream.push(good[1] | {"q.theta": np.nan})
    with pytest.raises(LogError, match="comes after one at 0 s"):
        stream.push(good[0])
    with pytest.raises(LogError, match="neither numbers nor arrays"):
        stream.push(good[1] | {"q.theta": "fast"})
    with pytest.raises(LogError, match="neither numbers nor arrays"):
        stream.push(good[1] | {"q.theta": [1.0, 2.0]})
    with pytest.raises(MotionError, match=r"no column 'tau\.s'; .*valid"):
        stream.push({k: x for k, x in good[1].items() if k != "tau.s"})
    stream.push(good[1])
    assert stream.samples == 2


def test_columns_have_this_robots_own_names(tmp_path):
    case = made("slider_crank")
    folder = tmp_path / "named"
    folder.mkdir()
    text = (ROBOTS / "slider_crank" / "mechanism.toml").read_text()
    text += '[log]\nt = { column = "stamp", scale = 0.001 }\n'
    text += '"q.theta" = { column = "angle", scale = 0.5, offset = 0.1 }\n'
    (folder / "mechanism.toml").write_text(text)
    urdf = "slider_crank.urdf"
    (folder / urdf).write_text((ROBOTS / "slider_crank" / urdf).read_text())
    mechanism = ident.load(folder)
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    columns = Columns.of(mechanism)
    stream = Stream(mechanism, columns, motion)
    found = []
    for s in samples(case.log):
        raw = {k: x for k, x in s.items() if k not in ("t", "q.theta")}
        raw |= {"stamp": 1000 * s["t"], "angle": (s["q.theta"] - 0.1) / 0.5}
        found += stream.push(raw)
    expected = batch(mechanism, motion, columns)
    assert_same(together([*found, *stream.flush()]), expected, 1e-9)


def test_the_recipe_comes_from_a_motion_of_the_same_machine():
    case = made("arm", seconds=3.0, noise=0.01)
    motion = ident.complete(case.mechanism, case.log)
    columns = Columns.of(case.mechanism)
    recipe = Stream(case.mechanism, columns, motion).recipe
    assert 1 / recipe.clock.step == pytest.approx(1 / measure(case.mechanism, case.log).dt)
    assert recipe.band == motion.band
    assert recipe.logged == ("yaw", "shoulder", "elbow", "wrist")
    with pytest.raises(MotionError, match="has no log"):
        Stream(case.mechanism, columns, replace(motion, logs=()))
