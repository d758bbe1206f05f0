"""Commands of a slow log are held, or go straight on, between its samples: fitted and played."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from servo_logs import Servos, servo_log

import ident
from helpers import ROBOTS
from ident.assess.drives import check_drives
from ident.effects.command import late_command
from ident.equations.unknowns import Point
from ident.errors import MechanismError
from ident.simulate.commands import command_laws, steps_of

pl = pytest.importorskip("polars")
pytest.importorskip("mujoco")
JOINTS = ("yaw", "shoulder", "elbow")
RATE = 50.0  # Hz: a hold is 20 ms, a tenth of what the servos take to follow
TRUTH = Servos(delay=0.006)


def arm(*drives):
    mechanism = ident.load(ROBOTS / "servo_arm").with_calibration("exact")
    others = [e for e in mechanism.effects if not e.supplies_torque and e.kind != "command_delay"]
    known = replace(mechanism, effects=tuple(others), unknown=())
    return known.with_drives(*drives)


def fit_of_servos(seed, seconds):
    """By least squares, of a log of MuJoCo's servos."""
    mechanism, log = arm("servo"), pl.DataFrame(servo_log(Servos(), seed, seconds))
    return ident.identify(mechanism, ident.complete(mechanism, log), estimator="least-squares")


def commanded(straight, rate=RATE, seconds=8.0):
    return pl.DataFrame(servo_log(TRUTH, 6100, seconds, rate, 18, straight=straight))


@pytest.fixture(scope="module")
def held():
    return commanded(straight=False)


def planted(hold):
    """The arm with all its values but bodies known."""
    drives = [
        f"{joint}:kp={kp},kd={kd},delay={TRUTH.delay},hold={hold}"
        for joint, kp, kd in zip(JOINTS, TRUTH.kp, np.add(TRUTH.kd, TRUTH.Fv), strict=True)
    ]
    return arm(*drives)


def values():
    of = {"coulomb.{}.Fc": TRUTH.Fc, "rotor_inertia.{}.Ia": TRUTH.Ia}
    return {name.format(j): x for name, row in of.items() for j, x in zip(JOINTS, row, strict=True)}


def played(log, hold):
    """Rms [rad] by which the planted values leave a log's motion, from its first second on."""
    run = ident.integrate(planted(hold), ident.Torques(log), values=values(), tolerance=1e-6)
    off = run.y - np.stack([np.interp(run.t, log["t"], log[f"q.{j}"]) for j in JOINTS], axis=1)
    on_samples = np.abs(run.t - np.round(run.t * RATE) / RATE) < 1e-6
    return float(np.sqrt(np.mean(off[(run.t > 1.0) & on_samples] ** 2)))


@pytest.mark.parametrize("hold", [0.0, 0.005, 0.012])
@pytest.mark.parametrize("late", [0.0, 0.0083])
def test_what_a_filter_passes_of_a_held_sine(late, hold):
    t, f = np.arange(2000) * 0.005, 9.0
    y = late_command(t, np.sin(2 * np.pi * f * t), late, hold)
    expected = np.sinc(f * hold) * np.sin(2 * np.pi * f * (t - late - hold / 2))
    assert y[50:-50] == pytest.approx(expected[50:-50], abs=1e-4)


def test_a_constant_and_a_step_far_away_stay_what_they_are():
    t, x = np.arange(100) * 0.01, np.ones(100)
    assert late_command(t, x, 0.033, 0.01) == pytest.approx(1.0, abs=1e-12)
    x[:40] = 0.0
    y = late_command(t, x, 0.033, 0.01)
    assert y[20] == pytest.approx(0.0, abs=1e-6)
    assert y[80] == pytest.approx(1.0, abs=1e-6)


def test_a_held_command_is_played_as_steps(held):
    assert played(held, "constant") < 0.25e-3
    assert played(held, "linear") > 1e-3


def test_a_straight_command_is_played_as_lines():
    log = commanded(straight=True)
    assert played(log, "linear") < 0.25e-3
    assert played(log, "constant") > 1e-3


@pytest.mark.parametrize("hold", ["constant", "linear"])
def test_gains_and_delay_with_each_hold(hold):
    mechanism = arm("servo", f"hold={hold}")
    log = commanded(straight=hold == "linear", rate=100.0, seconds=20.0)
    values = ident.identify(mechanism, ident.complete(mechanism, log)).point.values
    for joint, kp, kd in zip(JOINTS, TRUTH.kp, np.add(TRUTH.kd, TRUTH.Fv), strict=True):
        assert values[f"servo.{joint}.kp"] == pytest.approx(kp, rel=0.01)
        assert values[f"servo.{joint}.kd"] == pytest.approx(kd, rel=0.01)
    # with the other hold it is half a sample off, 5 ms
    assert values[f"command_delay.{','.join(JOINTS)}.d"] == pytest.approx(TRUTH.delay, abs=3e-4)


