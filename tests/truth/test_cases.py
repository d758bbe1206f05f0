"""Machines that were refused or misread: an ankle with ball ends by MuJoCo, a body that flies."""

import numpy as np
import pytest

import ident
from ident.errors import MechanismError, MotionError
from ident.simulate import Noise

pytest.importorskip("mujoco")

ANKLE = """<mujoco model="ankle"><compiler angle="radian"/><worldbody>
<body name="cross"><joint name="pitch" axis="0 1 0"/>
<inertial pos="0 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/>
<body name="foot"><joint name="roll" axis="1 0 0"/>
<inertial pos="0.01 0 -0.05" mass="0.8" diaginertia=".001 .004 .004"/></body></body>{}</worldbody>
<equality><connect name="c_l" body1="rod_l" body2="foot" anchor="0 0 -0.22"/>
<connect name="c_r" body1="rod_r" body2="foot" anchor="0 0 -0.28"/></equality>
<actuator><motor name="a_l" joint="m_l"/><motor name="a_r" joint="m_r"/></actuator></mujoco>"""
LEG = """<body name="crank_{0}" pos="0 {1} {2}"><joint name="m_{0}" axis="0 1 0"/>
<inertial pos="-0.02 0 0" mass="0.08" diaginertia="2e-5 2e-5 2e-5"/>
<body name="rod_{0}" pos="-0.05 0 0"><joint name="rod_{0}" type="ball"/>
<inertial pos="0 0 {3}" mass="0.06" diaginertia="3e-4 3e-4 2e-6"/></body></body>"""


@pytest.fixture
def ankle(tmp_path):
    legs = LEG.format("l", 0.04, 0.20, -0.11) + LEG.format("r", -0.04, 0.26, -0.14)
    (tmp_path / "ankle.xml").write_text(ANKLE.format(legs))
    return ident.load(tmp_path / "ankle.xml")


def test_an_ankle_with_ball_ends_has_its_friction_in_the_motors(ankle):
    """The spin of a rod moves nothing, and of like columns a drive comes before a passive ball."""
    assert ankle.degrees_of_freedom == 2
    assert len(ankle.idle) == 2
    t = np.arange(0, 8, 0.005)
    phase = np.outer(t, 2 * np.pi * np.array([0.25, 0.5, 0.875]))
    columns = {"q.m_l": np.sin(phase) @ [0.15, 0.08, 0.04]}
    columns["q.m_r"] = np.sin(phase + 1) @ [-0.05, 0.12, 0.06]
    rubbing = ankle.with_effect("viscous").with_effect("coulomb")
    values = {f"viscous.m_{x}.Fv": 0.05 for x in "lr"} | {f"coulomb.m_{x}.Fc": 0.15 for x in "lr"}
    noise = [Noise("tau", 0.01), Noise("q", 2e-5)]
    made = ident.Log.from_arrays("run", t, columns)
    run, _ = ident.simulate(rubbing, made, values=values, noise=noise, seed=0)
    kept = {name: run.columns[name] for name in ("q.m_l", "q.m_r", "tau.m_l", "tau.m_r")}
    motion = ident.complete(ankle, ident.Log.from_arrays("run", run.t, kept))
    named = ident.diagnose(ident.identify(ankle, motion))
    assert {joint for effect in named.group for joint in effect.joints} <= {"m_l", "m_r"}
    fit = ident.identify(
        rubbing, ident.complete(rubbing, ident.Log.from_arrays("run", run.t, kept))
    )
    for x in (x for effect in fit.effects for x in effect.parameters):
        assert abs(x.value - values[x.name]) < max(3 * x.stderr, 0.1 * values[x.name])


BAD = [
    ('base = { kind = "floatin" }', "floatin.*floating"),
    ('base = { kind = "floating", order = "zzy" }', "zzy.*tumbles"),
    ('[[effect]]\nkind = "thrust"\nframe = "boddy"', "no frame 'boddy'.*body"),
    ('[[effect]]\nkind = "thrust"\nframe = "body"\nradius = 1.0', "radius"),
    ('[parameters]\nknown = ["body.q"]', r"body\.q"),
]


@pytest.mark.parametrize(("text", "says"), BAD)
def test_bad_input_is_one_line(text, says, tmp_path):
    body = (
        '<robot name="b"><link name="body"><inertial><mass value="1"/><inertia ixx="1" iyy="1" '
        'izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>'
    )
    (tmp_path / "b.urdf").write_text(body)
    floating = "" if "base" in text else 'base = { kind = "floating" }\n'
    (tmp_path / "mechanism.toml").write_text(f'urdf = "b.urdf"\n{floating}{text}\n')
    with pytest.raises(MechanismError, match=says) as error:
        ident.load(tmp_path)
    assert "\n" not in str(error.value)


def test_a_thrust_without_its_column_is_refused(tmp_path):
    thrust = '[[effect]]\nkind = "thrust"\nframe = "body"\nd = 0.0\n'
    body = (
        '<robot name="b"><link name="body"><inertial><mass value="1"/><inertia ixx="1" iyy="1" '
        'izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>'
    )
    (tmp_path / "b.urdf").write_text(body)
    (tmp_path / "mechanism.toml").write_text(
        f'urdf = "b.urdf"\nbase = {{ kind = "floating" }}\n{thrust}[parameters]\n'
        'known = ["body.m"]\n'
    )
    t = np.arange(0, 5, 0.01)
    columns = {f"base.{x}": 0.3 * np.sin(t + i) for i, x in enumerate("xyz")}
    columns |= {f"base.q{x}": np.zeros(len(t)) for x in "xyz"} | {"base.qw": np.ones(len(t))}
    mechanism = ident.load(tmp_path)
    with pytest.raises(MotionError, match=r"input\.body"):
        ident.identify(mechanism, ident.complete(mechanism, ident.Log.from_arrays("f", t, columns)))
