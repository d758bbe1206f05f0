"""A fit whose drives' commands cannot be played is told, with the reason."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from test_command_hold import fit_of_servos

from ident.errors import FitError
from ident.simulate.replay import replay, unplayable

pytest.importorskip("polars")
pytest.importorskip("mujoco")


@pytest.fixture(scope="module")
def fit():
    return fit_of_servos(6300, 6.0)


def with_value(fit, name, value):
    point = fit.point.with_values({name: value})
    return SimpleNamespace(mechanism=fit.mechanism, point=point, motion=fit.motion)


def test_a_good_fit_is_played(fit):
    assert unplayable(fit) == ""


def test_an_inertia_that_is_none(fit):
    assert "mass matrix" in unplayable(with_value(fit, "rotor_inertia.elbow.Ia", -1.0))


def test_friction_that_drives(fit):
    assert "drive the joint" in unplayable(with_value(fit, "coulomb.elbow.Fc", -0.2))


def test_measured_torques_are_not_played(fit):
    other = with_value(fit, "rotor_inertia.elbow.Ia", -1.0)
    other.mechanism = replace(fit.mechanism, effects=())
    assert unplayable(other) == ""


def test_poses_at_rest_are_not_played(fit):
    (e,) = fit.motion.experiments
    poses = replace(e, poses=True)
    bad = with_value(fit, "rotor_inertia.elbow.Ia", -1.0)
    bad.motion = replace(fit.motion, experiments=(poses,))
    assert unplayable(bad) == ""
    bad.motion = replace(fit.motion, experiments=(poses, e))  # the other log is
    assert "mass matrix" in unplayable(bad)
    with pytest.raises(FitError, match="poses at rest"):
        replay(fit, motion=bad.motion)
