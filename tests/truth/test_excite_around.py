"""Motions around a logged one: home in its middle, and what the URDF lacks from it."""

import numpy as np

import ident
from ident.diagnosis.law_search import inverse_root, solved
from ident.excite.around import around_motion
from ident.excite.limits import Limits
from identification import ROBOTS


def test_home_is_a_configuration_of_the_log_in_its_middle():
    mechanism = ident.load(ROBOTS / "five_bar")
    motion = ident.complete(mechanism, ident.read_log(ROBOTS / "five_bar" / "run.csv"))
    around, limits = around_motion(mechanism, Limits(), motion)
    (e,) = motion.experiments
    y = e.y[e.usable]
    assert np.abs(around.kinematics.closure_rows(around.start[None]).value).max() < 1e-6
    nearest = np.abs(e.q - around.start).max(axis=1).argmin()
    middle = 0.5 * (y.max(axis=0) + y.min(axis=0))
    assert (np.abs(e.y[nearest] - middle) < 0.5 * np.ptp(y, axis=0)).all()
    for name, (low, high) in limits.range.items():
        i = mechanism.joint_index[name]
        assert y[:, i].min() <= low < high <= y[:, i].max()


def test_a_given_range_and_speed_stay():
    mechanism = ident.load(ROBOTS / "arm")
    motion = ident.complete(mechanism, ident.read_log(ROBOTS / "arm" / "run.csv"))
    given = Limits(range={"yaw": (-0.1, 0.1)}, speed=0.5)
    _, limits = around_motion(mechanism, given, motion)
    assert limits.range["yaw"] == (-0.1, 0.1)
    assert limits.speed == 0.5


def test_no_variance_is_negative_where_normal_equations_are_not_definite():
    """Rounding of another processor may leave an eigenvalue below zero."""
    V, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((4, 4)))
    S = V @ np.diag([3.0, 1.0, 0.2, -1e-15]) @ V.T
    F = inverse_root(S)
    np.testing.assert_allclose(S @ F @ F.T @ S, S, atol=1e-12)
    np.testing.assert_allclose(S @ solved(S, S @ np.ones(4)), S @ np.ones(4), atol=1e-12)


def test_as_logged_other_joints_keep_range_and_speed_of_the_log():
    mechanism = ident.load(ROBOTS / "arm")
    motion = ident.complete(mechanism, ident.read_log(ROBOTS / "arm" / "run.csv"))
    given = Limits(range={"yaw": (-0.1, 0.1)}, speed={"yaw": 0.5})
    _, limits = around_motion(mechanism, given, motion, as_logged=True)
    (e,) = motion.experiments
    i = mechanism.joint_index["elbow"]
    low, high = limits.range["elbow"]
    assert e.y[e.usable, i].min() <= low < high <= e.y[e.usable, i].max()
    assert limits.speed["elbow"] == np.abs(e.yd[e.usable, i]).max()
    assert (limits.range["yaw"], limits.speed["yaw"]) == ((-0.1, 0.1), 0.5)
