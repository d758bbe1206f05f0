"""Knots where noise is not white: chosen by the torques, and moved by the cut-off."""

import numpy as np
import polars as pl
import pytest
from scipy.signal import lfilter

import ident
from helpers import ROBOTS
from ident.motion.knots import ROUGH, common
from ident.motion.spline import grain, motion_bandwidth

FRICTION = 0.3  # N m s/rad, N m: of all joints


@pytest.fixture(scope="module")
def arm():
    return ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb")


@pytest.fixture(scope="module", params=[(0.8, 1e-3), (0.95, 1e-3)])
def log(request, arm):
    """Positions with noise of a correlation from sample to sample, and a size [rad]."""
    rho, size = request.param
    values = {name: FRICTION for effect in arm.effects for name in effect.names}
    clean, _ = ident.simulate(
        arm, ident.read_log(ROBOTS / "arm" / "run.csv"), values=values, columns=["q", "tau"],
        seed=1, noise=[ident.Noise("tau", 0.01, True)],
    )  # fmt: skip
    random, columns = np.random.default_rng(1), dict(clean.columns)
    for name in columns:
        if name.startswith("q."):
            white = random.standard_normal(len(clean.t))
            noise = lfilter([np.sqrt(1 - rho**2)], [1, -rho], white)
            columns[name] = columns[name] + size * noise
    return pl.DataFrame({"t": clean.t, **columns})


def error(arm, motion):
    """The mean error of friction [N m s/rad, N m]."""
    point = ident.identify(arm, motion, estimator="least-squares").point
    names = [name for effect in arm.effects for name in effect.names]
    return np.mean([abs(point.values[name] - FRICTION) for name in names])


def test_torques_choose_knots_that_noise_does_not_mislead(arm, log, monkeypatch):
    motion = ident.complete(arm, log)
    assert any("noise of the motion is not white" in note for note in motion.notes)
    assert motion.band.cutoff <= 0.5 / motion.experiments[0].smooth.spacing + 1e-9
    monkeypatch.setattr("ident.motion.motion.doubtful", lambda *_: False)
    white = ident.complete(arm, log)
    assert error(arm, motion) < 0.5 * error(arm, white)


def test_torques_choose_knots_that_vibrating_rates_do_not_mislead(arm, monkeypatch):
    values = {name: FRICTION for effect in arm.effects for name in effect.names}
    clean, _ = ident.simulate(
        arm, ident.read_log(ROBOTS / "arm" / "run.csv"), values=values, columns=["q", "v", "tau"],
        seed=1, noise=[ident.Noise("tau", 0.01, True), ident.Noise("q", 3e-4)],
    )  # fmt: skip
    random, columns = np.random.default_rng(1), dict(clean.columns)
    for name in columns:
        if name.startswith("v."):  # of links on their gears, which no torque of the model makes
            swing = lfilter([0.3], [1, -1.6, 0.9], random.standard_normal(len(clean.t)))
            columns[name] = columns[name] + 0.05 * swing
    log = pl.DataFrame({"t": clean.t, **columns})
    motion = ident.complete(arm, log)
    monkeypatch.setattr("ident.motion.motion.doubtful", lambda *_: False)
    white = ident.complete(arm, log)
    assert error(arm, motion) < 0.5 * error(arm, white)


def test_a_cutoff_moves_the_knots(arm, log):
    (e,) = ident.complete(arm, log, cutoff=0.2).experiments
    assert e.smooth.spacing >= 0.5 * 0.999  # s: a tenth of the cut-off's period, or more


def jittering(arm, size):
    """A log whose rows were taken at other times than their stamps say, off by `size` [s] rms."""
    values = {name: FRICTION for effect in arm.effects for name in effect.names}
    clean, _ = ident.simulate(
        arm, ident.read_log(ROBOTS / "arm" / "run.csv"), values=values, columns=["q", "tau"],
        seed=1, noise=[ident.Noise("tau", 0.01, True), ident.Noise("q", 1e-4)],
    )  # fmt: skip
    late = clean.t + size * np.random.default_rng(2).standard_normal(len(clean.t))
    moved = {name: np.interp(late, clean.t, x) for name, x in clean.columns.items()}
    return pl.DataFrame({"t": clean.t, **moved})


