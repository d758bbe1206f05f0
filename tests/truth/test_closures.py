"""Φ, J, J̇v, multipliers and own joints of every kind of closure."""

import itertools

import numpy as np
import pinocchio as pin
import pytest

from helpers import J, along, frame_jacobian, jacobian, tree_urdf, write_mechanism
from ident.mechanism import load
from ident.mechanism.closures import KINDS as ALL
from ident.mechanism.closures import Frame, FrameClosure
from ident.mechanism.kinematics import Kinematics
from ident.motion.closures import best_conditioned

KINDS = {k: c for k, c in ALL.items() if issubclass(c, FrameClosure) and k != "distance"}
TREE = [
    J("a1", axis="1 2 3"),
    J("a2", "prismatic", "0 1 1", "a1"),
    J("a3", "continuous", "1 0 0", "a2"),
    J("b0", "prismatic", "1 1 0"),
    J("b1", "prismatic", "1 -1 0", "b0"),
    J("bz", axis="1 -1 2", parent="b1"),
    J("b2", axis="0 1 0", parent="bz"),
    J("b3", axis="2 0 1", parent="b2"),
]
ENDS = """
a = { link = "a3_link", xyz = [0.1, -0.2, 0.3], rpy = [0.4, 0.5, -0.6] }
b = { link = "b3_link", xyz = [-0.3, 0.1, 0.2], rpy = [-0.2, 0.9, 1.1] }
"""
# DESIGN.md, section 4: equations, and which are forces; own joints
EXPECTED = {
    "point": ("x y z", 3, 0),
    "revolute": ("x y z rx ry", 3, 1),
    "prismatic": ("x y rx ry rz", 2, 1),
    "cylindrical": ("x y rx ry", 2, 2),
    "universal": ("x y z rz", 3, 0),
    "planar": ("z rx ry", 1, 0),
    "fixed": ("x y z rx ry rz", 3, 0),
    "distance": ("1", 1, 0),
}
AXES = ["".join(c) for n in (1, 2, 3) for c in itertools.combinations("xyz", n)]
MORE = {
    "distance": ENDS + "length = 0.7",
    "linear": 'joints = ["a1", "b2", "b0"]\nratios = [1.0, -2.0, 0.5]\noffset = 0.1',
    "polynomial": 'joints = ["a1", "b2"]\ncoefficients = [0.1, -0.7, 0.4, 0.2]',
    "function": 'file = "closure.py"\nfunction = "phi"',
    **{f"point {axes}": ENDS + f'axes = "{axes}"' for axes in AXES},
}
CASES = [*KINDS, *MORE]
FUNCTION = """
import casadi as ca
def phi(q):
    return [ca.sin(q["a1"]) * q["a2"] - q["b2"] ** 2, q[0] + q["bz"]]
"""


def closed(folder, case):
    """A mechanism of two random chains with one closure between their tips."""
    kind = case.split()[0]
    (folder / "closure.py").write_text(FUNCTION)
    toml = f'[[closure]]\nname = "c"\nkind = "{kind}"\n{MORE.get(case, ENDS)}'
    return load(write_mechanism(folder, tree_urdf(TREE, seed=4), toml), allow_code=True)


def somewhere(model, seed=0, spread=1.0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-spread, spread, model.nq), rng.normal(size=model.nv)


def check_derivatives(kinematics, q, v):
    """J and J̇v, W and Ẇv against finite differences along pin.integrate."""
    model = kinematics.model
    for rows in (kinematics.closure_rows, kinematics.own_rows)[
        : 2 if kinematics.closure_joints else 1
    ]:
        found = rows(q[None], v[None])
        J = jacobian(model, q, lambda x, rows=rows: rows(x[None]).value[0])
        drift = along(model, q, v, lambda x, rows=rows: rows(x[None]).rate[0] @ v, 1e-3)
        np.testing.assert_allclose(found.rate[0], J, atol=1e-8)
        np.testing.assert_allclose(found.drift[0], drift, atol=1e-7)


