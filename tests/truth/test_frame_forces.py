"""Forces at places against Pinocchio's Jacobians; a car and a drone with forces of unknown size."""

import numpy as np
import pinocchio as pin
import pytest

import ident
from ident.effects import KINDS, FrameForce, Signals
from ident.errors import MechanismError, MotionError
from ident.mechanism.frames import moving_frames, path_to

FRAME_KINDS = [kind for kind, cls in KINDS.items() if issubclass(cls, FrameForce)]
CAR = """<robot name="car"><link name="world"/><link name="chassis"><inertial>
<origin xyz="0 0 0.3"/><mass value="{m}"/><inertia ixx="300" iyy="1500" izz="1600" ixy="0" ixz="0"
iyz="0"/></inertial></link><link name="front"/><link name="rear"/>
<joint name="base" type="planar"><parent link="world"/><child link="chassis"/><axis xyz="0 0 1"/>
</joint><joint name="steer" type="revolute"><parent link="chassis"/><child link="front"/>
<origin xyz="1.2 0 0"/><axis xyz="0 0 1"/><limit lower="-0.6" upper="0.6" velocity="2" effort="0"/>
</joint><joint name="rear_axle" type="fixed"><parent link="chassis"/><child link="rear"/>
<origin xyz="-1.4 0 0"/></joint></robot>"""
TOML = """urdf = "car.urdf"
[joints]
unmeasured = ["steer"]
[parameters]
unknown = ["chassis"]
{known}
[[effect]]
kind = "{tyre}"
{file}
frame = "front"
[[effect]]
kind = "{tyre}"
{file}
frame = "rear"
[[effect]]
kind = "tyre_slip"
frame = "rear"
radius = 0.3
"""
M, IZZ, FRONT, REAR, C_FRONT, C_REAR, C_X, RADIUS = 1200.0, 1800.0, 1.2, 1.4, 6e4, 7.5e4, 5e4, 0.3


def car(folder, known='known = ["chassis.m"]', tyre="tyre", file="", **options):
    (folder / "car.urdf").write_text(CAR.format(m=M))
    (folder / "mechanism.toml").write_text(TOML.format(known=known, tyre=tyre, file=file))
    return ident.load(folder, **options)


def slalom(amplitude=0.05, bend=0.0, duration=16.0, rate=100.0, h=2e-3):
    """Columns of a bicycle model by Runge and Kutta; tyres bend with Pacejka's B = `bend`."""

    def steer(t):
        return amplitude * (np.sin(2.2 * t) + 0.6 * np.sin(5.2 * t + 1)) * min(1.0, t)

    def wheel(t):
        return (12.3 + 1.5 * np.sin(0.94 * t)) / RADIUS

    def side(C, slip):
        return -C * (np.sin(1.3 * np.arctan(bend * slip)) / (1.3 * bend) if bend else slip)

    def rates(t, s):
        _, _, yaw, vx, vy, r = s
        c, d = np.cos(steer(t)), np.sin(steer(t))
        along, across = c * vx + d * (vy + FRONT * r), c * (vy + FRONT * r) - d * vx
        front = side(C_FRONT, np.arctan(across / along))
        rear = side(C_REAR, np.arctan((vy - REAR * r) / vx))
        push = C_X * (RADIUS * wheel(t) - vx) / vx
        return np.array(
            [
                np.cos(yaw) * vx - np.sin(yaw) * vy, np.sin(yaw) * vx + np.cos(yaw) * vy, r,
                (push - d * front) / M + vy * r, (c * front + rear) / M - vx * r,
                (FRONT * c * front - REAR * rear) / IZZ,
            ]
        )  # fmt: skip

    s, rows, every = np.array([0, 0, 0, 12.0, 0, 0]), [], round(1 / rate / h)
    for k in range(round(duration / h)):
        t = k * h
        if k % every == 0:
            rows.append([t, *s, steer(t), wheel(t)])
        k1 = rates(t, s)
        k2 = rates(t + h / 2, s + h / 2 * k1)
        k3 = rates(t + h / 2, s + h / 2 * k2)
        s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(t + h, s + h * k3))
    return np.array(rows)


