"""Γ, its supports and the names of its columns, against Pinocchio's inverse dynamics, MuJoCo."""

import numpy as np
import pinocchio as pin
import pytest

from helpers import J, Truth, raw_configuration, tree_urdf, write_mechanism
from ident.equations.unknowns import Columns, Point
from ident.errors import MechanismError
from ident.mechanism import load
from ident.mechanism.batched import Dynamics, joints_of
from ident.mechanism.load import absolute
from ident.mechanism.parameters import (
    Bodies,
    about_origin,
    fixed_parameters,
    pseudo_inertia,
    regressor,
    rigid_forces,
    rigid_tangents,
    split,
    supports,
    unit_of,
)

TREES = {
    "revolute": [J("a", axis="1 0 0"), J("b", axis="0 -1 0", parent="a"), J("c", parent="b")],
    "oblique": [J("a", axis="1 2 3"), J("b", axis="0.3 -0.2 1", parent="a")],
    "continuous": [J("a", "continuous", "0 1 0"), J("b", "continuous", "1 -1 2", "a")],
    "prismatic": [
        J("a", "prismatic", "0 0 -1"),
        J("b", "prismatic", "2 1 -1", "a"),
        J("c", parent="b"),
    ],
    "fixed links are one body": [
        J("a"),
        J("f", "fixed", None, "a"),
        J("g", "fixed", None, "f"),
        J("b", "prismatic", "1 1 0", "g"),
    ],
    "branches": [J("t"), J("z", axis="1 0 0", parent="t"), J("b", "prismatic", "0 1 1", "t")],
    "mimic is a joint": [J("a"), J("b", axis="1 1 0", parent="a", inside='<mimic joint="a"/>')],
}


def state(model, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-3, 3, model.nq), rng.normal(size=model.nv), rng.normal(size=model.nv)


def gamma_of(mechanism, q, v, a):
    return regressor(mechanism.model, q[None], v[None], a[None])[0]


@pytest.mark.parametrize("name", TREES)
def test_torques_are_pinocchios(name, tmp_path):
    urdf = tree_urdf(TREES[name], seed=3)
    mechanism = load(write_mechanism(tmp_path, urdf, "gravity = [1.0, -2.0, -9.0]"))
    q, v, a = state(mechanism.model)
    raw = pin.buildModelFromXML(urdf)
    raw.gravity.linear = np.array([1.0, -2.0, -9.0])
    order = [raw.idx_vs[raw.getJointId(joint.name)] for joint in mechanism.joints]
    theirs = raw_configuration(raw, {j.name: q[j.index] for j in mechanism.joints})
    back = np.argsort(order)
    tau = pin.rnea(raw, raw.createData(), theirs, v[back], a[back])[order]
    np.testing.assert_allclose(gamma_of(mechanism, q, v, a) @ mechanism.prior, tau, atol=1e-10)


def relative_error(model, n, seed=0):
    """Largest difference of Γ from Pinocchio's, over its largest entry."""
    rng, data = np.random.default_rng(seed), model.createData()
    away = rng.normal(size=(n, model.nv))
    q = np.array([pin.integrate(model, pin.neutral(model), 2 * step) for step in away])
    v, a = rng.normal(size=(2, n, model.nv))
    theirs = [pin.computeJointTorqueRegressor(model, data, *x) for x in zip(q, v, a, strict=True)]
    gamma, pi = regressor(model, q, v, a), rng.normal(size=theirs[0].shape[1])
    forces = rigid_forces(model, q, v, a, pi)
    np.testing.assert_allclose(forces, theirs @ pi, atol=1e-11 * np.abs(forces).max())
    return np.abs(gamma - theirs).max() / np.abs(theirs).max()


@pytest.mark.parametrize("name", TREES)
@pytest.mark.parametrize("n", [1, 100, 1100])  # one, calls, all at once
def test_gamma_of_many_samples_is_pinocchios(name, n, tmp_path):
    mechanism = load(
        write_mechanism(tmp_path, tree_urdf(TREES[name], seed=3), "gravity = [1.0, -2.0, -9.0]")
    )
    assert relative_error(mechanism.model, n) < 1e-12


