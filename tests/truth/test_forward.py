"""Forward kinematics in CasADi against Pinocchio's own reading of the same URDF."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from helpers import J, along, raw_configuration, tree_urdf, write_mechanism
from ident.mechanism import load
from ident.mechanism.closures import placements, rates
from ident.mechanism.description import align_z, is_rotational, joint_axis
from ident.mechanism.load import absolute

TREES = {
    "revolute": [J("a", axis="1 0 0"), J("b", axis="0 1 0", parent="a"), J("c", parent="b")],
    "negative axes": [
        J("a", axis="-1 0 0"),
        J("b", axis="0 -1 0", parent="a"),
        J("c", "prismatic", "0 0 -1", "b"),
    ],
    "oblique": [J("a", axis="1 2 3"), J("b", axis="0.3 -0.2 1", parent="a")],
    "default axis": [J("a", axis=None), J("b", "prismatic", None, "a")],
    "continuous": [J("a", "continuous", "0 1 0"), J("b", "continuous", "1 -1 2", "a")],
    "prismatic": [J("a", "prismatic", "0 1 0"), J("b", "prismatic", "2 1 -1", "a")],
    "fixed between": [J("a"), J("f", "fixed", None, "a"), J("b", "prismatic", "1 1 0", "f")],
    "branches": [
        J("trunk"),
        J("z", axis="1 0 0", parent="trunk"),
        J("b", "prismatic", "0 1 1", "trunk"),
    ],
    "mimic": [
        J("a"),
        J("b", axis="1 1 0", parent="a", inside='<mimic joint="a" multiplier="-2" offset="0.3"/>'),
    ],
}


def evaluate(model, q):
    """World placements (njoints, 3, 4) of all joints, from the CasADi expressions."""
    symbol = ca.SX.sym("q", model.nq)
    stacked = ca.horzcat(*(ca.horzcat(M.R, M.p) for M in placements(model, symbol)))
    values = ca.Function("f", [symbol], [stacked])(q).full()
    return values.reshape(3, model.njoints, 4).transpose(1, 0, 2)


@pytest.mark.parametrize("name", TREES)
def test_links_stand_where_pinocchio_puts_them(name, tmp_path):
    urdf = tree_urdf(TREES[name], seed=len(name))
    mechanism = load(write_mechanism(tmp_path, urdf))
    raw = pin.buildModelFromXML(urdf)
    rng = np.random.default_rng(1)
    for _ in range(5):
        q = rng.uniform(-7, 7, mechanism.model.nq)
        theirs = raw_configuration(raw, {j.name: q[j.index] for j in mechanism.joints})
        data = raw.createData()
        pin.framesForwardKinematics(raw, data, theirs)
        found = evaluate(mechanism.model, q)
        for index, link in enumerate(mechanism.bodies.links, start=1):
            M = data.oMf[raw.getFrameId(link, pin.FrameType.BODY)]
            np.testing.assert_allclose(found[index], M.homogeneous[:3], atol=1e-12)


def test_free_bodies_stand_where_pinocchio_puts_them(robots):
    model = absolute(load(robots / "arm")).model
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    for M, found in zip(data.oMi, evaluate(model, q), strict=True):
        np.testing.assert_allclose(found, M.homogeneous[:3], atol=1e-12)


@pytest.mark.parametrize("form", ["joint", "absolute"])
def test_rates_are_the_derivative_of_pinocchios_integrate(form, robots):
    mechanism = load(robots / "arm")
    model = mechanism.model if form == "joint" else absolute(mechanism).model
    symbol = ca.SX.sym("q", model.nq)
    N = ca.Function("N", [symbol], [rates(model, symbol)])
    rng = np.random.default_rng(3)
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    v = rng.normal(size=model.nv)
    np.testing.assert_allclose(N(q).full() @ v, along(model, q, v, lambda x: x, 1e-3), atol=1e-9)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 0, 1), (0, 0, -1), (-1, 0, 0), (1, 2, -3)])
def test_a_direction_gets_a_right_handed_frame(axis):
    axis = np.array(axis, float) / np.linalg.norm(axis)
    x, y = align_z(axis).T[:2]
    np.testing.assert_allclose(np.cross(x, y), axis, atol=1e-15)
    R = align_z(axis)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(R[:, 2], axis, atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1)


def test_what_a_joint_is_is_read_off_pinocchio(tmp_path):
    joints = [
        J("a", axis="1 2 2"),
        J("b", "prismatic", "0 3 4", "a"),
        J("c", "continuous", "0 -1 0", "b"),
    ]
    model = load(write_mechanism(tmp_path, tree_urdf(joints))).model
    assert [is_rotational(model, i) for i in (1, 2, 3)] == [True, False, True]
    expected = [(1 / 3, 2 / 3, 2 / 3), (0, 0.6, 0.8), (0, -1, 0)]
    for i, axis in enumerate(expected, start=1):
        np.testing.assert_allclose(joint_axis(model, i), axis, atol=1e-12)