def test_time_errors_that_all_joints_have_in_common_are_removed(arm, monkeypatch):
    log = jittering(arm, 3e-3)
    motion = ident.complete(arm, log)
    (note,) = (note for note in motion.notes if "time stamps are off by" in note)
    assert 2e-3 < 1e-3 * float(note.split("off by ")[1].split()[0]) < 4e-3
    even = ident.complete(arm, jittering(arm, 0.0))
    assert not any("stamps are off" in note for note in even.notes)
    monkeypatch.setattr("ident.motion.motion.without_time_errors", lambda *_: None)
    as_stamped = ident.complete(arm, log)

    def off(found):
        """The rms error of the accelerations, of their size, away from the ends."""
        a, b = (motion.experiments[0].ydd[300:-300] for motion in (found, even))
        return np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2))

    assert off(motion) < 0.9 * off(as_stamped)


def test_what_a_spline_misses_of_corners_is_no_time_error():
    """All joints of a trapeze turn their corners together, and smooth motion misses these."""
    t = np.linspace(0, 10, 2001)
    speed = np.clip(3 * np.sin(t), -1, 1)
    missed = np.gradient(np.gradient(speed, t), t)[:, None] * [1e-3, 2e-3, 3e-3]
    white = 1e-3 * np.random.default_rng(0).standard_normal((len(t), 1)) * speed[:, None]
    for r, rough in ((missed, False), (white * [1.0, 2.0, 3.0], True)):
        delta, _ = common(r + 1e-9, speed[:, None] * [1.0, 2.0, 3.0])
        assert (np.mean(np.diff(delta) ** 2) > ROUGH * 2 * np.mean(delta**2)) == rough


@pytest.mark.parametrize(("bits", "said"), [(12, True), (20, False)])
def test_positions_in_steps_are_named_where_their_noise_is_that(arm, bits, said):
    clean, _ = ident.simulate(
        arm, ident.read_log(ROBOTS / "arm" / "run.csv"), columns=["q", "tau"], seed=1,
        values={name: FRICTION for effect in arm.effects for name in effect.names},
        noise=[ident.Noise("tau", 0.01, True), ident.Noise("q", 1e-4)],
    )  # fmt: skip
    step = 2 * np.pi / 2**bits
    columns = {
        name: step * np.round(x / step) if name[:2] == "q." else x
        for name, x in clean.columns.items()
    }
    motion = ident.complete(arm, pl.DataFrame({"t": clean.t, **columns}))
    notes = [note for note in motion.notes if f"{bits} bit" in note]
    assert bool(notes) is said
    assert not said or all(f"q.{name}" in notes[0] for name in arm.driven)


@pytest.mark.parametrize("rate", [100.0, 5000.0])
def test_steps_of_a_slow_and_of_a_fast_log_are_measured(rate):
    t = np.arange(0, 4, 1 / rate)
    smooth, step = 0.7 * np.sin(2 * t), 1.5e-3
    assert grain(step * np.round(smooth / step)) == pytest.approx(step)
    assert grain(smooth) == 0
    assert grain(0.3 * t) == 0


def test_a_lone_spectral_line_is_no_motion():
    """A vibration that holds more of the velocity's power than POWER leaves, in one line."""
    t, rng = np.arange(3000) / 100, np.random.default_rng(0)
    moved = np.sin(2 * np.pi * 0.4 * t) + 6e-4 * rng.standard_normal(len(t))
    shaken = moved + 6e-4 * np.sin(2 * np.pi * 33.77 * t)
    assert motion_bandwidth(moved, 0.01) < 0.6
    assert motion_bandwidth(shaken, 0.01) < 0.6
    faster = moved + 0.02 * np.sin(2 * np.pi * 7.0 * t)  # a line of the motion's own
    assert 6.9 < motion_bandwidth(faster, 0.01) < 7.2
    assert motion_bandwidth(moved[:13], 0.01) >= 0.0


@pytest.mark.parametrize("missing", [["v.theta"], ["v.x", "v.y", "v.theta"]])
def test_a_machine_without_torques_has_no_knots_by_torques(missing):
    mechanism, log = ident.load(ROBOTS / "pendulum"), ident.read_log(ROBOTS / "pendulum/run.csv")
    columns = {name: x for name, x in log.columns.items() if name not in missing}
    motion = ident.complete(mechanism, ident.Log.from_arrays("swing", log.t, columns))
    at = mechanism.joint_index["theta"]
    inside = motion.experiments[0].usable
    a = np.interp(motion.experiments[0].t, log.t, log.columns["a.theta"])
    off = motion.experiments[0].ydd[inside, at] - a[inside]
    assert np.sqrt(np.mean(off**2)) < 0.01 * np.abs(a).max()
