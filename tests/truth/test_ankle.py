"""Two motors that move an ankle by rods with ball ends, by MuJoCo; friction is in the motors."""

import numpy as np
import pytest

import ident
from ident.log import Log

mujoco = pytest.importorskip("mujoco")

STEP = 2e-4  # [s]
DAMPING, LOSS, ARMATURE = 0.05, 0.15, 0.012  # of both motors
FOOT = 'mass="0.9" pos="0.02 0 -0.05" diaginertia=".0012 .0042 .0046"'
DRAWN = 'mass="0.8" pos="0.01 0 -0.05" diaginertia=".001 .004 .004"'
BALL = '<joint name="rod_{s}" type="ball"/>'
CROSS = '<joint name="rod_{s}_1" axis="1 0 0"/><joint name="rod_{s}_2" axis="0 1 0"/>'
MOTOR = f'armature="{ARMATURE}" damping="{DAMPING}" frictionloss="{LOSS}"'


def model(rod, foot, motor=""):
    legs = ""
    for s, y, height, length in (("l", 0.04, 0.20, 0.22), ("r", -0.04, 0.26, 0.28)):
        legs += f"""<body name="crank_{s}" pos="0 {y} {height}">
        <joint name="m_{s}" axis="0 1 0" {motor}/>
        <inertial pos="-0.02 0 0" mass="0.08" diaginertia="2e-5 2e-5 2e-5"/>
        <body name="rod_{s}" pos="-0.05 0 0">{rod.format(s=s)}
        <inertial pos="0 0 {-length / 2}" mass="0.06" diaginertia="3e-4 3e-4 2e-6"/>
        </body></body>"""
    return f"""<mujoco><compiler angle="radian"/>
    <option timestep="{STEP}" integrator="implicitfast"><flag contact="disable"/></option>
    <default><equality solref="{2 * STEP} 1" solimp="0.99 0.9999 0.00001"/></default><worldbody>
    <body name="foot_x"><joint name="pitch" axis="0 1 0"/>
    <inertial pos="0 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/>
    <body name="foot"><joint name="roll" axis="1 0 0"/><inertial {foot}/></body></body>{legs}
    </worldbody><equality><connect body1="rod_l" body2="foot" anchor="0 0 -0.22"/>
    <connect body1="rod_r" body2="foot" anchor="0 0 -0.28"/></equality><actuator>
    <motor name="a_l" joint="m_l"/><motor name="a_r" joint="m_r"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def log():
    """Positions and torques of both motors, 8 s at 250 Hz."""
    m = mujoco.MjModel.from_xml_string(model(CROSS, FOOT, MOTOR))
    m.dof_solref[:] = (2 * STEP, 1.0)
    d, rng, rate, seconds = mujoco.MjData(m), np.random.default_rng(1), 250, 8.0
    k, phase = 2 * np.pi / seconds * np.arange(1, 7), rng.uniform(0, 6.28, (2, 6))
    size = np.array([0.18, 0.12, 0.08, 0.06, 0.05, 0.04])
    at = [int(m.joint(name).qposadr[0]) for name in ("m_l", "m_r")]
    v_at = [int(m.joint(name).dofadr[0]) for name in ("m_l", "m_r")]
    every, rows = round(1 / rate / STEP), []
    for i in range(round((seconds + 1) / STEP)):
        t = i * STEP
        ramp = min(1.0, t / 0.8) ** 2 * (3 - 2 * min(1.0, t / 0.8))
        ref = ramp * (size * np.sin(k * t + phase)).sum(axis=1)
        dref = ramp * (size * k * np.cos(k * t + phase)).sum(axis=1)
        d.ctrl[:] = 60 * (ref - d.qpos[at]) + 1.2 * (dref - d.qvel[v_at])
        if i % every == 0 and t >= 1:
            rows.append([t - 1, *d.qpos[at], *d.ctrl])
        mujoco.mj_step(m, d)
    x = np.array(rows)
    x[:, 1:3] += 2e-5 * rng.normal(size=(len(x), 2))
    x[:, 3:5] += 0.01 * rng.normal(size=(len(x), 2))
    names = ("q.m_l", "q.m_r", "tau.m_l", "tau.m_r")
    return Log.from_arrays("ankle", x[:, 0], dict(zip(names, x[:, 1:].T, strict=True)))


@pytest.mark.parametrize("rod", [BALL, CROSS])
def test_friction_of_motors_behind_rods_with_ball_ends(tmp_path, log, rod):
    (tmp_path / "ankle.xml").write_text(model(rod, DRAWN))
    mechanism = ident.load(tmp_path / "ankle.xml").with_effect("viscous").with_effect("coulomb")
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    values = {p.name: p for effect in fit.effects for p in effect.parameters}
    for motor in ("m_l", "m_r"):
        for name, truth in ((f"viscous.{motor}.Fv", DAMPING), (f"coulomb.{motor}.Fc", LOSS)):
            assert abs(values[name].value - truth) < 3.5 * values[name].stderr < truth / 2
    assert max(fit.relative.values()) < 0.03
    assert not {finding.code for finding in fit.health.findings} & {"scale", "motors"}
