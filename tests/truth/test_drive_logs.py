"""Logs of drives that lead a fit astray: names, gains, sensors of some logs, joints held still."""

from dataclasses import replace

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.assess.check import check_logs
from ident.effects.servo import HOLD
from ident.errors import FitError, MotionError
from ident.fit.drives import with_sensors_first
from ident.mechanism.causes import causes_of

pl = pytest.importorskip("polars")

JOINTS = ("yaw", "shoulder", "elbow")
ARM = ROBOTS / "servo_arm"
GAINS = {"yaw": (20.0, 0.4), "shoulder": (25.0, 0.5), "elbow": (14.0, 0.25)}  # kp, kd, planted
LATE = 0.0105  # [s] delay of the planted drives, and half a sample of their hold


@pytest.fixture(scope="module")
def mechanism():
    return ident.load(ARM).with_calibration("exact")  # its sensors are those of a simulator


@pytest.fixture(scope="module")
def log():
    return pl.read_csv(ARM / "run.csv").head(2000)


def test_a_column_called_hold_moves_no_command(mechanism, log):
    (e,) = ident.complete(mechanism, log.with_columns(hold=pl.lit(1.0))).experiments
    assert np.all(e.extra["hold"] == 1.0)
    assert e.extra[HOLD + "yaw"] == pytest.approx(0.005)


@pytest.fixture(scope="module")
def torques(mechanism, log):
    """Torques (n,) that the planted drives made, by joint."""
    (e,) = ident.complete(mechanism, log).experiments
    made = {}
    for joint, (kp, kd) in GAINS.items():
        at = mechanism.joint_index[joint]
        ref = np.interp(e.t - LATE, log["t"], log[f"ref.{joint}"])
        made[joint] = kp * (ref - log[f"q.{joint}"].to_numpy()) - kd * e.yd[:, at]
    return made


def sensed(log, torques, *joints):
    return log.with_columns(**{f"tau.{joint}": torques[joint] for joint in joints})


def compared(mechanism, log):
    return with_sensors_first(mechanism, ident.complete(mechanism, log))[1]


@pytest.mark.parametrize("late", [0.0, 0.012])
def test_a_late_drive_beside_its_sensor_is_not_accused(mechanism, log, torques, late):
    # the commands are logged earlier: the bus is late by 8 ms and by 20 ms
    for joint in JOINTS:
        ref = np.interp(log["t"] + late, log["t"], log[f"ref.{joint}"])
        log = log.with_columns(**{f"ref.{joint}": ref})
    assert compared(mechanism, sensed(log, torques, *JOINTS)) == ()


def test_a_drive_at_its_limit_beside_its_sensor_is_not_accused(log, torques):
    limit = 0.4 * np.abs(torques["shoulder"]).max()
    clipped = {"shoulder": np.clip(torques["shoulder"], -limit, limit)}
    bare = ident.load(ARM / "servo_arm.urdf")
    log = sensed(log, clipped, "shoulder")
    limited = bare.with_drives("servo", f"shoulder:limit={limit}")
    assert compared(limited, log) == ()
    (finding,) = compared(bare.with_drives("servo"), log)  # without the limit the law is another
    assert (finding.code, finding.where) == ("two torques", ("tau.shoulder",))


def test_torques_that_only_some_logs_have_are_refused(mechanism, log, torques):
    motion = ident.complete(mechanism, [sensed(log, torques, "elbow"), log])
    with pytest.raises(FitError, match=r"tau\.elbow.* has none"):
        ident.identify(mechanism, motion)
    alone = ident.complete(mechanism, log)
    validate = ident.complete(mechanism, sensed(log, torques, "elbow"))
    with pytest.raises(FitError, match=r"tau\.elbow.* has none"):
        ident.identify(mechanism, alone, validate=validate)


def test_check_states_no_scale_of_a_drive_whose_torque_is_measured(mechanism, log, torques):
    motion = ident.complete(mechanism, sensed(log, torques, "elbow"))
    assert [check.joint for check in check_logs(mechanism, motion).drives] == ["yaw", "shoulder"]


