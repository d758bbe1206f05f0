"""Forces at places forward in time, against Pinocchio's forward dynamics and its frames."""

import sys

import numpy as np
import pinocchio as pin
import pytest
from forward import integrated, judged, planted
from scipy.integrate import solve_ivp

import ident
from helpers import ROBOTS, J, tree_urdf, write_mechanism
from ident.cli.app import main

JOINTS = [J("a", axis="0 1 0"), J("b", axis="1 0 0", parent="a"), J("c", parent="b")]
START = {"q.a": 0.4, "q.b": -0.3, "v.b": 2.0, "v.c": -1.0}
DURATION, RATE = 0.8, 50.0
INPUT = (3.0, 1.5)  # amplitude and frequency [rad/s] of a rotor's speed


def drag(at, v, t):
    return np.append(-np.array([0.8, 0.5, 0.3]) * v.linear, np.zeros(3))


def spring(at, v, t):
    height, up = 0.1, at.rotation.T @ [0, 0, 1]
    deep = max(height - at.translation[2], 0.0)
    return np.append((40.0 * deep - 1.5 * (deep > 0) * (up @ v.linear)) * up, np.zeros(3))


def thrust(at, v, t):
    u = INPUT[0] * np.sin(INPUT[1] * t)
    return u * abs(u) * np.array([0, 0, 0.4, 0, 0, 0.05])


CASES = {
    "body_drag:c_link": ({"Dx": 0.8, "Dy": 0.5, "Dz": 0.3}, drag),
    "ground_spring:c_link": ({"K": 40.0, "D": 1.5, "height": 0.1}, spring),
    "thrust:c_link": ({"k": 0.4, "d": 0.05}, thrust),
}


def free_motion(model, force):
    """Positions (n, nv) of a tree that a wrench on the last link and gravity move."""
    data, frame = model.createData(), model.getFrameId("c_link", pin.FrameType.BODY)
    index = {name: model.idx_vs[model.getJointId(name)] for name in "abc"}
    start = np.zeros((2, model.nv))
    for key, x in START.items():
        kind, _, name = key.partition(".")
        start["qv".index(kind), index[name]] = x

    def rates(t, x):
        q, v = x.reshape(2, -1)
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        pin.framesForwardKinematics(model, data, q)
        at = data.oMf[frame]
        tau = J.T @ force(at.copy(), pin.Motion(J @ v), t)
        return np.concatenate([v, pin.aba(model, data, q, v, tau)])

    t = np.arange(round(DURATION * RATE) + 1) / RATE
    kept = solve_ivp(rates, (0, DURATION), start.ravel(), "DOP853", t, rtol=1e-11, atol=1e-12)
    return t, kept.y[: model.nv].T


@pytest.mark.parametrize("label", CASES)
def test_a_tree_moves_as_pinocchio_has_it(label, tmp_path):
    values, force = CASES[label]
    mechanism = ident.load(write_mechanism(tmp_path, tree_urdf(JOINTS, seed=3)))
    mechanism = mechanism.with_effect(label, values)
    _, q = free_motion(mechanism.model, force)
    fine = np.arange(round(DURATION * 500) + 1) / 500
    columns = {f"tau.{name}": np.zeros(len(fine)) for name in mechanism.driven}
    columns |= {f"q.{name}": np.zeros(len(fine)) for name in mechanism.driven}
    columns["input.c_link"] = INPUT[0] * np.sin(INPUT[1] * fine)
    log = ident.Log.from_arrays("log", fine, columns)
    drive = ident.Torques(log) if label.startswith("thrust") else None
    run = ident.integrate(mechanism, drive, start=START, duration=DURATION, rate=RATE)
    np.testing.assert_allclose(run.q, q[: len(run.q)], atol=1e-6)


@pytest.mark.parametrize("name", ["four_bar", "five_bar"])
def test_a_loop_supplies_what_a_force_in_it_takes(name):
    mechanism = ident.load(ROBOTS / name)
    link = mechanism.bodies.links[-1]
    mechanism = planted(mechanism, {f"body_drag:{link}": {"Dx": 2.0, "Dy": 1.0, "Dz": 3.0}})
    log = ident.read_log(ROBOTS / name / "run.csv")
    few = log.t < log.t[0] + DURATION
    columns = {name: x[few] for name, x in log.columns.items()}
    run = integrated(mechanism, ident.Log.from_arrays("start", log.t[few], columns))
    assert judged(mechanism, run) < 1e-7


def test_the_command_integrates_it(tmp_path, monkeypatch):
    folder, out = write_mechanism(tmp_path / "m", tree_urdf(JOINTS, seed=3)), tmp_path / "run.csv"
    sizes = zip("xyz", (0.8, 0.5, 0.3), strict=True)
    settings = [f"--set=body_drag.c_link.D{axis}={x}" for axis, x in sizes]
    settings += [f"--start={key}={x}" for key, x in START.items()]
    command = ["ident", "simulate", str(folder), "--forward", "--with", "body_drag:c_link"]
    output = [f"--duration={DURATION}", f"--rate={RATE}", "--out", str(out)]
    monkeypatch.setattr(sys, "argv", [*command, *settings, *output])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    _, q = free_motion(ident.load(folder).model, drag)
    for i, name in enumerate("abc"):
        np.testing.assert_allclose(ident.read_log(out).columns[f"q.{name}"], q[:, i], atol=1e-6)
