"""A motion that is planned for servos has the commands with which they make it."""

import numpy as np
import pytest
from servo_logs import Servos
from test_command_hold import JOINTS, arm, values

import ident
from ident.excite import Limits, excite

pytest.importorskip("mujoco")
TRUTH = Servos(delay=0.006)


def planned(*drives, **options):
    limits = Limits(speed=1.5, torque=options.pop("torque", None))
    return excite(
        arm(*drives), duration=6.0, periods=1, rate=200.0, harmonics=3, tries=1, limits=limits,
        **options,
    )  # fmt: skip


@pytest.fixture(scope="module")
def gains():
    both = zip(JOINTS, TRUTH.kp, TRUTH.kd, strict=True)
    return [f"{joint}:kp={kp},kd={kd},delay=0.006,limit=30" for joint, kp, kd in both]


@pytest.fixture(scope="module")
def plan(gains):
    return planned(*gains, values=values())


def test_the_commands_make_the_motion(plan, gains):
    log = plan.log
    start = {f"v.{joint}": float(log.columns[f"v.{joint}"][0]) for joint in JOINTS}
    start |= {f"q.{joint}": float(log.columns[f"q.{joint}"][0]) for joint in JOINTS}
    commands = {name: x for name, x in log.columns.items() if not name.startswith("tau.")}
    played = ident.Torques(ident.Log.from_arrays("plan", log.t, commands))
    run = ident.integrate(arm(*gains), played, values=values(), tolerance=1e-6)
    for i, joint in enumerate(JOINTS):
        wanted = np.interp(run.t, log.t, log.columns[f"q.{joint}"])
        assert np.ptp(wanted) > 0.2
        assert np.sqrt(np.mean((run.y[:, i] - wanted) ** 2)) < 0.02 * np.ptp(wanted)


def test_torques_keep_within_the_drive_s_limit(gains):
    tight = [text.replace("limit=30", "limit=7") for text in gains]
    log = planned(*tight, values=values()).log
    for joint in JOINTS:
        assert np.abs(log.columns[f"tau.{joint}"]).max() <= 7.0


def test_without_gains_no_command_is_planned():
    plan = planned("yaw:kp=20,kd=0.4", "servo")
    assert "ref.yaw" in plan.log.columns
    assert "ref.elbow" not in plan.log.columns
    assert any("no command is planned for shoulder and elbow" in note for note in plan.notes)