def test_errors_of_commands_are_over_the_gain_of_the_firmware(mechanism, log):
    plain = ident.identify(mechanism, ident.complete(mechanism, log))
    gains = {f"kp.{joint}": pl.lit(20.0) for joint in JOINTS}
    scaled = ident.identify(mechanism, ident.complete(mechanism, log.with_columns(**gains)))
    for joint in JOINTS:
        kp = scaled.point.values[f"servo.{joint}.kp"]
        assert 20 * kp == pytest.approx(plain.point.values[f"servo.{joint}.kp"], rel=1e-3)
        expected = plain.command_errors[joint].rms
        assert scaled.command_errors[joint].rms == pytest.approx(expected, rel=1e-3)


def test_errors_of_commands_follow_a_gain_that_changes_between_logs(mechanism):
    pytest.importorskip("mujoco")
    from servo_logs import Servos, servo_log

    def one(seed, gain):
        truth = replace(Servos(), kp=tuple(gain * kp for kp in Servos().kp))
        columns = servo_log(truth, seed=seed, seconds=6.0)
        gains = {f"kp.{joint}": np.full(len(columns["t"]), gain) for joint in JOINTS}
        return pl.DataFrame(columns | gains)

    soft, stiff = one(1, 1.0), one(2, 3.0)
    both, *alone = (
        ident.identify(mechanism, ident.complete(mechanism, logs)).command_errors["elbow"].rms
        for logs in ([soft, stiff], soft, stiff)
    )
    assert 0.9 * min(alone) < both < 1.3 * max(alone)


def test_a_joint_that_is_held_still_leaves_the_others_to_be_identified(mechanism):
    pytest.importorskip("mujoco")
    from servo_logs import Servos, servo_log

    log = pl.DataFrame(servo_log(seed=5, seconds=8.0, held=(0,)))
    motion = ident.complete(mechanism, log)
    assert any("ref.yaw never changes" in note for note in motion.notes)
    fit = ident.identify(mechanism, motion)
    for joint, kp in zip(JOINTS[1:], Servos().kp[1:], strict=True):
        assert fit.point.values[f"servo.{joint}.kp"] == pytest.approx(kp, rel=0.01)
    assert [f.where for f in fit.findings if f.code == "held joint"] == [("yaw",)]
    assert "servo.yaw.kp" not in fit.point.values
    of = {check.joint: check for check in check_logs(mechanism, motion).drives}
    assert [of[joint].known for joint in JOINTS] == [False, True, True]
    assert "holds its joint still" in of["yaw"].scale


def test_commands_of_which_none_changes_are_refused(mechanism, log):
    still = {f"ref.{joint}": pl.lit(0.3) for joint in JOINTS}
    with pytest.raises(MotionError, match="never changes"):
        ident.complete(mechanism, log.with_columns(**still))


def test_a_model_of_drives_is_compared_with_torques_that_were_measured(mechanism, log, torques):
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    (e,) = fit.motion.experiments
    rate = e.yd[:, mechanism.joint_index["elbow"]]
    viscous = 0.06  # [N m s/rad] which the fit has in kd
    torques = {**torques, "elbow": torques["elbow"] - viscous * rate}
    same = {"cutoff": fit.motion.band.cutoff, "smoothing": e.smooth.spacing}
    alike = ident.complete(mechanism, sensed(log, torques, "elbow"), **same)
    plain, beside = (ident.compare(fit, motion=m) for m in (fit.motion, alike))
    assert beside.findings == {}
    ((name, residual),) = beside.residuals.items()
    tau = residual.predictions[0].measured[:, 2]
    assert np.allclose(tau, torques["elbow"], atol=1e-12)  # not what the drive makes of the command
    for joint in ("yaw", "shoulder"):  # with the delay that they had in common with the elbow
        assert beside.errors[name][joint].rms == pytest.approx(
            next(iter(plain.errors.values()))[joint].rms, rel=0.2
        )
    other = {**torques, "elbow": 1.3 * torques["elbow"]}
    differing = ident.compare(fit, motion=ident.complete(mechanism, sensed(log, other, "elbow")))
    (finding,) = differing.findings[name]
    assert (finding.code, finding.where) == ("two torques", ("tau.elbow",))
    assert "which is used" not in str(plain)
    assert "tau.elbow, which is used" in str(differing)


