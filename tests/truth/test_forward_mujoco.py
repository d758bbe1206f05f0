"""Forward simulation against MuJoCo's: a serial arm with friction, and planar loops."""

import sys
from dataclasses import replace

import numpy as np
import pytest

import ident
from helpers import ROOT

mujoco = pytest.importorskip("mujoco")
sys.path.append(str(ROOT / "tests" / "battery"))

from mechanisms import MACHINES  # noqa: E402
from rigid import mjcf, write_folder  # noqa: E402

STEP = 2e-5
END = 1.0


def steps_of(machine, start, effects, step, torque=None):
    """q (n, nv) every 10 ms by MuJoCo, from a state that satisfies the closures."""
    model = mujoco.MjModel.from_xml_string(mjcf(replace(machine, step=step)))
    for (kind, joint), values in effects.items():
        i = model.joint(joint).dofadr[0]
        if kind == "viscous":
            model.dof_damping[i] = values["Fv"]
        else:
            model.dof_frictionloss[i] = values["Fc"]
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start
    every = round(0.01 / step)
    found = [data.qpos.copy()]
    for _ in range(round(END / 0.01)):
        if torque is None:
            mujoco.mj_step(model, data, every)
        else:
            for _ in range(every):
                data.qfrc_applied[:] = torque(data.time)
                mujoco.mj_step(model, data)
        found.append(data.qpos.copy())
    return np.array(found)


def both(tmp_path, name, given, effects):
    """The run, its q, and MuJoCo's, extrapolated from two steps (its error is of first order)."""
    machine = MACHINES[name]
    mechanism = ident.load(write_folder(machine, tmp_path, effects, None))
    run = ident.integrate(mechanism, start=given, duration=END, rate=100.0)
    order = [mechanism.joint(joint.name).index for joint in machine.joints]
    start = run.q[0, order], run.v[0, order]
    coarse, fine = (steps_of(machine, start, effects, h) for h in (2 * STEP, STEP))
    return run, run.q[:, order], 2 * fine - coarse


def close(q, other, share):
    """Within a share of the largest travel of a joint."""
    assert np.abs(q - other).max() < share * np.ptp(q, axis=0).max()


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("arm3", {"elbow": 0.8, "v.yaw": 2.0, "v.shoulder": -1.0}),
        ("crank_rocker", {"v.crank": 6.0}),
        ("five_bar", {"v.left": 1.5, "v.right": -1.0}),
        ("slider_crank", {"v.theta": 8.0}),
    ],
)
def test_smooth_motion_is_mujocos(tmp_path, name, given):
    """Viscous friction only."""
    machine = MACHINES[name]
    Fv = 0.01 if name != "arm3" else 0.3
    effects = {("viscous", joint): {"Fv": Fv} for joint in machine.driven}
    run, q, other = both(tmp_path, name, given, effects)
    assert not run.transitions
    close(q, other, 5e-6)


def test_the_arm_with_coulomb_friction_is_mujocos(tmp_path):
    """Joints stop, stick and break away; MuJoCo's stuck joints creep a little."""
    machine = MACHINES["arm3"]
    effects = {("viscous", joint): {"Fv": 0.3} for joint in machine.driven}
    effects |= {("coulomb", joint): {"Fc": 1.5} for joint in machine.driven}
    run, q, other = both(
        tmp_path, "arm3", {"elbow": 0.8, "v.yaw": 2.0, "v.shoulder": -1.0}, effects
    )
    assert len(run.transitions) >= 3
    close(q, other, 1e-5)


@pytest.mark.parametrize(
    ("name", "given"), [("crank_rocker", {"v.crank": 3.0}), ("five_bar", {"v.left": 1.5})]
)
def test_a_loop_with_coulomb_friction_is_mujocos(tmp_path, name, given):
    machine = MACHINES[name]
    effects = {("coulomb", joint.name): {"Fc": 0.08} for joint in machine.joints}
    run, q, other = both(tmp_path, name, given, effects)
    assert len(run.transitions) >= 2
    close(q, other, 1e-4)


def test_a_driven_arm_is_mujocos(tmp_path):
    """Torques that break joints away and reverse them."""
    machine = MACHINES["arm3"]
    effects = {("coulomb", joint): {"Fc": 2.0} for joint in machine.driven}
    mechanism = ident.load(write_folder(machine, tmp_path, effects, None))

    def torque(t):
        return np.array([6 * np.sin(9 * t), -20 + 8 * np.sin(7 * t), -4 + 5 * np.sin(11 * t)])

    t = np.arange(0, END + 0.0005, 0.001)
    tau = np.array([torque(at) for at in t])
    columns = {f"tau.{name}": tau[:, i] for i, name in enumerate(machine.driven)}
    columns |= {f"q.{name}": 1e-3 * np.sin(t + i) for i, name in enumerate(machine.driven)}
    begin = {f"{c}.{name}": 0.0 for c in "qv" for name in machine.driven}
    run = ident.integrate(
        mechanism, ident.Torques(ident.Log.from_arrays("tau", t, columns)), start=begin, rate=100.0
    )
    assert any(each.mode == 0 for each in run.transitions)
    other = steps_of(machine, (run.q[0], run.v[0]), effects, 5e-5, torque)
    close(run.q, other, 1e-3)
