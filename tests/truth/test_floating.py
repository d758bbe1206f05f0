"""Bodies that float or hang on a ball: logs of poses, made with Pinocchio's own free joints."""

import numpy as np
import pinocchio as pin
import pytest

import ident
from ident.assess.check import check_logs
from ident.errors import MechanismError, MotionError
from ident.mechanism.chains import ORDERS, angles_of
from ident.mechanism.parameters import DYNAMIC

INERTIA = pin.Inertia(
    1.3, np.array([0.01, -0.02, 0.03]),
    np.array([[0.012, 0.0005, -0.0004], [0.0005, 0.015, 0.0003], [-0.0004, 0.0003, 0.021]]),
)  # fmt: skip
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")


def urdf(more="", joint=""):
    tensor, c = INERTIA.inertia, INERTIA.lever
    return (
        f'<robot name="flyer">{more}<link name="body"><inertial><mass value="{INERTIA.mass}"/>'
        f'<origin xyz="{c[0]} {c[1]} {c[2]}"/><inertia ixx="{tensor[0, 0]}" ixy="{tensor[0, 1]}" '
        f'ixz="{tensor[0, 2]}" iyy="{tensor[1, 1]}" iyz="{tensor[1, 2]}" izz="{tensor[2, 2]}"/>'
        f"</inertial></link>"
        f"{joint}</robot>"
    )


@pytest.fixture
def flyer(tmp_path):
    (tmp_path / "flyer.urdf").write_text(urdf())
    (tmp_path / "mechanism.toml").write_text('urdf = "flyer.urdf"\nbase = { kind = "floating" }\n')
    return tmp_path