def log_of(rows, seed=None, errors=(5e-3, 1e-3, 1e-3, 0.01)):
    """A log with noise of position [m], yaw, steering [rad] and wheel speed [rad/s]."""
    random, n = np.random.default_rng(seed), len(rows)
    position, yaw, steer, wheel = errors if seed is not None else np.zeros(4)
    columns = {
        "q.base.x": rows[:, 1] + position * random.normal(size=n),
        "q.base.y": rows[:, 2] + position * random.normal(size=n),
        "q.base.rz": rows[:, 3] + yaw * random.normal(size=n),
        "q.steer": rows[:, 7] + steer * random.normal(size=n),
        "wheel.rear": rows[:, 8] + wheel * random.normal(size=n),
    }
    return ident.Log.from_arrays("run", rows[:, 0], columns)


@pytest.fixture
def arm(tmp_path):
    """Five joints that turn and slide about oblique axes, with a link fixed to the last."""
    random, parts = np.random.default_rng(0), ['<link name="world"/>']
    before = "world"
    for i in range(5):
        axis, xyz, rpy = (" ".join(f"{x:.6f}" for x in random.normal(size=3)) for _ in range(3))
        kind = "prismatic" if i in (1, 3) else "continuous"
        limit = '<limit lower="-9" upper="9" velocity="9" effort="9"/>' * (kind == "prismatic")
        parts.append(
            f'<link name="l{i}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" '
            f'ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j{i}" type="{kind}">'
            f'<parent link="{before}"/><child link="l{i}"/><origin xyz="{xyz}" rpy="{rpy}"/>'
            f'<axis xyz="{axis}"/>{limit}</joint>'
        )
        before = f"l{i}"
    parts.append(
        '<link name="tip"/><joint name="f" type="fixed"><parent link="l4"/><child link="tip"/>'
        '<origin xyz="0.1 -0.2 0.3" rpy="0.4 0.5 0.6"/></joint>'
    )
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{"".join(parts)}</robot>')
    return ident.load(tmp_path / "arm.urdf")


def signals(n, joints, seed=1, **more):
    random = np.random.default_rng(seed)
    q, v, a = random.normal(size=(3, n, joints))
    extra = {f"{word}.tip": random.normal(size=n) for word in ("input", "wheel", "normal")}
    return Signals(np.arange(n) / 100, q, v, a, np.full(joints, 0.01), extra, **more)


def test_a_frames_motion_is_pinocchios(arm):
    model, data, s = arm.model, arm.model.createData(), signals(20, 5)
    for name in ("tip", "l2"):
        path = path_to(model, name, arm.joint_index)
        k = len(path.joints)
        m = path.at(s.q[:, :k], s.v[:, :k])
        index = model.getFrameId(name, pin.FrameType.BODY)
        for i in range(20):
            q, v = s.q[i].copy(), s.v[i].copy()
            J = pin.computeFrameJacobian(model, data, q, index, pin.LOCAL)
            pin.framesForwardKinematics(model, data, q)
            np.testing.assert_allclose(m.jacobian[i], J[:, :k], atol=1e-12)
            np.testing.assert_allclose(J[:, k:], 0.0)
            np.testing.assert_allclose(m.position[i], data.oMf[index].translation, atol=1e-12)
            np.testing.assert_allclose(m.rotation[i], data.oMf[index].rotation, atol=1e-12)
            np.testing.assert_allclose(np.append(m.velocity[i], m.rate[i]), J @ v, atol=1e-12)
    assert "tip" in moving_frames(model)
    assert "world" not in moving_frames(model)


