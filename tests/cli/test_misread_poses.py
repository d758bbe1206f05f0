"""Poses, rates and clocks of a floating base that were written in another way than is asked."""

import numpy as np
import pinocchio as pin
import pytest
from tests.truth.test_floating import flight, urdf

from ident.errors import MotionError
from ident.log import Log, read_log
from ident.mechanism.load import load
from ident.motion import complete
from ident.motion.body_rates import check_angular, check_linear

QUATERNION = ("base.qx", "base.qy", "base.qz", "base.qw")


def orientation(columns):
    return np.array(
        [
            pin.Quaternion(*row[[3, 0, 1, 2]]).toRotationMatrix()
            for row in np.stack([columns[name] for name in QUATERNION], axis=1)
        ]
    )


def scalar_first(columns, rates):
    first = [columns[name] for name in ("base.qw", "base.qx", "base.qy", "base.qz")]
    return columns | dict(zip(QUATERNION, first, strict=True))


def inverse(columns, rates):
    return columns | {name: -columns[name] for name in QUATERNION[:3]}


def downward(columns, rates):
    """North, east, down: of the world alone."""
    turn = pin.Quaternion(np.diag([1.0, -1.0, -1.0]))
    quaternion = [
        (turn * pin.Quaternion(*row[[3, 0, 1, 2]])).coeffs()
        for row in np.stack([columns[name] for name in QUATERNION], axis=1)
    ]
    turned = dict(zip(QUATERNION, np.array(quaternion).T, strict=True))
    return columns | turned | {f"base.{x}": -columns[f"base.{x}"] for x in "yz"}


def late(columns, rates):
    poses = {f"base.{x}" for x in "xyz"} | {*QUATERNION}
    return {name: x[:-20] if name in poses else x[20:] for name, x in columns.items()}


def velocities_of_the_world(columns, rates):
    v = np.stack([rates[f"base.v{x}"] for x in "xyz"], axis=1)
    v = np.einsum("nij,nj->ni", orientation(columns), v)
    return columns | {f"base.v{x}": v[:, i] for i, x in enumerate("xyz")}


def turning_of_the_world(columns, rates):
    w = np.stack([rates[f"base.w{x}"] for x in "xyz"], axis=1)
    w = np.einsum("nij,nj->ni", orientation(columns), w)
    return columns | {f"base.w{x}": w[:, i] for i, x in enumerate("xyz")}


def jumping(columns, rates):
    """From 3 s on by half a turn about x."""
    x, y, z, w = (columns[name] for name in QUATERNION)
    after = np.arange(len(x)) >= 300
    turned = (np.where(after, a, b) for a, b in ((w, x), (-z, y), (y, z), (-x, w)))
    return columns | dict(zip(QUATERNION, turned, strict=True))


def long(columns, rates):
    return columns | {name: 1.02 * columns[name] for name in QUATERNION}


CASES = [
    (scalar_first, ("order w x y z", "qw", "'base'")),
    (inverse, ("signs of qx qy qz",)),
    (downward, ("gravity = [0, 0, 9.81]",)),
    (late, ("behind the forces", "clock", "0.2 s")),
    (velocities_of_the_world, ("base.vx", "in the world's", "axes of the body")),
    (turning_of_the_world, ("base.wx", "in the world's", "axes of the body")),
    (jumping, ("jumps", "t = 3 s")),
    (long, ("length 1.02", "length 1")),
]


@pytest.fixture(scope="module")
def flown():
    return flight()


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "flyer.urdf").write_text(urdf())
    (tmp_path / "mechanism.toml").write_text('urdf = "flyer.urdf"\nbase = { kind = "floating" }\n')
    return tmp_path


@pytest.mark.parametrize(("change", "words"), CASES, ids=[c.__name__ for c, _ in CASES])
def test_a_misread_pose_is_refused_in_one_line(change, words, flown, folder, refused):
    t, columns, rates = flown
    columns = change(columns, rates)
    n = len(next(iter(columns.values())))
    rows = np.column_stack([t[:n], *columns.values()])
    header = ",".join(["t", *columns])
    np.savetxt(folder / "run.csv", rows, delimiter=",", header=header, comments="")
    refused(("run.csv", *words), "identify", folder, folder / "run.csv")


def test_a_pose_as_asked_is_taken_with_its_rates(flown, folder):
    t, columns, rates = flown
    complete(load(folder), Log.from_arrays("f", t, columns | rates))


def test_unknown_thrusts_tell_the_order_too(robots):
    """Of forces up to their factors."""
    folder = robots / "quadrotor"
    log = read_log(folder / "run.csv")
    complete(load(folder), log)
    with pytest.raises(MotionError, match="order w x y z"):
        complete(load(folder), Log.from_arrays("f", log.t, scalar_first(dict(log.columns), {})))


def test_rates_of_a_log_that_is_shorter_than_the_steps_of_its_pose_are_not_judged():
    t = 1e-3 * np.arange(60)
    p, R = np.outer(t, [1.0, 2.0, 3.0]), np.tile(np.eye(3), (60, 1, 1))
    check_linear("log", t, p, R, np.zeros((60, 3)))
    check_angular("log", t, R, np.ones((60, 3)))
