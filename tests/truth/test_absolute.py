"""The same mechanism with six coordinates a body."""

import numpy as np
import pinocchio as pin
import pytest

from helpers import J, tree_urdf, write_mechanism
from ident.errors import MechanismError
from ident.mechanism import load
from ident.mechanism.load import absolute

NAMES = ["arm", "four_bar", "five_bar", "slider_crank", "pendulum"]


@pytest.mark.parametrize("name", NAMES)
def test_same_freedom_bodies_and_names(name, robots):
    joint = load(robots / name)
    bodies = absolute(joint)
    assert bodies.model.nv == 6 * len(joint.bodies.links)
    assert bodies.degrees_of_freedom == joint.degrees_of_freedom
    np.testing.assert_allclose(bodies.prior, joint.prior, atol=1e-12)
    assert [j.name for j in bodies.joints] == [j.name for j in joint.joints]
    assert (bodies.driven, bodies.passive, bodies.unknown) == (
        joint.driven,
        joint.passive,
        joint.unknown,
    )
    assert not any(j.in_tree for j in bodies.joints)
    assert np.abs(bodies.kinematics.closure_rows(bodies.start[None]).value).max() < 1e-12
    first = joint.joints[0].name
    assert f"joint.{first}.rx" in bodies.kinematics.multipliers


@pytest.mark.parametrize("name", NAMES)
def test_own_coordinates_are_the_joints(name, robots):
    joint = load(robots / name)
    bodies = absolute(joint)
    rng = np.random.default_rng(1)
    q, v = rng.uniform(-1.5, 1.5, joint.model.nq), rng.normal(size=joint.model.nv)
    free, rates = lifted(joint, q, v)
    own = bodies.kinematics.own_rows(free[None], rates[None])
    for j in (j for j in joint.joints if j.in_tree):
        at = bodies.joint(j.name).index
        assert own.value[0, at] == pytest.approx(q[j.index], abs=1e-12)
        assert own.rate[0, at] @ rates == pytest.approx(v[j.index], abs=1e-12)
    tree = len([n for n in bodies.kinematics.multipliers if n.startswith("joint.")])
    rows = bodies.kinematics.closure_rows(free[None])
    assert np.abs(rows.value[0, :tree]).max() < 1e-12
    assert np.abs(rows.rate[0, :tree] @ rates).max() < 1e-12
    theirs = joint.kinematics.closure_rows(q[None]).value[0]
    np.testing.assert_allclose(rows.value[0, tree:], theirs, atol=1e-12)


def lifted(mechanism, q, v):
    """Free bodies' configuration and rates at joint coordinates, by Pinocchio."""
    data = mechanism.model.createData()
    pin.forwardKinematics(mechanism.model, data, q, v)
    bodies = range(1, mechanism.model.njoints)
    free = np.concatenate([pin.SE3ToXYZQUAT(data.oMi[i]) for i in bodies])
    return free, np.concatenate([data.v[i].vector for i in bodies])


def test_gears_beyond_half_a_turn_are_refused(tmp_path):
    mimic = '<mimic joint="a" multiplier="-2"/>'
    joint = load(
        write_mechanism(tmp_path, tree_urdf([J("a"), J("b", parent="a", inside=mimic)]), "")
    )
    with pytest.raises(MechanismError, match="half a turn"):
        absolute(joint)


def test_gears_and_effects_come_along(tmp_path):
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    mimic = limit + '<mimic joint="a" multiplier="-2" offset="0.3"/>'
    joints = [
        J("a", inside=limit),
        J("b", parent="a", inside=mimic),
        J("p", "prismatic", "1 1 0", "a"),
    ]
    toml = '[[effect]]\nkind = "viscous"\njoint = "p"\n'
    joint = load(write_mechanism(tmp_path, tree_urdf(joints), toml))
    bodies = absolute(joint)
    assert bodies.degrees_of_freedom == joint.degrees_of_freedom == 2
    assert bodies.effects == joint.effects
    assert "mimic.b.1" in bodies.kinematics.multipliers
    q, v = np.zeros((2, 3))
    for name, value in {"a": 0.2, "b": -0.1, "p": 0.1}.items():
        q[joint.joint(name).index] = value
    free, _ = lifted(joint, q, v)
    assert np.abs(bodies.kinematics.closure_rows(free[None]).value).max() < 1e-12
