"""Drives without a torque sensor, against planted values of MuJoCo's servos."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.assess.check import check_logs
from ident.errors import FitError, MechanismError, MotionError

pytest.importorskip("mujoco")
pl = pytest.importorskip("polars")

from servo_logs import Servos, servo_log  # noqa: E402

JOINTS = ("yaw", "shoulder", "elbow")
ARM = ROBOTS / "servo_arm"


@pytest.fixture(scope="module")
def shipped():
    mechanism = ident.load(ARM).with_calibration("exact")  # its sensors are those of a simulator
    return ident.identify(mechanism, ident.complete(mechanism, ARM / "run.csv"))


def errors(fit, stem, name, truth):
    """Relative error and error over standard error (3,)."""
    values = {p.name: p for effect in fit.effects for p in effect.parameters}
    rows = [values[f"{stem}.{joint}.{name}"] for joint in JOINTS]
    off = np.array([row.value for row in rows]) - truth
    return off / truth, off / np.array([row.stderr for row in rows])


def test_servo_gains_friction_and_rotors_of_the_shipped_log(shipped):
    truth = Servos()
    damping = np.array(truth.kd) + truth.Fv  # one column: what the log determines is the sum
    for stem, name, planted, most in (
        ("servo", "kp", truth.kp, 0.01), ("servo", "kd", damping, 0.01),
        ("coulomb", "Fc", truth.Fc, 0.01), ("rotor_inertia", "Ia", truth.Ia, 0.02),
    ):  # fmt: skip
        relative, standard = errors(shipped, stem, name, np.array(planted))
        assert np.abs(relative).max() < most, (name, relative)
        assert np.abs(standard).max() < 4, (name, standard)
    assert shipped.point.values["command_delay.yaw,shoulder,elbow.d"] == pytest.approx(
        truth.delay, abs=2e-4
    )
    assert max(shipped.relative.values()) < 0.02


def test_one_known_gain_gives_the_scale_of_all():
    mechanism = ident.load(ARM).with_calibration("exact")
    bodies = mechanism.bodies.select(["turret", "upper_arm", "forearm"], "test")
    unknown = replace(mechanism, unknown=bodies)
    motion = ident.complete(unknown, ARM / "run.csv")
    with pytest.raises(FitError, match="scale"):
        ident.identify(unknown, motion)
    effects = [e for e in unknown.effects if e.label != "servo:elbow"]
    known = replace(unknown, effects=tuple(effects)).with_effect("servo:elbow", {"kp": 14.0})
    fit = ident.identify(known, motion)
    values = {p.name: p for effect in fit.effects for p in effect.parameters}
    shoulder = values["servo.shoulder.kp"]
    assert abs(shoulder.value - 25.0) < 3 * shoulder.stderr < 5.0


def test_a_drive_that_is_off_has_no_torque():
    truth = Servos()
    log = pl.DataFrame(servo_log(truth, seed=3, seconds=12.0, off=(5.0, 6.0)))
    mechanism = ident.load(ARM).with_calibration("exact").with_effect("viscous")
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    values = {p.name: p for effect in fit.effects for p in effect.parameters}
    # with the drive off its damping and the friction of the joint are two things
    for joint, kd, Fv in zip(JOINTS, truth.kd, truth.Fv, strict=True):
        a, b = values[f"servo.{joint}.kd"], values[f"viscous.{joint}.Fv"]
        assert a.value + b.value == pytest.approx(kd + Fv, rel=0.1)


def test_files_and_options_say_the_same(tmp_path):
    shutil.copy(ARM / "servo_arm.urdf", tmp_path)
    (tmp_path / "mechanism.toml").write_text(
        'urdf = "servo_arm.urdf"\n[drives]\nkp = 20.0\n[drives.elbow]\nkp = 14.0\ndelay = 0.008\n'
        "limit = 3.0\n"
    )
    labels = {effect.label: effect for effect in ident.load(tmp_path).effects}
    assert labels["servo:yaw"].values == {"kp": 20.0}
    assert labels["servo:elbow"].values == {"kp": 14.0, "delay": 0.008, "limit": 3.0}
    assert labels["command_delay:yaw,shoulder"].joints == ("yaw", "shoulder")
    bare = ident.load(tmp_path / "servo_arm.urdf")
    option = bare.with_drives("kp=20", "elbow:kp=14,delay=0.008,limit=3")
    assert [e.label for e in option.effects] == [*labels]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("elbo:kp=1", "elbow"), ("elbow:kp=0", "above 0"), ("elbow:kp=-3", "above 0"),
        ("elbow:delay=-0.1", "0 or more"), ("elbow:stiffness=3", "kp"), ("elbow:kp=soft", "number"),
        ("elbow:follows=both", "velocity"),
    ],
)  # fmt: skip
def test_bad_drives_are_refused_with_what_is_valid(text, word):
    with pytest.raises(MechanismError, match=word):
        ident.load(ARM / "servo_arm.urdf").with_drives(text)


def test_a_log_without_the_command_names_the_column():
    log = pl.read_csv(ARM / "run.csv").rename({"ref.elbow": "elbow_command"})
    with pytest.raises(MotionError, match=r"ref\.elbow"):
        ident.complete(ident.load(ARM), log)


def test_a_log_without_torques_is_told_of_drives():
    with pytest.raises(MotionError, match="--drive servo"):
        ident.complete(ident.load(ARM / "servo_arm.urdf"), ARM / "run.csv")


def test_check_says_what_gives_each_drive_its_scale():
    folder = ident.load(ARM)
    motion = ident.complete(folder, ARM / "run.csv")
    of = {check.joint: check for check in check_logs(folder, motion).drives}
    assert of["elbow"].scale == "by known bodies: forearm"
    assert 0 < of["elbow"].error < 0.01
    assert any("kd and viscous friction are one number" in words for words in of["yaw"].apart)
    unknown = ident.load(ARM / "servo_arm.urdf")
    checks = check_logs(unknown.with_drives("servo"), motion)
    assert not any(check.known for check in checks.drives)
    assert "--drive yaw:kp=" in checks.problems[0]
    given = check_logs(unknown.with_drives("servo", "elbow:kp=14"), motion).drives
    assert [check.known for check in given] == [True] * 3
    assert "given kp of elbow" in given[0].scale


def one_known(known):
    mechanism = ident.load(ARM)
    others = [link for link in mechanism.bodies.links if link != known]
    return replace(mechanism, unknown=mechanism.bodies.select(others, "test"))


def test_a_scale_that_the_known_body_does_not_support_is_refused():
    unknown = one_known("turret")
    with pytest.raises(FitError, match="scale"):
        ident.identify(unknown, ident.complete(unknown, ARM / "run.csv"))


def test_a_body_in_the_middle_gives_a_scale_within_its_error():
    unknown = one_known("upper_arm")
    fit = ident.identify(unknown, ident.complete(unknown, ARM / "run.csv"))
    values = {p.name: p for effect in fit.effects for p in effect.parameters}
    for joint, kp in zip(("yaw", "shoulder", "elbow"), (20.0, 25.0, 14.0), strict=True):
        p = values[f"servo.{joint}.kp"]
        assert abs(p.value - kp) < 2 * p.stderr < 0.5 * kp


def test_commands_are_played_with_delay_hold_and_law(shipped):
    # held-out commands: the loop is closed over the simulated motion, from its measured start
    motion = ident.complete(shipped.mechanism, ARM / "other.csv")
    played = ident.replay(shipped, motion=motion, most=6)
    errors = next(iter(played.runs.values()))[0].errors
    assert max(error.rms for error in errors.values()) < 2e-4  # [rad]; 1.1e-4 is the encoder's
    assert set(shipped.command_errors) == {*JOINTS}
    assert all(0 < e.rms < 1e-3 and e.unit == "rad" for e in shipped.command_errors.values())


def test_a_simulated_log_of_drives_gives_its_gains_back(shipped, tmp_path):
    run = ident.integrate(
        shipped.mechanism, ident.Torques(ARM / "other.csv"), values=shipped.point.values,
        pi=shipped.point.pi, duration=5.0, tolerance=1e-6, columns=["q"],
    )  # fmt: skip
    assert not any(name.startswith("tau.") for name in run.log.columns)
    fit = ident.identify(shipped.mechanism, ident.complete(shipped.mechanism, run.log))
    for joint in JOINTS:
        name = f"servo.{joint}.kp"
        assert fit.point.values[name] == pytest.approx(shipped.point.values[name], rel=0.02)


def test_a_delay_at_its_bound_is_said():
    truth = replace(Servos(), delay=0.0)
    columns = servo_log(truth, seed=4, seconds=10.0)
    late = round(0.08 * 200)  # of a clock of its own
    for joint in JOINTS:
        ref = columns[f"ref.{joint}"]
        columns[f"ref.{joint}"] = np.concatenate([ref[late:], np.full(late, ref[-1])])
    mechanism = ident.load(ARM).with_calibration("exact")
    fit = ident.identify(mechanism, ident.complete(mechanism, pl.DataFrame(columns)))
    assert [f.threshold for f in fit.findings if f.code == "delay at its bound"] == [0.05]


@pytest.mark.parametrize("text", ["elbow:kp=14", "elbow:limit=3", "elbow:delay=0.01", "kp=10"])
def test_an_option_takes_the_place_of_a_drive_of_the_file(text):
    mechanism = ident.load(ARM).with_drives(text)
    of, key = text.rpartition(":")[2], text.rpartition(":")[2].partition("=")[0]
    assert mechanism.drives["elbow"].kind == "servo"
    assert mechanism.drives["elbow"].values == {key: float(of.partition("=")[2])}
    assert mechanism.drives["yaw"].values == ({} if text.startswith("elbow") else {"kp": 10.0})


def test_an_option_for_one_drive_keeps_the_known_delay_of_the_others():
    mechanism = ident.load(ARM)
    known = [
        replace(effect, values={"d": 0.008}) if effect.through_drives else effect
        for effect in mechanism.effects
    ]
    changed = replace(mechanism, effects=tuple(known)).with_drives("elbow:kp=14")
    assert {joint: drive.values for joint, drive in changed.drives.items()} == {
        "yaw": {"delay": 0.008}, "shoulder": {"delay": 0.008}, "elbow": {"kp": 14.0}
    }  # fmt: skip
    (late,) = (effect for effect in changed.effects if effect.through_drives)
    assert late.joints == ("elbow",)
    assert not late.values