def flight(noise=0.0, seed=0, rate=100.0, duration=10.0, turn=0.9):
    """Columns of a flight: pose, rates in the body's axes, the wrench that makes it."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, duration, 1 / rate)
    model = pin.Model()
    at = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(at, INERTIA, pin.SE3.Identity())
    data = model.createData()
    w = 2 * np.pi * np.outer(t, rng.uniform(0.2, 0.7, 6)) + rng.uniform(0, 6, 6)
    amplitude = np.array([0.4, 0.3, 0.5, 0.5, 0.4, turn])
    path = amplitude * np.sin(w)
    path[:, 5] += 0.8 * t  # several turns about z
    q = np.array([pin.SE3ToXYZQUAT(pin.SE3(pin.rpy.rpyToMatrix(x[3:]), x[:3])) for x in path])
    h = 1e-4
    omega = (np.diff(w, axis=0) * rate)[0]

    def pose(k, dt):
        x = amplitude * np.sin(w[k] + omega * dt)
        x[5] += 0.8 * (t[k] + dt)
        return pin.SE3ToXYZQUAT(pin.SE3(pin.rpy.rpyToMatrix(x[3:]), x[:3]))

    v, a = np.zeros((len(t), 6)), np.zeros((len(t), 6))
    for k in range(len(t)):
        forward, backward = pose(k, h), pose(k, -h)
        v[k] = pin.difference(model, backward, forward) / (2 * h)
        steps = [pin.difference(model, q[k], x) / h for x in (forward, backward)]
        a[k] = (steps[0] + steps[1]) / h
    # along exp, the second difference is the derivative of v up to terms that cancel in the mean
    f = np.array([pin.rnea(model, data, *x) for x in zip(q, v, a, strict=True)])
    f += noise * f.std(axis=0) * rng.normal(size=f.shape)
    q[::7, 3:] *= -1  # the same orientations
    columns = {f"base.{x}": q[:, i] for i, x in enumerate(("x", "y", "z", "qx", "qy", "qz", "qw"))}
    columns |= {f"wrench.body.{x}": f[:, i] for i, x in enumerate(WRENCH)}
    rates = {f"base.{x}": v[:, i] for i, x in enumerate(("vx", "vy", "vz", "wx", "wy", "wz"))}
    return t, columns, rates


@pytest.mark.parametrize("order", ORDERS)
def test_angles_of_any_order_give_the_rotation(order):
    axes = dict(zip("xyz", np.eye(3), strict=True))
    angles = np.random.default_rng(0).uniform(-1.4, 1.4, (20, 3))
    angles[:, [0, 2]] *= 2
    R = np.array(
        [
            np.linalg.multi_dot([pin.exp3(x * axes[c]) for x, c in zip(row, order, strict=True)])
            for row in angles
        ]
    )
    np.testing.assert_allclose(angles_of(R, order), angles, atol=1e-12)


def test_a_flight_identifies_the_whole_body(flyer):
    t, columns, rates = flight()
    mechanism = ident.load(flyer)
    assert [j.name for j in mechanism.joints] == [
        f"base.{x}" for x in ("x", "y", "z", "rz", "ry", "rx")
    ]
    motion = ident.complete(mechanism, ident.Log.from_arrays("f", t, columns))
    fit = ident.identify(mechanism, motion)
    assert fit.rank == 10
    names = [f"body.{word}" for word in DYNAMIC]
    found = np.array([fit.point.pi[mechanism.bodies.names.index(name)] for name in names])
    np.testing.assert_allclose(found, INERTIA.toDynamicParameters(), atol=2e-5, rtol=2e-3)
    derived = ident.complete(mechanism, ident.Log.from_arrays("f", t, columns)).experiments[0]
    logged = ident.complete(
        mechanism, ident.Log.from_arrays("f", t, columns | rates), smoothing=None
    ).experiments[0]
    inside = slice(50, -50)
    np.testing.assert_allclose(logged.v[inside], derived.v[inside], atol=2e-3)


def test_a_flight_without_thrust_is_refused(flyer):
    t, columns, _ = flight()
    bare = {name: x for name, x in columns.items() if not name.startswith("wrench")}
    mechanism = ident.load(flyer)
    with pytest.raises(MotionError, match=r"wrench\.") as error:
        ident.complete(mechanism, ident.Log.from_arrays("f", t, bare))
    assert "base" in str(error.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["base.qw"].__imul__(1.1), "length"),
        (lambda c: c.pop("base.qz"), "without base.qz"),
        (lambda c: c["base.qx"].__setitem__(slice(200, None), c["base.qy"][200:].copy()), ""),
    ],
)
def test_quaternions_that_are_none(flyer, change, words):
    t, columns, _ = flight(duration=5.0)
    columns = {name: x.copy() for name, x in columns.items()}
    change(columns)
    mechanism = ident.load(flyer)
    with pytest.raises(MotionError) as error:
        ident.complete(mechanism, ident.Log.from_arrays("f", t, columns))
    assert words in str(error.value)


def test_a_body_that_tumbles_is_refused_with_the_order_that_would_do(flyer):
    t, columns, _ = flight(duration=5.0)
    turned = np.array(
        [
            (
                pin.Quaternion(pin.exp3(np.array([0, np.pi / 2, 0])))
                * pin.Quaternion(*q[[3, 0, 1, 2]])
            )
            .coeffs()
            .copy()
            for q in np.stack([columns[f"base.q{x}"] for x in "xyzw"], axis=1)
        ]
    )
    columns |= {f"base.q{x}": turned[:, i] for i, x in enumerate("xyzw")}
    mechanism = ident.load(flyer)
    with pytest.raises(MotionError, match="80°"):
        ident.complete(mechanism, ident.Log.from_arrays("f", t, columns))


def test_a_body_that_tumbles_has_a_fourth_turn(flyer):
    """A somersault about an axis that itself turns, through every middle angle of three turns."""
    t = np.arange(0, 10, 0.01)
    model = pin.Model()
    at = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(at, INERTIA, pin.SE3.Identity())
    data = model.createData()
    paces = np.array([1.0, 1.3, 0.7, 0.3, 0.4, 0.25])
    sizes = np.array([1.0, 1.0, 1.0, 2.6, 3.1, 2.9])
    q, rows, h = pin.neutral(model), [], 1e-3
    for k in range(round(10 / h)):
        if k % 10 == 0:
            v, a = sizes * np.cos(paces * k * h), -sizes * paces * np.sin(paces * k * h)
            rows.append(np.concatenate([q, pin.rnea(model, data, q, v, a)]))
        q = pin.integrate(model, q, h * sizes * np.cos(paces * (k + 0.5) * h))
    table = np.array(rows)
    columns = {
        f"base.{x}": table[:, i] for i, x in enumerate(("x", "y", "z", "qx", "qy", "qz", "qw"))
    }
    columns |= {f"wrench.body.{x}": table[:, 7 + i] for i, x in enumerate(WRENCH)}
    log = ident.Log.from_arrays("f", t, columns)
    with pytest.raises(MotionError, match=r"tumbles.*xzyx"):
        ident.complete(ident.load(flyer), log)
    toml = 'urdf = "flyer.urdf"\nbase = { kind = "floating", order = "xzyx" }\n'
    (flyer / "mechanism.toml").write_text(toml)
    mechanism = ident.load(flyer)
    assert mechanism.unmeasured == ("base.gimbal",)
    assert mechanism.chains[0].gimbal == "x"
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    assert fit.rank == 10
    names = [f"body.{word}" for word in DYNAMIC]
    values = np.array([fit.point.pi[mechanism.bodies.names.index(name)] for name in names])
    np.testing.assert_allclose(values, INERTIA.toDynamicParameters(), atol=2e-4, rtol=2e-3)


@pytest.mark.parametrize("kind", ["floating", "planar", "ball"])
def test_joints_of_several_coordinates_in_a_urdf(kind, tmp_path):
    joint = (
        f'<joint name="j" type="{kind}"><parent link="world"/><child link="body"/>'
        '<origin xyz="0.1 0.2 0.3" rpy="0.1 0 0"/><axis xyz="0 0 1"/></joint>'
    )
    (tmp_path / "r.urdf").write_text(urdf('<link name="world"/>', joint))
    mechanism = ident.load(tmp_path / "r.urdf")
    words = {"floating": "x y z rz ry rx", "planar": "x y rz", "ball": "rz ry rx"}[kind].split()
    assert [j.name for j in mechanism.joints] == [f"j.{word}" for word in words]
    assert not mechanism.driven
    assert mechanism.unknown == tuple(n for n in mechanism.bodies.names if n.startswith("body."))
    with pytest.raises(MechanismError, match="no joint that moves"):
        ident.load(tmp_path / "r.urdf", locked={"j": None})


def test_a_body_hung_from_a_point_turns_and_its_mass_is_not_determined(flyer):
    """A ball at the ground: three unknown forces take the weight, moments about the hook stay."""
    text = (flyer / "mechanism.toml").read_text()
    hook = (
        '[[closure]]\nname = "hook"\nkind = "point"\na = { link = "world", xyz = [0, 0, 1] }\n'
        'b = { link = "body", xyz = [0.02, 0, 0.06] }\n'
    )
    (flyer / "mechanism.toml").write_text(text + hook)
    mechanism = ident.load(flyer)
    assert not mechanism.idle
    assert mechanism.degrees_of_freedom == 3
    known = check_logs(mechanism)
    names = [name for name in known.identifiable["base_parameters"] if name == "body.m"]
    assert (known.rank, names) == (9, [])
    assert not known.identifiable["total_mass"]
    t = np.arange(0, 10, 0.01)
    columns = {f"base.{x}": np.zeros(len(t)) for x in "xyz"}
    with pytest.raises(MotionError, match=r"base\.r"):  # its orientation has to be logged
        ident.complete(mechanism, ident.Log.from_arrays("f", t, columns))


def test_a_root_that_may_move_is_said(tmp_path):
    legs = "".join(
        f'<link name="leg{i}"/><joint name="hip{i}" type="continuous"><parent link="body"/>'
        f'<child link="leg{i}"/><axis xyz="0 1 0"/></joint>'
        for i in range(2)
    )
    (tmp_path / "r.urdf").write_text(urdf(joint=legs))
    (tmp_path / "arm.urdf").write_text(urdf(joint=legs.partition('<link name="leg1"/>')[0]))
    assert any("floating" in note for note in ident.load(tmp_path / "r.urdf").notes)
    assert not any("floating" in note for note in ident.load(tmp_path / "arm.urdf").notes)
    (tmp_path / "mechanism.toml").write_text('urdf = "r.urdf"\nbase = { kind = "fixed" }\n')
    assert not any("floating" in note for note in ident.load(tmp_path).notes)


def test_a_body_that_only_its_thrust_moves_has_no_wrench_too_many(flyer):
    """Without the wrench, masses of 0 fit exactly: that is no reason to leave it out."""
    t, columns, _ = flight(noise=0.02)
    motion = ident.complete(ident.load(flyer), ident.Log.from_arrays("f", t, columns))
    found = ident.identify(motion.mechanism, motion).health.findings
    assert [x for x in found if x.code == "wrench" or x.where[:1] == ("wrench",)] == []
    assert not [x for x in found if "left out" in x.meaning and "wrench" in x.meaning]


ROLLING = """<robot name="rover"><link name="world"/><link name="bx"/><link name="by"/>
<link name="chassis"><inertial><mass value="15"/>
<inertia ixx=".5" iyy=".5" izz=".7" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="x" type="prismatic"><parent link="world"/><child link="bx"/><axis xyz="1 0 0"/>
<limit lower="-9" upper="9" velocity="3" effort="0"/></joint>
<joint name="y" type="prismatic"><parent link="bx"/><child link="by"/><axis xyz="0 1 0"/>
<limit lower="-9" upper="9" velocity="3" effort="0"/></joint>
<joint name="yaw" type="continuous"><parent link="by"/><child link="chassis"/><axis xyz="0 0 1"/>
</joint>{}</robot>"""
WHEEL = """<link name="w{0}"><inertial><mass value=".001"/>
<inertia ixx=".00001" iyy=".01" izz=".00001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{0}" type="continuous"><parent link="chassis"/><child link="w{0}"/>
<origin xyz="0 {1} 0"/><axis xyz="0 1 0"/></joint>"""


def test_a_base_that_rolls_without_a_force_on_it_is_refused(tmp_path):
    """Wheels of radius r at ±b drive m and I by what the floor gives: no torque of a joint does."""
    r, b, m, inertia = 0.08, 0.22, 18.0, 0.9
    wheels = WHEEL.format("left", b) + WHEEL.format("right", -b)
    (tmp_path / "rover.urdf").write_text(ROLLING.format(wheels))
    toml = 'urdf = "rover.urdf"\n[joints]\npassive = ["x", "y", "yaw"]\n'
    (tmp_path / "mechanism.toml").write_text(toml)
    t = np.arange(0.0, 12.0, 0.01)
    phase = np.outer(t, [0.9, 1.3])
    speed, push = 4 * np.cos(phase) + [2.0, 1.0], -4 * np.sin(phase) * [0.9, 1.3]
    turn = 4 * np.sin(phase) / [0.9, 1.3] + np.outer(t, [2.0, 1.0])
    yaw, forward = r * (turn[:, 1] - turn[:, 0]) / (2 * b), r * speed.mean(axis=1)
    path = np.cumsum(forward[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1), axis=0) * 0.01
    along, round_ = r * push.mean(axis=1), r * (push[:, 1] - push[:, 0]) / (2 * b)
    force = np.stack([m * along / 2 - inertia * round_ / (2 * b)] * 2, axis=1)
    force[:, 1] += inertia * round_ / b
    columns = {"q.x": path[:, 0], "q.y": path[:, 1], "q.yaw": yaw}
    for i, name in enumerate(("left", "right")):
        columns |= {f"q.{name}": turn[:, i], f"tau.{name}": r * force[:, i] + 0.05 * speed[:, i]}
    with pytest.raises(MotionError, match="no force that moves or holds it") as error:
        ident.complete(ident.load(tmp_path), ident.Log.from_arrays("run", t, columns))
    assert "x, y" in str(error.value)