@pytest.mark.parametrize("kind", FRAME_KINDS)
def test_columns_are_what_the_joints_must_supply(kind, arm):
    """Power: what joints supply to stand a force is what the force takes from the frame."""
    effect = arm.placed(KINDS[kind](("tip",)))
    s = signals(30, 5, shape={shape.name: 3.0 for shape in effect.shapes})
    m, E = effect.motion(s), effect.columns(s)
    W = effect.wrench(m, s)
    assert E.shape == (30, 5, len(effect.unknowns))
    twist = np.concatenate([m.velocity, m.rate], axis=1)
    np.testing.assert_allclose(
        np.einsum("nj,nju->nu", s.v, E), -np.einsum("nc,ncu->nu", twist, W), atol=1e-9
    )


def test_resistance_takes_power_and_thrust_points_along_z(arm):
    s = signals(30, 5)
    for power in (1.0, 2.0):
        drag = arm.placed(KINDS["body_drag"](("tip",), {"power": power}))
        assert (np.einsum("nj,nju->nu", s.v, drag.columns(s)) >= 0).all()
    thrust = arm.placed(KINDS["thrust"](("tip",)))
    W, u = thrust.wrench(thrust.motion(s), s), s.extra["input.tip"]
    np.testing.assert_allclose(W[:, 2, 0], u * abs(u))
    np.testing.assert_allclose(W[:, 5, 1], u * abs(u))
    assert np.count_nonzero(W) == 60


def test_a_clean_slalom_gives_both_stiffnesses(tmp_path):
    mechanism = car(tmp_path)
    fit = ident.identify(mechanism, ident.complete(mechanism, log_of(slalom(duration=10.0))))
    values = fit.point.values
    assert values["tyre.front.C"] == pytest.approx(C_FRONT, rel=2e-3)
    assert values["tyre.rear.C"] == pytest.approx(C_REAR, rel=2e-3)
    assert values["tyre_slip.rear.Cx"] == pytest.approx(C_X, rel=2e-3)


def test_a_noisy_slalom_gives_both_stiffnesses(tmp_path):
    mechanism = car(tmp_path).with_calibration("exact")
    fit = ident.identify(
        mechanism, ident.complete(mechanism, log_of(slalom(amplitude=0.08), seed=0))
    )
    assert fit.likelihood is not None
    truth = {"tyre.front.C": C_FRONT, "tyre.rear.C": C_REAR}
    for effect in fit.effects[:2]:
        (x,) = effect.parameters
        name = x.name
        assert abs(x.value - truth[name]) < 3 * x.stderr
        assert x.value == pytest.approx(truth[name], rel=0.03)


def test_positions_alone_noisy_are_no_bias_of_the_stiffnesses(tmp_path):
    """Slip angles are rates of positions: 10 % off in least squares, 7 % after a single step."""
    mechanism = car(tmp_path).with_calibration("exact")
    log = log_of(slalom(0.08), 0, (5e-3, 2e-4, 2e-4, 2e-3))
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    values = {x.name: x for e in fit.effects for x in e.parameters}
    assert not {"noise raised", "not converged"} & {finding.code for finding in fit.findings}
    for name, true in (("tyre.front.C", C_FRONT), ("tyre.rear.C", C_REAR)):
        assert abs(values[name].value / true - 1) < 0.02
        assert abs(values[name].value - true) < 3 * values[name].stderr


def test_nothing_of_known_size_leaves_ratios_only(tmp_path):
    mechanism = car(tmp_path, known="")
    with pytest.raises(MotionError, match=r"only the ratios.*chassis\.m") as error:
        ident.complete(mechanism, log_of(slalom(duration=4.0)))
    assert "tyre.front.C" in str(error.value)
    (tmp_path / "one.toml").write_text((tmp_path / "mechanism.toml").read_text())
    stated = (tmp_path / "one.toml").read_text().replace("radius = 0.3", "radius = 0.3\nCx = 50000")
    (tmp_path / "one.toml").write_text(stated)
    one = ident.load(tmp_path / "one.toml")
    fit = ident.identify(one, ident.complete(one, log_of(slalom(duration=10.0))))
    mass = fit.point.pi[one.bodies.names.index("chassis.m")]
    assert mass == pytest.approx(M, rel=1e-2)