@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_finite_differences(case, tmp_path):
    mechanism = closed(tmp_path, case)
    for seed in range(3):
        check_derivatives(mechanism.kinematics, *somewhere(mechanism.model, seed))


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_on_free_bodies(kind):
    kinematics, q = two_bodies(kind)
    rng = np.random.default_rng(1)
    q = pin.integrate(kinematics.model, q, rng.normal(size=12))
    check_derivatives(kinematics, q, rng.normal(size=12))


@pytest.mark.parametrize("case", EXPECTED)
def test_multipliers_are_named_and_have_units(case, tmp_path):
    words, forces, own = EXPECTED[case]
    kinematics = closed(tmp_path, case).kinematics
    words = words.split()
    assert kinematics.multipliers == tuple(f"c.{word}" for word in words)
    assert kinematics.units == ("N",) * forces + ("N m",) * (len(words) - forces)
    assert len(kinematics.closure_joints) == own


def test_every_kind_is_expected_here():
    assert {*ALL} == {*EXPECTED, "linear", "polynomial", "function"}


@pytest.mark.parametrize("axes", AXES)
def test_point_keeps_the_axes_it_is_told(axes, tmp_path):
    mechanism = closed(tmp_path, f"point {axes}")
    assert mechanism.kinematics.multipliers == tuple(f"c.{axis}" for axis in axes)


def test_linear_is_the_sum_of_ratio_times_coordinate(tmp_path):
    mechanism = closed(tmp_path, "linear")
    q, _ = somewhere(mechanism.model)
    at = {joint.name: q[joint.index] for joint in mechanism.joints}
    rows = mechanism.kinematics.closure_rows(q[None])
    assert rows.value[0] == pytest.approx([at["a1"] - 2 * at["b2"] + 0.5 * at["b0"] - 0.1])
    assert mechanism.kinematics.multipliers == ("c.1",)
    assert mechanism.kinematics.units == ("N m",)


def test_distance_is_a_rod_of_that_length(tmp_path):
    mechanism = closed(tmp_path, "distance")
    q, _ = somewhere(mechanism.model)
    pa, pb = (end_placement(mechanism, q, end).translation for end in "ab")
    value = mechanism.kinematics.closure_rows(q[None]).value[0]
    assert value == pytest.approx([np.linalg.norm(pb - pa) - 0.7])


def end_placement(mechanism, q, end):
    """World placement of a closure's frame, by Pinocchio."""
    data = mechanism.model.createData()
    pin.forwardKinematics(mechanism.model, data, q)
    frame = getattr(mechanism.closures[0], end)
    return data.oMi[frame.joint] * frame.placement


def test_point_is_b_minus_a_in_world_axes(tmp_path):
    mechanism = closed(tmp_path, "point")
    q, _ = somewhere(mechanism.model)
    a, b = (end_placement(mechanism, q, end) for end in "ab")
    value = mechanism.kinematics.closure_rows(q[None]).value[0]
    np.testing.assert_allclose(value, b.translation - a.translation, atol=1e-12)
    # λ is the force in N, in world axes, that a's body exerts on b's: virtual work
    force = np.array([1.0, -2.0, 3.0])
    work = np.zeros(mechanism.model.nv)
    for end, sign in ((mechanism.closures[0].a, -1), (mechanism.closures[0].b, 1)):
        Jp = frame_jacobian(mechanism.model, q, end.joint, end.placement)
        work += sign * Jp[:3].T @ force
    J = mechanism.kinematics.closure_rows(q[None]).rate[0]
    np.testing.assert_allclose(J.T @ force, work, atol=1e-12)


# --- two free bodies held together exactly: ranks, and what the multipliers are -----------------

FREE = {  # the closure's own motion: translation in a's axes, and turn about a's z
    "point": ((0, 0, 0), 0.0),
    "revolute": ((0, 0, 0), 0.8),
    "prismatic": ((0, 0, 0.3), 0.0),
    "cylindrical": ((0, 0, -0.4), 1.1),
    "universal": ((0, 0, 0), 0.0),
    "planar": ((0.2, 0.5, 0), -0.7),
    "fixed": ((0, 0, 0), 0.0),
}


