"""`integrate` and `replay`: what they give back, and what they refuse."""

import json

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident import FitError, Log, MechanismError, MotionError, Noise
from ident.show.comparison import comparison_files
from identification import motion_log, robot


def test_a_run_prints_itself_and_has_a_log():
    mechanism = robot("four_bar").with_effect("coulomb:crank")
    run = ident.integrate(
        mechanism, values={"coulomb.crank.Fc": 0.1}, start={"v.crank": 4.0}, duration=1.0, rate=200
    )
    assert "simulated four_bar: 201 samples" in str(run)
    assert "dry friction at crank" in run.summary
    assert set(run.log.columns) == {f"{c}.crank" for c in ("q", "v", "a", "tau")}
    assert run.multipliers.shape == (201, 5)
    assert "dry friction at crank" in run._repr_html_()
    np.testing.assert_array_equal(run.log.columns["tau.crank"], 0.0)


def test_multipliers_are_those_of_inverse_dynamics():
    mechanism, log = robot("five_bar"), motion_log("five_bar", 200.0, 1.0)
    run = ident.integrate(mechanism, ident.ComputedTorque(log))
    _, said = ident.simulate(mechanism, run.log)
    seen = [i for i, name in enumerate(mechanism.kinematics.multipliers) if name != "tip.z"]
    scale = np.abs(said.multipliers[:, seen]).max()
    np.testing.assert_allclose(
        run.multipliers[:, seen], said.multipliers[:, seen], atol=1e-8 * scale
    )


def test_fewer_drives_than_freedom_fall_freely():
    run = ident.integrate(ident.load(ROBOTS / "pendulum"), duration=1.0)
    assert {"q.x", "q.y", "q.theta"} < set(run.log.columns)
    assert not any(name.startswith("tau") for name in run.log.columns)


def test_start_is_closed():
    run = ident.integrate(robot("four_bar"), start={"crank": 0.5, "v.crank": 1.0}, duration=0.1)
    np.testing.assert_allclose((run.q[0, 0], run.v[0, 0]), (0.5, 1.0), atol=1e-12)
    by_rocker = ident.integrate(robot("four_bar"), start={"q.rocker": 1.4}, duration=0.1)
    assert by_rocker.y[0, 2] == pytest.approx(1.4, abs=1e-10)


def test_noise_and_columns_are_those_wanted():
    options = {"duration": 0.2, "rate": 500.0, "start": {"v.crank": 5.0}}
    clean = ident.integrate(robot("four_bar"), **options).log
    noise = [Noise("q", 1e-3)]
    log = ident.integrate(
        robot("four_bar"), noise=noise, columns=("q", "tau"), joints=["rocker"], **options
    ).log
    assert set(log.columns) == {"q.rocker", "tau.crank"}
    same = ident.integrate(
        robot("four_bar"), noise=noise, columns=("q",), joints=["rocker"], **options
    ).log
    np.testing.assert_array_equal(same.columns["q.rocker"], log.columns["q.rocker"])
    assert "q.crank" in clean


def test_computed_torque_follows_exactly():
    """It knows the model, so nothing is left but interpolation; dry friction it does not know."""
    arm, log = robot("arm"), motion_log("arm", 100.0, 1.0)
    run = ident.integrate(arm, ident.ComputedTorque(log))
    rough = arm.with_effect("coulomb", {"Fc": 0.02})
    held = ident.integrate(rough, ident.ComputedTorque(log))
    for joint in arm.driven:
        q = log.columns[f"q.{joint}"]
        assert np.abs(run.log.columns[f"q.{joint}"] - q).max() < 1e-5
        assert np.abs(held.log.columns[f"q.{joint}"] - q).max() < 0.1


def test_pd_follows_better_with_higher_gains():
    arm, log = robot("arm"), motion_log("arm", 100.0, 1.0)
    gains = {"yaw": (400, 20), "shoulder": (900, 45), "elbow": (150, 7), "wrist": (2, 0.05)}
    off = []
    for more in (1, 4):
        high = {joint: (more * Kp, np.sqrt(more) * Kd) for joint, (Kp, Kd) in gains.items()}
        run = ident.integrate(arm, ident.PD(log, high), tolerance=1e-8)
        off.append([np.abs(run.log.columns[f"q.{j}"] - log.columns[f"q.{j}"])[50:].max()
                    for j in arm.driven])  # fmt: skip
    assert (np.array(off[1]) < 0.6 * np.array(off[0])).all()
    assert max(off[1]) < 0.05


REFUSED = {
    "no such joint": ({"start": {"q.crnk": 1.0}}, "did you mean 'crank'"),
    "two of one": ({"start": {"crank": 0.0, "rocker": 1.2}}, "cannot all be chosen"),
    "not finite": ({"start": {"crank": np.nan}}, "give a finite number"),
    "no time": ({"duration": 0.0}, "give a number above 0"),
    "no rate": ({"rate": -1.0}, "give a number above 0"),
    "less than a step": ({"duration": 0.001}, "less than one step"),
    "tolerance": ({"tolerance": 1.0}, "valid: 1e-13 to 1e-3"),
    "channel": ({"columns": ("torque",)}, "'torque'"),
    "joint": ({"joints": ["crnk"]}, "did you mean 'crank'"),
    "noise": ({"noise": [Noise("w", 1.0)]}, "no column 'w'"),
    "value": ({"values": {"rod.m": 1.0}}, "no parameter 'rod.m'"),
}


