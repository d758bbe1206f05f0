"""Commands, gains and motors that are not what a log or a file says: refused in one line, or said.

The log is the first six seconds of robots/servo_arm, with one thing wrong.
"""

import pickle
import shutil

import pytest

from helpers import ROBOTS

pl = pytest.importorskip("polars")

ARM = ROBOTS / "servo_arm"
JOINTS = ("yaw", "shoulder", "elbow")
SAMPLES = 1200


def constant(kind, value):
    """Columns of all joints at one value."""
    return [pl.lit(value).alias(f"{kind}.{joint}") for joint in JOINTS]


def duty(log):
    share = {f"duty.{joint}": pl.col(f"ref.{joint}") * 0.5 for joint in JOINTS}
    return log.with_columns(**share).drop(f"ref.{joint}" for joint in JOINTS)


def swapped(log):
    return log.rename({"ref.elbow": "x", "ref.yaw": "ref.elbow"}).rename({"x": "ref.yaw"})


LOGS = {  # what is wrong, and words of the line
    "a command in degrees": (
        lambda log: log.with_columns(pl.col("ref.elbow").degrees()),
        ("ref.elbow", "in degrees", "scale = 0.017453293"),
    ),
    "all in degrees": (
        lambda log: log.with_columns(pl.exclude("t").degrees()),
        ("q.yaw", "looks like degrees", "scale = 0.01745"),
    ),
    "commands of two joints exchanged": (
        swapped, ("ref.yaw", "not followed by q.yaw", "q.elbow", '[log] "ref.elbow" = "ref.yaw"'),
    ),
    "the command of another joint": (
        lambda log: log.with_columns(pl.col("ref.yaw").alias("ref.elbow")),
        ("ref.elbow", "the command of another joint"),
    ),
    "a command that never changes": (
        lambda log: log.with_columns(pl.lit(0.3).alias("ref.yaw")),
        ("ref.yaw is always 0.3", "log the command that it was sent"),
    ),
    "a command of the wrong sign": (
        lambda log: log.with_columns(-pl.col("ref.yaw")), ("ref.yaw", "scale = -1"),
    ),
    "a gain that one joint lacks": (
        lambda log: log.with_columns(pl.lit(400.0).alias("kp.yaw")),
        ("kp.yaw", "no 'kp.shoulder'", "for every drive"),
    ),
    "a gain of zero": (
        lambda log: log.with_columns(*constant("kp", 400.0), *constant("kd", 0.0)).with_columns(
            pl.lit(0.0).alias("kp.elbow")
        ),
        ("kp.elbow is 0 in all samples", "on.elbow"),
    ),
    "a gain of the wrong sign": (
        lambda log: log.with_columns(*constant("kp", -400.0)), ("kp.yaw reaches -400", "0 or more"),
    ),
    "a drive that is off throughout, bodies known": (
        lambda log: log.with_columns(*constant("on", 0)),
        ("off in all samples", "yaw, shoulder and elbow", "--drive yaw:kp=1"),
    ),
}  # fmt: skip
OPTIONS = {  # of --drive, with the log as it is
    "a gain of zero": ("elbow:kp=0", ("kp = 0", "above 0")),
    "a negative gain": ("elbow:kp=-14", ("kp = -14", "above 0")),
    "a gain without end": ("elbow:kp=inf", ("kp = inf", "finite")),
    "a delay of more than a tenth of the log": (
        "delay=0.9", ("delay = 0.9 s", "a tenth of the log's 6 s", "usually 0.001 to 0.05"),
    ),
    "a negative delay": ("elbow:delay=-0.01", ("delay = -0.01", "0 or more")),
    "a limit of zero": ("elbow:limit=0", ("limit = 0", "above 0")),
    "saturated throughout": (
        "elbow:kp=14,limit=1e-6", ("servo:elbow", "at its limit of 1e-06", "smaller motion"),
    ),
    "another joint": ("elbo:kp=14", ("no driven joint 'elbo'", "elbow")),
}  # fmt: skip


@pytest.fixture(scope="module")
def frame():
    return pl.read_csv(ARM / "run.csv").head(SAMPLES)