@pytest.mark.parametrize("name", [*TREES, "free bodies"])
def test_tangents_are_differences_of_forces(name, tmp_path):
    if name == "free bodies":
        model = free_bodies()
    else:
        urdf = tree_urdf(TREES[name], seed=3)
        model = load(write_mechanism(tmp_path, urdf, "gravity = [1.0, -2.0, -9.0]")).model
    rng, n, h = np.random.default_rng(1), 5, 1e-5
    q = np.array([pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))] * n)
    v, a = rng.normal(size=(2, n, model.nv))
    pi = rng.normal(size=10 * (model.njoints - 1))
    tangents = rigid_tangents(model, q, v, a, pi)

    def force(order, step):
        stepped = [np.array([pin.integrate(model, x, step) for x in q]), v + step, a + step]
        pairs = zip(stepped, (q, v, a), strict=True)
        state = [new if i == order else old for i, (new, old) in enumerate(pairs)]
        return rigid_forces(model, *state, pi)

    for order in range(3):
        for j, step in enumerate(h * np.eye(model.nv)):
            slope = (force(order, step) - force(order, -step)) / (2 * h)
            size = np.abs(tangents[order]).max()
            np.testing.assert_allclose(tangents[order, :, j].T, slope, atol=1e-8 * size)


@pytest.mark.parametrize("name", TREES)
def test_slopes_by_a_joints_place_are_differences_of_pinocchios_torques(name, tmp_path):
    model = load(write_mechanism(tmp_path, tree_urdf(TREES[name], seed=3))).model
    rng, h = np.random.default_rng(4), 1e-3  # torques are quadratic in a displacement
    states = [state(model, seed) for seed in range(3)]
    pi = np.concatenate([x.toDynamicParameters() for x in model.inertias[1:]])
    dynamics = Dynamics.of(model, joints_of(model), *map(np.array, zip(*states, strict=True)), pi)
    for k in range(model.njoints - 1):
        along, torques = rng.normal(size=3), []
        for sign in (1, -1):
            other = model.copy()
            other.jointPlacements[k + 1].translation += sign * h * along
            torques.append([pin.rnea(other, other.createData(), *x) for x in states])
        expected = (np.array(torques[0]) - torques[1]).T / (2 * h)
        slopes = dynamics.slopes(k, along)
        np.testing.assert_allclose(slopes, expected, atol=1e-9 * max(1, np.abs(expected).max()))


def free_bodies():
    model = pin.Model()
    slide = pin.JointModelPrismaticUnaligned(np.array([1.0, 2.0, 2.0]) / 3)
    joints = [pin.JointModelFreeFlyer(), pin.JointModelRX(), slide, pin.JointModelFreeFlyer()]
    for parent, joint in zip([0, 1, 2, 0], joints, strict=True):
        added = model.addJoint(parent, joint, pin.SE3.Random(), f"j{len(model.names)}")
        model.appendBodyToJoint(added, pin.Inertia.Random(), pin.SE3.Identity())
    return model


def test_gamma_of_free_bodies_is_pinocchios():
    assert relative_error(free_bodies(), 200) < 1e-12


@pytest.mark.parametrize("name", ["arm", "four_bar", "five_bar", "slider_crank", "pendulum"])
def test_torques_of_the_robots(name, robots):
    mechanism, truth = load(robots / name), Truth(name)
    q, v, a = state(mechanism.model)
    tau = pin.rnea(truth.model, truth.data, q, v, a)
    np.testing.assert_allclose(gamma_of(mechanism, q, v, a) @ mechanism.prior, tau, atol=1e-10)


def test_torques_of_the_arm_are_mujocos(robots):
    mujoco = pytest.importorskip("mujoco")
    mechanism = load(robots / "arm")
    model = mujoco.MjModel.from_xml_path(str(robots / "arm" / "arm.urdf"))
    model.opt.gravity[:] = mechanism.model.gravity.linear
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    q, v, a = state(mechanism.model)
    order = [model.joint(joint.name).qposadr[0] for joint in mechanism.joints]
    data.qpos[order], data.qvel[order], data.qacc[order] = q, v, a
    mujoco.mj_inverse(model, data)
    found = gamma_of(mechanism, q, v, a) @ mechanism.prior
    np.testing.assert_allclose(found, data.qfrc_inverse[order], atol=1e-6)