def test_the_names_of_all_forces_of_unknown_size_are_listed(tmp_path):
    urdf = """<robot name="cart"><link name="world"/><link name="cart"><inertial><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="s"
    type="prismatic"><parent link="world"/><child link="cart"/><axis xyz="1 0 0"/><limit lower="-9"
    upper="9" velocity="9" effort="0"/></joint></robot>"""
    (tmp_path / "cart.urdf").write_text(urdf)
    (tmp_path / "mechanism.toml").write_text('urdf = "cart.urdf"\n[joints]\npassive = ["s"]\n')
    mechanism = ident.load(tmp_path).with_effect("viscous:s").with_effect("spring:s")
    t = np.arange(400) / 100
    log = ident.Log.from_arrays("run", t, {"q.s": np.exp(-t) * np.sin(3 * t)})
    with pytest.raises(MotionError, match=r"and of viscous\.s\.Fv, spring\.s\.k, spring\.s\.b can"):
        ident.complete(mechanism, log)


@pytest.mark.parametrize(
    ("kind", "values", "units"),
    [
        # by dimensions: force [N] over what the equation multiplies
        ("thrust", {}, ("N/u²", "N m/u²")), ("thrust", {"power": 1}, ("N/u", "N m/u")),
        ("body_drag", {}, ("N s/m",) * 3), ("body_drag", {"power": 2}, ("N s²/m²",) * 3),
        ("tyre", {}, ("N/rad",)), ("tyre", {"normal": 1}, ("1/rad",)),
        ("tyre_saturation", {}, ("N/rad", "1/rad")),
        ("tyre_saturation", {"normal": 1}, ("1/rad", "1/rad")), ("tyre_slip", {}, ("N",)),
    ],
)  # fmt: skip
def test_units_follow_the_settings(kind, values, units):
    assert KINDS[kind](("tip",), values).units == units


OWN = """
def side(s):
    slip = casadi.atan(s.velocity[1] / casadi.fmax(casadi.fabs(s.velocity[0]), 0.3))
    return {"C [N/rad]": [0, -slip, 0]}
"""


def test_a_force_of_ones_own_is_the_librarys(tmp_path):
    (tmp_path / "own.py").write_text("import casadi\n" + OWN)
    mechanism = car(tmp_path, tyre="side", file='file = "own.py"', allow_code=True)
    library = car(tmp_path)
    own, tyre = mechanism.effects[0], library.effects[0]
    assert own.acting == tyre.acting == ("base.x", "base.y", "base.rz", "steer")
    s = signals(40, 4)
    np.testing.assert_allclose(own.columns(s), tyre.columns(s), atol=1e-12)
    assert own.unknowns[0].units == ("N/rad", "N/rad")


def test_a_frame_that_is_not_there(tmp_path):
    with pytest.raises(MechanismError, match=r"no frame 'fron'.*front"):
        _ = car(tmp_path) + KINDS["tyre"](("fron",))


def test_a_bent_slope_is_named_and_closed(tmp_path):
    mechanism = car(tmp_path).with_calibration("exact")
    motion = ident.complete(mechanism, log_of(slalom(amplitude=0.12, bend=12.0), seed=0))
    fit = ident.identify(mechanism, motion)
    named = [effect.label for effect in ident.diagnose(fit).group]
    assert sorted(named) == ["tyre_saturation:front", "tyre_saturation:rear"]
    bent = mechanism.with_effect("tyre_saturation:front").with_effect("tyre_saturation:rear")
    values = {x.name: x.value for e in ident.identify(bent, motion).effects for x in e.parameters}
    for place, C in (("front", C_FRONT), ("rear", C_REAR)):
        assert values[f"tyre.{place}.C"] == pytest.approx(C, rel=0.1)
        assert values[f"tyre_saturation.{place}.S"] == pytest.approx(C, rel=0.2)
        assert values[f"tyre_saturation.{place}.B"] == pytest.approx(12.0, rel=0.2)