def test_check_says_how_commands_are_held(held):
    for hold, words in (("constant", "held between"), ("linear", "straight on between")):
        mechanism = arm("kp=20,kd=0.5", f"hold={hold}")
        checks = check_drives(mechanism, ident.complete(mechanism, held.head(400)))
        assert all(words in check.command for check in checks)


def test_another_word_is_refused():
    with pytest.raises(MechanismError, match=r"hold = 'zero'.*constant"):
        arm("hold=zero")


def test_a_gain_that_changes_acts_on_the_straight_command_at_once():
    n, change = 400, 200
    t, kp = np.arange(n) / RATE, np.where(np.arange(n) < change, 1.0, 2.0)
    ref = {joint: 0.3 + 0.4 * np.sin((1.0 + 0.2 * j) * t) for j, joint in enumerate(JOINTS)}
    columns = {"t": t}
    for joint in JOINTS:
        columns |= {f"q.{joint}": ref[joint], f"ref.{joint}": ref[joint], f"kp.{joint}": kp}
    for delay in (0.0, 0.25 / RATE):
        mechanism = arm(f"kp=14,kd=0,delay={delay},hold=linear")
        (e,) = ident.complete(mechanism, pl.DataFrame(columns)).experiments
        laws = command_laws(mechanism, Point.prior(mechanism), e)
        assert steps_of(laws) == pytest.approx([t[change]])
        for part in (-0.75, -0.5, -0.25, 0.0, 0.25, 0.5):
            at = t[change] + part / RATE
            q = np.array([np.interp(at - delay, t, ref[joint]) for joint in JOINTS])
            for law in laws:
                assert law.torque(at, q, 0 * q) == pytest.approx(0.0, abs=1e-9)
                gain = 14.0 if part < 0 else 28.0
                assert law.torque(at, q - 0.1, 0 * q) == pytest.approx(0.1 * gain)


@pytest.mark.parametrize("rate", [50.0, 300.0])
def test_delays_that_differ_by_whole_samples_make_no_shorter_steps(rate):
    n = 300
    random = np.random.default_rng(0)
    columns = {"t": np.arange(n) / rate}
    for joint in JOINTS:
        ref = np.cumsum(random.normal(size=n)) * 0.01
        columns |= {f"q.{joint}": ref, f"ref.{joint}": ref, f"kp.{joint}": np.full(n, 1.0)}
    delays = (0.0, 3 / rate, 0.002 + 1 / rate)
    drives = [f"{j}:kp=14,kd=0.3,delay={x}" for j, x in zip(JOINTS, delays, strict=True)]
    mechanism = arm(*drives)
    (e,) = ident.complete(mechanism, pl.DataFrame(columns)).experiments
    laws = command_laws(mechanism, Point.prior(mechanism), e)
    steps = steps_of(laws)
    assert np.diff(np.union1d(steps, e.t)).min() > 1e-4 / rate
    for law, late in zip(laws, (0, 3), strict=False):  # the command of its sample acts from then on
        ref = e.extra[f"ref.{JOINTS[law.joint]}"]
        for k in (10, 50, 99):
            torque = law.torque(e.t[k + late], np.zeros(3), np.zeros(3))
            assert torque == pytest.approx(14.0 * ref[k])


def test_the_command_of_a_pose_is_the_one_that_holds_it():
    """Rows are poses at rest in any order, so that no row is late against the one before."""
    mechanism = ident.load(ROBOTS / "servo_arm")
    names, model, random = mechanism.driven, mechanism.model, np.random.default_rng(4)
    q, kp = random.uniform(-1.0, 1.0, (60, len(names))), np.array([20.0, 25.0, 14.0])
    data = model.createData()
    gravity = np.array([pin.computeGeneralizedGravity(model, data, x) for x in q])
    columns = {f"q.{name}": q[:, j] for j, name in enumerate(names)}
    columns |= {f"ref.{name}": (q + gravity / kp)[:, j] for j, name in enumerate(names)}
    log = ident.Log.from_arrays("poses", np.arange(60.0), columns)
    fit = ident.identify(mechanism, ident.complete(mechanism, log, poses=True))
    for name, gain in list(zip(names, kp, strict=True))[1:]:  # gravity loads no yaw
        assert fit[f"servo.{name}.kp"].value == pytest.approx(gain, rel=1e-6)


def test_a_drive_that_bears_nothing_but_rounding_moves_no_other(monkeypatch):
    """Its rows are noise of rounding, whichever way that falls."""
    monkeypatch.setattr("ident.equations.terms.Samples._gamma_row", lambda *_: None)
    test_the_command_of_a_pose_is_the_one_that_holds_it()
