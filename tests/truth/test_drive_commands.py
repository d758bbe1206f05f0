"""Commands that cannot be those of their joints are refused in one line."""

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.effects.command import held_samples, linear_samples
from ident.errors import MotionError

pl = pytest.importorskip("polars")
ARM = ROBOTS / "servo_arm"


@pytest.fixture(scope="module")
def log():
    return pl.read_csv(ARM / "run.csv").head(1200)


def refused(log, word, drives=("servo",)):
    mechanism = ident.load(ARM / "servo_arm.urdf").with_drives(*drives)
    with pytest.raises(MotionError, match=word) as caught:
        ident.complete(mechanism, log)
    assert "\n" not in str(caught.value)


def test_a_command_in_degrees(log):
    refused(log.with_columns(pl.col("ref.elbow").degrees()), r"ref\.elbow.*degrees.*0\.01745")


def test_a_command_of_another_joint(log):
    swapped = log.rename({"ref.elbow": "x", "ref.yaw": "ref.elbow"}).rename({"x": "ref.yaw"})
    refused(swapped, "command of another joint")


def test_a_command_that_never_changes(log):
    refused(log.with_columns(pl.lit(0.3).alias("ref.yaw")), r"ref\.yaw is always 0\.3")


def test_a_command_of_the_wrong_sign(log):
    refused(log.with_columns(-pl.col("ref.yaw")), "scale = -1")


def test_a_servo_above_its_resonance_goes_against_its_command():
    t = np.arange(0.0, 10.0, 0.005)
    command = np.sin(2 * np.pi * 6.0 * t) + 0.3 * np.sin(2 * np.pi * 7.1 * t)
    late = np.sin(2 * np.pi * 6.0 * t - 2.9) + 0.3 * np.sin(2 * np.pi * 7.1 * t - 3.0)
    columns = {"t": t}
    for joint in ("yaw", "shoulder", "elbow"):
        columns |= {f"ref.{joint}": 0.3 * command, f"q.{joint}": 0.2 * late}
    mechanism = ident.load(ARM / "servo_arm.urdf").with_drives("kp=20,kd=0.5")
    ident.complete(mechanism, pl.DataFrame(columns))
    refused(pl.DataFrame({**columns, "ref.yaw": -0.3 * np.roll(0.2 * late, -2)}), "scale = -1")


@pytest.mark.parametrize("bits", [None, 12])
@pytest.mark.parametrize("ahead", [0.0, 0.002])
def test_a_turned_command_is_refused_however_well_it_is_followed(bits, ahead):
    t = np.arange(0.0, 10.0, 0.005)
    step = 2 * np.pi / 2**bits if bits else 0.0
    columns = {"t": t}
    for joint, f in (("yaw", 0.7), ("shoulder", 0.9), ("elbow", 1.1)):
        ref, q = (0.3 * np.sin(2 * np.pi * f * x) + 0.1 * np.sin(19 * x) for x in (t, t + ahead))
        columns |= {f"ref.{joint}": ref, f"q.{joint}": np.round(q / step) * step if step else q}
    ident.complete(ident.load(ARM / "servo_arm.urdf").with_drives("servo"), pl.DataFrame(columns))
    refused(pl.DataFrame({**columns, "ref.yaw": -columns["ref.yaw"]}), "scale = -1")


def test_a_delay_longer_than_a_tenth_of_the_log(log):
    refused(log, "a tenth of the log", ("delay=0.9", "servo"))


def test_a_drive_that_is_saturated_throughout(log):
    refused(log, "at its limit", ("elbow:kp=14,limit=1e-6", "yaw:kp=20", "shoulder:kp=25"))


def test_drives_that_are_off_throughout_without_a_known_mass(log):
    off = log.with_columns(*(pl.lit(0).alias(f"on.{j}") for j in ("yaw", "shoulder", "elbow")))
    refused(off, "off throughout")


def test_a_gain_that_one_joint_lacks(log):
    refused(log.with_columns(pl.lit(400.0).alias("kp.yaw")), r"no 'kp\.shoulder'")


def test_a_duty_beyond_one(log):
    names = {f"ref.{j}": f"duty.{j}" for j in ("yaw", "shoulder", "elbow")}
    duty = log.rename(names).with_columns(pl.col("duty.yaw") * 80, pl.col("duty.elbow") * 0.5)
    refused(duty, r"duty\.yaw.*scale = 0\.01", ("duty",))


def test_how_commands_are_held():
    x = np.sin(np.arange(600) / 40)
    assert held_samples(x) == linear_samples(x) == 1
    assert held_samples(np.repeat(x[::6], 6)) == 6
    assert linear_samples(np.interp(np.arange(591), np.arange(0, 600, 10), x[::10])) == 10


def test_ramps_that_were_commanded_are_no_interpolation():
    k = np.arange(1200)
    triangle = np.interp(k, np.arange(0, 1201, 200), [0, 1, -1, 1, -1, 1, 0])
    waypoints = np.interp(k, np.arange(0, 1201, 50), np.sin(np.arange(25.0)))
    trapezoid = np.interp(k % 100, [0, 3, 50, 53], [0.0, 1.0, 1.0, 0.0])
    servo = ident.load(ARM / "servo_arm.urdf").with_drives("servo").drives["yaw"]
    for x in (triangle, waypoints, trapezoid):
        assert linear_samples(x) == 1
        assert not servo.goes_straight({"ref.yaw": x})
    lines = np.interp(k, k[::5], np.sin(k[::5] / 40))
    assert servo.goes_straight({"ref.yaw": lines})


def test_a_measured_torque_goes_before_a_drive_and_one_that_differs_is_named(log):
    mechanism = ident.load(ARM / "servo_arm.urdf").with_effect("coulomb")
    both = log
    for j in ("yaw", "shoulder", "elbow"):
        torque = (pl.col(f"ref.{j}") - pl.col(f"q.{j}")) * 10
        both = both.with_columns(torque.alias(f"tau.{j}"))
    driven = mechanism.with_drives("yaw:kp=10,kd=0,delay=0", "elbow:kp=3,kd=0,delay=0")
    fit = ident.identify(driven, ident.complete(driven, both))
    alone = ident.identify(mechanism, ident.complete(mechanism, both))
    named = [finding for finding in fit.findings if finding.code == "two torques"]
    assert [finding.where for finding in named] == [("tau.elbow",)]
    assert not fit.mechanism.drives
    assert fit.relative == pytest.approx(alone.relative)
