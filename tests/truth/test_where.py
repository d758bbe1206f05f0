"""Where a model fails: planted effects that it lacks, and noise in which there is nothing."""

import time
from dataclasses import replace

import numpy as np
import pytest

import ident
from ident import Noise
from ident.fit.prediction import Trace
from ident.fit.residual import Residual, where
from identification import motion_log, plant, robot

NOISE = [Noise("tau", 0.02, relative=True), Noise("q", 1e-5)]


def left(name, has, lacks, seed=1, seconds=8.0, period=4.0):
    """The residual of a model that lacks effects which the log has."""
    model = robot(name)
    for effect in has:
        model = model.with_effect(effect)
    full = model
    for effect in lacks:
        full = full.with_effect(effect)
    log = motion_log(name, 100.0, seconds, period)
    case = plant(full, log, noise=NOISE, seed=seed)
    return ident.residual_of(case.fit(mechanism=model, cutoff="auto"))


@pytest.mark.parametrize("seed", range(3))
def test_missing_dry_friction_is_seen_in_the_speed_of_its_joint(seed):
    first, *others = where(left("arm", ["viscous", "coulomb:yaw"], ["coulomb:elbow"], seed))
    assert first.joint == "elbow"
    assert first.depends_on[0].signal in ("v.elbow", "sign(v).elbow")
    assert first.depends_on[0].r2 > 0.5
    assert first.share > 0.8
    assert not first.white
    assert all(other.white for other in others)


def test_missing_viscous_friction_is_a_straight_line():
    first, *_ = where(left("arm", [], ["viscous:wrist"]))
    assert (first.joint, first.depends_on[0].signal) == ("wrist", "v.wrist")


def test_missing_friction_between_joints_is_named_by_the_other_joint():
    first, *_ = where(left("arm", ["viscous", "coulomb"], ["coupling:elbow,wrist"], seconds=16.0))
    assert first.joint in ("elbow", "wrist")
    assert first.depends_on[0].signal.endswith((".elbow", ".wrist"))


def test_a_closed_loop():
    first, *_ = where(left("five_bar", ["coulomb"], ["viscous:right"]))
    assert first.joint == "right"
    assert first.depends_on[0].signal == "v.right"


@pytest.mark.parametrize("name", ["arm", "five_bar", "slider_crank", "four_bar"])
@pytest.mark.parametrize("seed", range(5))
def test_noise_is_white_and_depends_on_nothing(name, seed):
    for failure in where(left(name, ["viscous", "coulomb"], [], seed)):
        assert failure.white, failure
        assert failure.depends_on == ()


def test_without_noise_nothing_is_left():
    case = plant(robot("arm"), motion_log("arm", 100.0, 8.0))
    for failure in where(ident.residual_of(case.fit())):
        assert failure.white
        assert failure.worst == failure.depends_on == ()


# --- periods -----------------------------------------------------------------------------------


def test_periods_are_found_and_the_residual_repeats_with_what_is_missing():
    clean = left("arm", ["viscous", "coulomb"], [], seconds=8.0).periods
    assert clean.period["arm.csv"] == pytest.approx(4.0, abs=0.01)
    assert max(clean.rho.values()) < clean.chance
    bare = left("arm", ["viscous", "coulomb:yaw"], ["coulomb:elbow"], seconds=8.0).periods
    assert bare.rho["elbow"] > 0.9


def test_a_turning_crank_repeats_too():
    found = left("four_bar", ["viscous"], [], seconds=12.0).periods
    assert found.period["four_bar.csv"] == pytest.approx(4.0, abs=0.01)


@pytest.mark.parametrize("name", ["arm", "four_bar", "slider_crank"])
def test_one_period_does_not_repeat(name):
    assert left(name, ["viscous"], [], seconds=4.0).periods is None


# --- residuals made by hand --------------------------------------------------------------------


def made(residual, t, q, v, load=None, **changes):
    """A residual (n, 2) of two joints without any model."""
    n = len(t)
    load = np.zeros((n, 2)) if load is None else load
    trace = Trace(
        "made.csv", t, load + residual, {"rigid bodies": load}, np.ones((n, 2), bool),
        np.zeros(n, int), load, q, v, np.gradient(v, t, axis=0), np.clip(v / 0.01, -1, 1),
        np.ones((n, 2), bool),
    )  # fmt: skip
    trace = replace(trace, **changes)
    band = ident.motion.Band(1.0, 0.0, None)
    motion = ident.Motion((), ("a", "b"), band, 0.0)
    ab = ("a", "b")
    return Residual("made", None, motion, ab, ("N m",) * 2, ("rad",) * 2, ab, (trace,))