@pytest.mark.parametrize("name", TREES)
def test_rows_are_zero_outside_their_supports(name, tmp_path):
    mechanism = load(write_mechanism(tmp_path, tree_urdf(TREES[name], seed=3)))
    found = np.abs([gamma_of(mechanism, *state(mechanism.model, seed)) for seed in range(4)]).max(
        axis=0
    )
    for row, columns in zip(found, supports(mechanism.model), strict=True):
        outside = np.ones(len(row), bool)
        outside[columns] = False
        assert np.all(row[outside] == 0)
        bodies = row[columns].reshape(-1, 10)
        assert np.all(bodies.max(axis=1) > 0)  # and no body is claimed in vain


# --- names --------------------------------------------------------------------------------------

DYNAMIC = ["m", "mx", "my", "mz", "Lxx", "Lxy", "Lyy", "Lxz", "Lyz", "Lzz"]


def test_names_are_in_pinocchios_order(tmp_path):
    mechanism = load(write_mechanism(tmp_path, tree_urdf(TREES["branches"], seed=1)))
    assert mechanism.bodies.names[:10] == tuple(f"{mechanism.bodies.links[0]}.{w}" for w in DYNAMIC)
    for index, link in enumerate(mechanism.bodies.links, start=1):
        pi = dict(zip(DYNAMIC, mechanism.prior[mechanism.bodies.columns(link)], strict=True))
        inertia = mechanism.model.inertias[index]
        assert pi["m"] == pytest.approx(inertia.mass)
        assert [pi["mx"], pi["my"], pi["mz"]] == pytest.approx(list(inertia.mass * inertia.lever))
        c = inertia.lever
        L = inertia.inertia + inertia.mass * (c @ c * np.eye(3) - np.outer(c, c))
        assert pi["Lxy"] == pytest.approx(L[0, 1])
        assert pi["Lzz"] == pytest.approx(L[2, 2])
        np.testing.assert_allclose(split(mechanism.prior[mechanism.bodies.columns(link)])[2], L)


def test_base_parameters_are_sought_inertias_first():
    bodies = Bodies(("one", "two"))
    names = [bodies.names[i] for i in bodies.reading_order()]
    assert names[:10] == [
        f"one.{w}" for w in ["Lxx", "Lxy", "Lxz", "Lyy", "Lyz", "Lzz", "mx", "my", "mz", "m"]
    ]
    assert sorted(bodies.reading_order()) == list(range(20))


@pytest.mark.parametrize(
    ("patterns", "words"),
    [
        (["two"], DYNAMIC),
        (["two.*"], DYNAMIC),
        (["two.Ixx"], ["Lxx"]),
        (["two.Lxy", "two.m"], ["m", "Lxy"]),
        ([], []),
        (["two.mx", "two.mx"], ["mx"]),
    ],
)
def test_patterns_select_parameters(patterns, words):
    bodies = Bodies(("one", "two"))
    assert bodies.select(patterns, "here") == tuple(f"two.{word}" for word in words)


def test_a_links_name_may_hold_a_dot():
    bodies = Bodies(("arm.upper", "arm"))
    assert bodies.select(["arm.upper"], "here") == tuple(f"arm.upper.{w}" for w in DYNAMIC)
    assert bodies.select(["arm.upper.Izz"], "here") == ("arm.upper.Lzz",)


@pytest.mark.parametrize(
    ("pattern", "says"),
    [
        ("tow", "did you mean 'two'"),
        ("two.Ixz2", "Ixz"),
        ("base.m", "one, two"),
        ("two.", "no parameter ''"),
    ],
)
def test_patterns_of_nothing(pattern, says):
    with pytest.raises(MechanismError) as caught:
        Bodies(("one", "two")).select([pattern], "here")
    assert says in str(caught.value)
    assert "here" in str(caught.value)