@pytest.mark.parametrize(("options", "words"), REFUSED.values(), ids=REFUSED)
def test_what_is_wrong_is_said(options, words):
    with pytest.raises((MotionError, MechanismError), match=words):
        ident.integrate(robot("four_bar"), **{"duration": 0.1, **options})


def test_effects_that_cannot_be_integrated_are_refused_by_name():
    loop = robot("four_bar").with_effect("closure_compliance:pin", {"C": 1e-6})
    with pytest.raises(MechanismError, match=r"'closure_compliance:pin': cannot be integrated"):
        ident.integrate(loop)
    warm = robot("arm").with_effect("viscous:elbow", {"Fv": 0.1})
    warm = warm.with_effect("temperature_friction:elbow", {"kappa": 0.1})
    with pytest.raises(MotionError, match=r"temperature\.elbow"):
        ident.integrate(warm)
    pushed = robot("arm").with_effect("coulomb:elbow", {"Fc": -0.1})
    with pytest.raises(MechanismError, match=r"coulomb:elbow is -0\.1 at rest"):
        ident.integrate(pushed)
    with pytest.raises(MechanismError, match=r"give viscous\.elbow\.Fv a value"):
        ident.integrate(robot("arm").with_effect("viscous:elbow"))


def test_drives_that_do_not_fit_are_refused():
    arm, log = robot("arm"), motion_log("arm", 100.0, 1.0)
    with pytest.raises(MotionError, match=r"no column 'tau\.yaw'"):
        ident.integrate(arm, ident.Torques(log))
    with pytest.raises(MotionError, match=r"lasts 0\.99 s"):
        ident.integrate(arm, ident.PD(log), duration=2.0)
    with pytest.raises(MotionError, match="has no drive"):
        ident.integrate(arm, ident.PD(log, {"yow": (1.0, 1.0)}))
    with pytest.raises(MotionError, match="none for 'shoulder'"):
        ident.integrate(arm, ident.PD(log, {"yaw": (1.0, 1.0)}))
    with pytest.raises(MotionError, match="0 or more"):
        ident.integrate(arm, ident.PD(log, (-1.0, 1.0)))


def test_a_motion_that_grows_without_bounds_ends_with_one_line():
    runaway = robot("arm").with_effect("viscous:elbow", {"Fv": -80.0})
    with pytest.raises(MotionError, match=r"arm: at t = .* s the (motion|integration)"):
        ident.integrate(runaway, duration=10.0, tolerance=1e-6)


# --- replay ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fitted():
    mechanism = robot("four_bar").with_effect("viscous").with_effect("coulomb")
    log = ident.read_log(ROBOTS / "four_bar" / "run.csv")
    short = Log.from_arrays("run.csv", log.t[:800], {k: x[:800] for k, x in log.columns.items()})
    motion = ident.complete(mechanism, short)
    return ident.identify(mechanism, motion), ident.identify(robot("four_bar"), motion)


@pytest.fixture(scope="module")
def replay(fitted):
    return ident.replay(*fitted, window=0.25)


def test_a_replay_tells_models_apart(fitted, replay, tmp_path):
    assert list(replay.runs) == ["fit 1", "fit 2"]
    (a,), (b,) = replay.runs.values()
    assert a.errors["crank"].rms < 0.3 * b.errors["crank"].rms
    assert a.errors["crank"].relative < 0.02
    assert "windows of 0.25 s, each from the measured state" in str(replay)
    said = json.loads(comparison_files(ident.compare(*fitted), replay)["compare.json"])
    joints = said["replay"]["models"]["fit 1"][0]["joints"]
    assert joints["crank"]["rms"] == a.errors["crank"].rms
    replay.plot().save(tmp_path / "motion.png")
    assert (tmp_path / "motion.png").stat().st_size > 10_000


def test_a_window_restarts_from_the_measured_state(replay):
    (run,) = replay.runs["fit 1"]
    off = np.abs(run.simulated - run.measured)[:, 0]
    starts = np.array(run.starts)
    assert np.isnan(off[: starts[0] + 1]).all()
    assert np.isfinite(off[starts[0] + 1 : starts[-1]]).all()
    assert np.median(off[starts + 1]) < 0.1 * np.median(off[starts[1:]])  # ends of windows
    steps = np.diff(run.starts)
    assert (steps == round(0.25 * 250)).all()


def test_what_cannot_be_replayed_is_refused(fitted):
    with pytest.raises(FitError, match="nothing to simulate"):
        ident.replay()
    with pytest.raises(FitError, match="two samples or more"):
        ident.replay(fitted[0], window=0.001)
    saved = object.__new__(ident.Saved)
    with pytest.raises(FitError, match="has no motion"):
        ident.replay(saved)