@pytest.fixture
def swing():
    t = np.arange(0, 40, 0.01)
    q = np.stack([np.sin(0.9 * t) + 0.4 * np.sin(2.3 * t), np.sin(1.7 * t + 0.4 * t**1.1)], axis=1)
    load = np.stack([3 * np.cos(0.31 * t + 0.02 * t**1.2), 1 + np.sin(0.53 * t)], axis=1)
    noise = np.random.default_rng(0).normal(size=(len(t), 2))
    return t, q, np.gradient(q, t, axis=0), load, noise


SHAPES = {
    "end stop": (lambda q, v, load, t: 9 * np.maximum(0, q - 0.9), "q.a"),
    "wave": (lambda q, v, load, t: 1.5 * np.sin(17 * q), "q.a"),
    "load": (lambda q, v, load, t: np.abs(load) * np.sign(v), "load.a"),
    "gain": (lambda q, v, load, t: 0.7 * load, "load.a"),
    "step": (lambda q, v, load, t: np.sign(v), "sign(v).a"),
    "drift": (lambda q, v, load, t: 0.05 * (t - 20), "t"),
}


@pytest.mark.parametrize(("f", "signal"), SHAPES.values(), ids=SHAPES)
def test_the_signal_of_a_shape_is_named(f, signal, swing):
    t, q, v, load, noise = swing
    residual = 0.3 * noise
    residual[:, 0] += f(q[:, 0], v[:, 0], load[:, 0], t)
    found = {failure.joint: failure for failure in where(made(residual, t, q, v, load))}
    assert [each.signal for each in found["a"].depends_on] == [signal]
    assert found["b"].white
    assert not found["a"].white


def test_windows_that_stand_out(swing):
    t, q, v, load, noise = swing
    residual = 0.1 * noise
    burst = (t > 10) & (t < 11)
    residual[burst, 0] += noise[burst, 0]
    found = {failure.joint: failure for failure in where(made(residual, t, q, v, load))}
    (window,) = found["a"].worst
    assert (window.start, window.stop) == pytest.approx((10, 11), abs=0.4)
    assert window.experiment == "made.csv"


def test_windows_are_of_the_rows_by_which_errors_are_judged(swing):
    """At standstill dry friction may have any value; a joint that only stands has all its rows."""
    t, q, v, load, noise = swing
    residual = 0.1 * noise
    for start, size in ((10, 1.0), (20, 5.0)):
        now = (t > start) & (t < start + 1)
        residual[now] += size * noise[now]
    moving = np.stack([(t < 20) | (t > 21), np.zeros(len(t), bool)], axis=1)
    found = {f.joint: f for f in where(made(residual, t, q, v, load, moving=moving))}
    (window,) = found["a"].worst
    assert (window.start, window.stop) == pytest.approx((10, 11), abs=0.4)
    assert found["b"].worst[0].start == pytest.approx(20, abs=0.4)


def test_memory_that_no_signal_explains_is_no_noise(swing):
    t, q, v, load, noise = swing
    walk = np.convolve(noise[:, 0], np.ones(100) / 10, "same")
    first, *_ = where(made(np.stack([walk, 0.1 * noise[:, 1]], axis=1), t, q, v, load))
    assert first.joint == "a"
    assert not first.white
    assert first.depends_on == ()
    assert "correlated in time" in str(first)


def test_shares_weigh_joints_by_their_torque(swing):
    t, q, v, load, noise = swing
    found = where(made(noise * [1, 0.1], t, q, v, load * [10, 0.1]))
    assert [failure.joint for failure in found] == ["b", "a"]
    assert sum(failure.share for failure in found) == pytest.approx(1)
    b, a = (failure.relative for failure in found)
    assert found[0].share == pytest.approx(b**2 / (a**2 + b**2))


def test_six_joints_and_ten_thousand_rows_take_seconds():
    random, n, d = np.random.default_rng(0), 10_000, 6
    t = np.arange(n) / 100
    slow = [
        np.stack([np.interp(t, np.arange(101), random.normal(size=101)) for _ in range(d)], axis=1)
        for _ in range(4)
    ]
    q, v, a, load = slow
    names = tuple("abcdef")
    trace = Trace(
        "made.csv", t, load + np.sign(v) + random.normal(size=(n, d)), {"rigid bodies": load},
        np.ones((n, d), bool), np.zeros(n, int), load, q, v, a, np.sign(v),
        random.random((n, d)) > 0.05,
    )  # fmt: skip
    motion = ident.Motion((), names, ident.motion.Band(1.0, 0.0, None), 0.0)
    units = ("N m",) * d, ("rad",) * d
    residual = Residual("made", None, motion, names, *units, names, (trace,))
    start = time.process_time()
    found = where(residual)
    assert time.process_time() - start < 6  # 1.5 s on one core of the machine it was written on
    assert all(f.depends_on[0].signal == f"sign(v).{f.joint}" for f in found)