@pytest.fixture
def machine(tmp_path):
    for name in ("servo_arm.urdf", "mechanism.toml"):
        shutil.copy(ARM / name, tmp_path)
    return tmp_path


@pytest.fixture
def written(machine, frame):
    """`written(change)`: the path of the log, changed."""

    def write(change=lambda log: log):
        change(frame).write_csv(machine / "run.csv")
        return machine / "run.csv"

    return write


@pytest.mark.parametrize("what", LOGS)
def test_a_log_that_is_no_log_of_these_drives(what, machine, written, refused):
    change, words = LOGS[what]
    at = () if "off in all" in words[0] else ("run.csv",)  # that is of all logs
    refused((*at, *words), "identify", machine, written(change))


@pytest.mark.parametrize("what", OPTIONS)
def test_a_drive_that_cannot_be(what, machine, written, refused):
    option, words = OPTIONS[what]
    refused(words, "identify", machine, written(), "--drive", option)


def test_drives_that_cannot_be_in_a_file(machine, written, change, refused):
    change(machine / "mechanism.toml", "[drives]", "[drives]\nkp = -20.0")
    refused(("mechanism.toml", "kp = -20", "above 0"), "identify", machine, written())


def test_drives_that_are_off_throughout_and_no_known_body(machine, written, refused):
    log = written(lambda log: log.with_columns(*constant("on", 0)))
    words = ("run.csv", "off throughout", "no body is known", "[parameters] unknown")
    refused(words, "identify", machine / "servo_arm.urdf", log, "--drive", "servo")


@pytest.mark.parametrize("full", [100.0, 255.0])
def test_a_duty_beyond_one(full, machine, written, refused):
    log = written(lambda log: duty(log).with_columns(pl.col("duty.yaw") * full * 0.9))
    words = ("run.csv", "duty.yaw", "-1 to 1", "scale = 0.0")
    refused(words, "identify", machine / "servo_arm.urdf", log, "--drive", "duty")


def test_a_pickle_that_would_run_is_not_run(machine, refused):
    class Trap:
        def __reduce__(self):
            return open, (str(machine / "trapped"), "w")

    path = machine / "run.pt"
    path.write_bytes(pickle.dumps({"q.yaw": Trap()}))
    refused(("run.pt", "no ZIP"), "identify", machine, path)
    assert not (machine / "trapped").exists()


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ('m1 = "yaw"\nm2 = "shoulder + elbow"\nm3 = "2 * shoulder + 2 * elbow"', ("singular",)),
        ('m1 = "yaw + shoulder"\nm2 = "elbow"', ("yaw", "shoulder")),
    ],
)
def test_motors_that_leave_a_joint_without_torque(rows, words, machine, written, refused):
    (machine / "mechanism.toml").write_text(f'urdf = "servo_arm.urdf"\n[motors]\n{rows}\n')
    refused(("mechanism.toml", *words), "check", machine, written())


def test_a_late_clock_is_said(machine, written, done):
    """Positions 90 ms behind the commands: the delay ends at its bound, and that stands there."""
    late = {f"ref.{joint}": pl.col(f"ref.{joint}").shift(-18) for joint in JOINTS}
    log = written(lambda log: log.with_columns(**late).head(SAMPLES - 18))
    outcome = done("identify", machine, log, "--verbose")
    assert "at its bound of 0.05 s" in outcome.out + outcome.err
    assert "one clock" in outcome.out + outcome.err


def test_a_sensor_goes_before_a_drive_that_differs(machine, written, done):
    def sensed(log):
        torques = {
            f"tau.{joint}": kp * (pl.col(f"ref.{joint}") - pl.col(f"q.{joint}"))
            for joint, kp in zip(JOINTS, (20.0, 25.0, 14.0), strict=True)
        }
        return log.with_columns(**torques)

    given = ("yaw:kp=20,kd=0,delay=0", "shoulder:kp=25,kd=0,delay=0", "elbow:kp=4,kd=0,delay=0")
    options = [word for drive in given for word in ("--drive", drive)]
    outcome = done("identify", machine, written(sensed), *options, "--verbose")
    text = " ".join((outcome.out + outcome.err).split())
    assert "elbow: the log has tau.elbow, which is used, and servo:elbow would make another" in text
    assert "the log has tau.yaw" not in text