def two_bodies(kind, seed=2):
    """Two free bodies closed by `kind`, and a configuration at which it holds."""
    pin.seed(seed)
    model = pin.Model()
    for name in ("one", "two"):
        model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
    a, b = Frame("one", 1, pin.SE3.Random()), Frame("two", 2, pin.SE3.Random())
    shift, turn = FREE[kind]
    oMa = pin.SE3.Random()
    oMb = oMa * pin.SE3(pin.utils.rotate("z", turn), np.array(shift, float))
    q = np.concatenate(
        [
            pin.SE3ToXYZQUAT(oMa * a.placement.inverse()),
            pin.SE3ToXYZQUAT(oMb * b.placement.inverse()),
        ]
    )
    return Kinematics(model, (KINDS[kind]("c", a, b),), {}), q


@pytest.mark.parametrize("kind", KINDS)
def test_a_closure_of_two_free_bodies_is_exact_and_of_full_rank(kind):
    kinematics, q = two_bodies(kind)
    rows = kinematics.closure_rows(q[None])
    assert np.abs(rows.value).max() < 1e-12
    assert np.linalg.matrix_rank(rows.rate[0], tol=1e-6) == len(kinematics.multipliers)


@pytest.mark.parametrize("kind", KINDS)
def test_multipliers_are_forces_and_moments_on_b(kind):
    # forces act at b's origin, in world axes (in a's axes where the kind slides); moments about a's
    kinematics, q = two_bodies(kind)
    model, data = kinematics.model, kinematics.model.createData()
    closure = kinematics.closures[0]
    pin.forwardKinematics(model, data, q)
    oMa, oMb = (data.oMi[f.joint] * f.placement for f in (closure.a, closure.b))
    axes = oMa.rotation if KINDS[kind].sliding else np.eye(3)
    J = kinematics.closure_rows(q[None]).rate[0]
    for name, row in zip(kinematics.multipliers, J, strict=True):
        word = name.rsplit(".")[-1]
        e = np.eye(3)["xyz".index(word[-1])]
        force, moment = (
            (np.zeros(3), oMa.rotation @ e) if word[0] == "r" else (axes @ e, np.zeros(3))
        )
        work = np.zeros(12)
        for body, sign in ((1, -1), (2, 1)):
            at = data.oMi[body].inverse() * pin.SE3(np.eye(3), oMb.translation)
            Jp = frame_jacobian(model, q, body, at)
            work += sign * (Jp[:3].T @ force + Jp[3:].T @ moment)
        np.testing.assert_allclose(row, work, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "cylindrical"])
def test_a_closures_own_joint_is_its_free_coordinate(kind):
    kinematics, q = two_bodies(kind)
    shift, turn = FREE[kind]
    found = dict(
        zip(
            [own.name for own in kinematics.closure_joints],
            kinematics.own_rows(q[None]).value[0],
            strict=True,
        )
    )
    expected = {
        "revolute": {"closure.c": turn},
        "prismatic": {"closure.c": shift[2]},
        "cylindrical": {"closure.c.z": shift[2], "closure.c.rz": turn},
    }[kind]
    assert found == pytest.approx(expected)
    assert [own.rotational for own in kinematics.closure_joints] == [
        n.endswith("rz") or kind == "revolute" for n in found
    ]


def test_independent_joints_of_many_drives_are_chosen_at_once(tmp_path):
    """Sixteen trains of three driven wheels: 2·10¹² sets of joints, of which a few are compared."""
    urdf = tree_urdf([J(f"{name}{i}", "continuous") for i in range(16) for name in "abc"])
    toml = "".join(
        f'[[closure]]\nname = "{name}{i}"\nkind = "linear"\njoints = ["a{i}", "{name}{i}"]\n'
        f"ratios = [{ratio}, -1]\n"
        for i in range(16)
        for name, ratio in (("b", 0.5), ("c", 2.0))
    )
    mechanism = load(write_mechanism(tmp_path, urdf, toml))
    assert mechanism.degrees_of_freedom == 16
    joints = best_conditioned(mechanism, np.zeros((1, mechanism.model.nq)))
    assert {*joints} == {f"c{i}" for i in range(16)}  # the fastest of each train