def test_what_cannot_be_negative_is_held_at_zero(mechanism, log):
    # of friction against the motion nothing shows in a log of drives that push
    way = {joint: pl.col(f"q.{joint}").diff().fill_null(0).sign() for joint in JOINTS}
    pushed = log.with_columns(**{
        f"ref.{joint}": pl.col(f"ref.{joint}") - 0.02 * way[joint] for joint in JOINTS
    })  # fmt: skip
    fit = ident.identify(mechanism, ident.complete(mechanism, pushed))
    (finding,) = (x for x in fit.findings if x.code == "held at zero")
    assert {*finding.where} >= {"coulomb.yaw.Fc", "coulomb.shoulder.Fc"}
    for effect in fit.effects:
        for p, unknown in zip(effect.parameters, effect.effect.parameters, strict=True):
            assert p.value >= 0 or not unknown.nonnegative or p.value > -2 * p.stderr


def test_drives_that_seem_to_be_early_are_taken_to_follow_at_once(mechanism, log):
    late = {f"ref.{joint}": pl.col(f"ref.{joint}").shift(4, fill_value=0.0) for joint in JOINTS}
    motion = ident.complete(mechanism, log.with_columns(**late)[10:])  # 20 ms; they follow by 8
    fit = ident.identify(mechanism, motion)
    (finding,) = (x for x in fit.findings if x.code == "delay at its bound")
    assert "before the command" in str(finding)
    assert not any(name.startswith("command_delay") for name in fit.point.values)


def narrow(fit):
    return [finding for finding in fit.findings if finding.code == "narrow intervals"]


def test_rows_of_servos_end_where_servos_follow(mechanism, log):
    # M about 0.03 kg m² at the elbow, whose servo is the fastest: √(kp / M) / 2π = 3.4 to 4.9 Hz
    motion = ident.complete(mechanism, log)
    assert 3.0 < motion.band.cutoff < 6.0
    assert not narrow(ident.identify(mechanism, motion))
    fast = log.with_columns(**{  # a command that reaches 8 Hz shows what there is at 8 Hz
        f"ref.{joint}": pl.col(f"ref.{joint}") + 0.1 * (50 * pl.col("t")).sin() for joint in JOINTS
    })  # fmt: skip
    assert ident.complete(mechanism, fast).band.cutoff > 1.5 * motion.band.cutoff
    sensors = log.with_columns(**{f"tau.{joint}": pl.col(f"ref.{joint}") for joint in JOINTS})
    assert ident.complete(mechanism, sensors).band.cutoff > 1.5 * motion.band.cutoff


def test_a_fit_says_which_intervals_of_drives_are_narrow(mechanism, log):
    fit = ident.identify(mechanism, ident.complete(mechanism, log, cutoff=12.0))
    (finding,) = narrow(fit)
    of = {
        *(f"servo.{joint}.kd" for joint in JOINTS),
        *(f"rotor_inertia.{joint}.Ia" for joint in JOINTS),
    }
    assert {*finding.where} == {*of, "command_delay.yaw,shoulder,elbow.d"}
    frictionless = [e for e in mechanism.effects if not e.jumps]
    smooth = replace(mechanism, effects=tuple(frictionless))
    assert not narrow(ident.identify(smooth, ident.complete(smooth, log, cutoff=12.0)))


def test_a_position_has_no_lateness_beside_the_delay_of_its_drive(mechanism, log):
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    causes = causes_of(mechanism, mechanism.driven, 500.0)
    assert not any(cause.kind == "lateness" for cause in causes)
    (delay,) = (v for e in fit.effects for v in e.parameters if e.effect.kind == "command_delay")
    assert delay.value == pytest.approx(0.008, abs=5e-4)  # as it is without errors of calibration