def test_split():
    pi = np.arange(1.0, 11.0)
    m, moments, L = split(pi)
    upper = L[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    np.testing.assert_array_equal([m, *moments, *upper], pi)
    assert [unit_of(f"a.b.{w}") for w in ("m", "mx", "Lxx", "Ixy")] == [
        "kg",
        "kg m",
        "kg m²",
        "kg m²",
    ]


def test_parallel_axes():
    np.testing.assert_array_equal(about_origin(0.0, np.ones(3)), np.zeros((3, 3)))
    # a point mass of 2 kg at (1, 2, 3)
    L = about_origin(2.0, 2 * np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(L, 2 * np.array([[13, -2, -3], [-2, 10, -6], [-3, -6, 5]]))


@pytest.mark.parametrize("seed", range(5))
def test_pseudo_inertia_is_positive_for_bodies_and_only_for_them(seed):
    points, masses = np.random.default_rng(seed).normal(size=(5, 3)), np.arange(1.0, 6.0)
    inertia = pin.Inertia.Zero()
    for point, mass in zip(points, masses, strict=True):
        inertia += pin.Inertia(mass, point, np.zeros((3, 3)))
    P = pseudo_inertia(inertia.toDynamicParameters())
    np.testing.assert_allclose(P, inertia.toPseudoInertia().toMatrix(), atol=1e-10)
    assert np.linalg.eigvalsh(P).min() > -1e-12
    # principal moments that break the triangle inequality
    assert np.linalg.eigvalsh(pseudo_inertia([1, 0, 0, 0, 1, 0, 1, 0, 0, 3])).min() < 0


def test_columns_are_the_unknowns_rigid_first(tmp_path):
    toml = '[parameters]\nunknown = ["b_link.Izz", "a_link.m"]\n'
    toml += '[[effect]]\nkind = "spring"\njoint = "b"\nk = 2.0\n'
    toml += '[[effect]]\nkind = "viscous"\njoint = "a"\n'
    mechanism = load(write_mechanism(tmp_path, tree_urdf(TREES["prismatic"][:2], seed=1), toml))
    columns = Columns.of(mechanism)
    assert columns.names == ("a_link.m", "b_link.Lzz", "spring.b.b", "viscous.a.Fv")
    assert columns.units == ("kg", "kg m²", "N", "N s/m")
    assert len(columns) == 4
    assert [columns.index[name] for name in columns.names] == [0, 1, 2, 3]
    names = mechanism.bodies.names
    np.testing.assert_allclose(
        columns.prior[:2], mechanism.prior[[names.index(n) for n in columns.names[:2]]]
    )
    assert {names[i] for i in [*columns.rigid, *columns.known]} == set(names)
    np.testing.assert_allclose(columns.known_values, mechanism.prior[columns.known])
    x = np.array([1.0, 2.0, 3.0, 4.0])
    point = Point.prior(mechanism).at(mechanism, columns, x)
    values = {effect.kind: list(point.of(effect)[0]) for effect in mechanism.effects}
    assert values == {"spring": [2.0, 3.0], "viscous": [4.0]}
    np.testing.assert_allclose(point.pi, columns.dynamic_parameters(mechanism, x))
    pi = columns.dynamic_parameters(mechanism, x)
    assert pi[names.index("a_link.m")] == 1.0
    assert pi[names.index("a_link.mx")] == mechanism.prior[names.index("a_link.mx")]


def massless(urdf, *links):
    for link in links:
        head, mark, tail = urdf.partition(f'<link name="{link}">')
        assert mark
        urdf = head + f'<link name="{link}"/>' + tail.partition("</link>")[2]
    return urdf


def test_fixed_links_add_what_a_link_alone_lacks(tmp_path):
    urdf = tree_urdf(TREES["fixed links are one body"], seed=3)
    mechanism = load(write_mechanism(tmp_path, urdf))
    alone = pin.buildModelFromXML(massless(urdf, "f_link", "g_link"))
    fixed = fixed_parameters(mechanism.model, 1)
    own = alone.inertias[1].toDynamicParameters()
    np.testing.assert_allclose(fixed, mechanism.prior[:10] - own, atol=1e-12)
    assert not fixed_parameters(mechanism.model, 2).any()
    for joint in (1, 2):
        there = fixed_parameters(absolute(mechanism).model, joint)
        np.testing.assert_array_equal(there, fixed_parameters(mechanism.model, joint))
