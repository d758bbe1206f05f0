"""C code: Pinocchio's torques, ident's motion, strict warnings, and its speed."""

import ctypes
import subprocess

import numpy as np
import pinocchio as pin
import pytest
from compiled import FLAGS, caller, compiler, library
from every_effect import every_effect
from public_robots import CENTRE, public_robot

import ident
from ident import Torques
from ident.export.c import SMOOTH
from ident.export.export import export
from ident.log import Log

TREE = [
    "void inverse_dynamics(const REAL q[],const REAL v[],const REAL a[],REAL tau[])",
    "void gravity(const REAL q[],REAL tau[])",
    "void regressor(const REAL q[],const REAL v[],const REAL a[],REAL Y[])",
]


@pytest.fixture(scope="module")
def panda(tmp_path_factory):
    """A robot of seven joints with friction and rotors, its header written."""
    folder = tmp_path_factory.mktemp("panda")
    mechanism = ident.load(public_robot("panda", folder / "robot"))
    for kind in ("viscous", "coulomb", "rotor_inertia"):
        mechanism = mechanism.with_effect(kind)
    random = np.random.default_rng(1)
    values = {n: float(random.uniform(0.1, 0.5)) for e in mechanism.effects for n in e.names}
    made = export(mechanism, "c", values=values, out=folder / "panda.h")
    made.write()
    assert made.lost == ()
    return mechanism, values, folder


def expected(mechanism, values, q, v, a):
    model = mechanism.model
    tau = pin.rnea(model, model.createData(), q, v, a)
    Fv, Fc, Ia = (
        np.array([values[f"{kind}.{j}.{p}"] for j in mechanism.driven])
        for kind, p in (("viscous", "Fv"), ("coulomb", "Fc"), ("rotor_inertia", "Ia"))
    )
    return tau + Fv * v + Fc * np.tanh(v / SMOOTH) + Ia * a


def test_torques_and_regressor_are_pinocchios(panda):
    mechanism, values, folder = panda
    built = library(folder, "panda", TREE)
    random, n = np.random.default_rng(0), 7
    model = mechanism.model
    data = model.createData()
    for _ in range(50):
        q, v, a = random.normal(size=(3, n))
        tau, Y, g = np.zeros(n), np.zeros((10 * n, n)), np.zeros(n)
        caller(built.x_inverse_dynamics)(q, v, a, tau)
        np.testing.assert_allclose(tau, expected(mechanism, values, q, v, a), rtol=0, atol=1e-12)
        caller(built.x_regressor)(q, v, a, Y)
        np.testing.assert_allclose(
            Y.T, pin.computeJointTorqueRegressor(model, data, q, v, a), rtol=0, atol=1e-12
        )
        caller(built.x_gravity)(q, g)
        np.testing.assert_allclose(
            g, pin.computeGeneralizedGravity(model, data, q), rtol=0, atol=1e-12
        )
    assert "malloc" not in (folder / "panda.h").read_text()


def test_torques_of_every_effect_are_idents(robots, tmp_path):
    mechanism, values, states = every_effect(robots)
    made = export(mechanism, "c", values=values, out=tmp_path / "arm.h")
    made.write()
    assert made.lost == ()
    built = library(tmp_path, "arm", TREE[:1])
    for q, v, a, right in states:
        tau = np.zeros(4)
        caller(built.x_inverse_dynamics)(q, v, a, tau)
        np.testing.assert_allclose(tau, right, rtol=0, atol=1e-9)


def test_single_precision(panda, tmp_path):
    mechanism, values, _ = panda
    export(mechanism, "c", values=values, out=tmp_path / "panda.h", real="float").write()
    assert "double" not in (tmp_path / "panda.h").read_text()
    built = library(tmp_path, "panda", TREE[:1], "float")
    q, v, a = np.random.default_rng(0).normal(size=(3, 7))
    tau = np.zeros(7, dtype=np.float32)
    single = [x.astype(np.float32) for x in (q, v, a)]
    caller(built.x_inverse_dynamics, "float")(*single, tau)
    right = expected(mechanism, values, *(x.astype(float) for x in single))
    np.testing.assert_allclose(tau, right, rtol=0, atol=2e-5 * np.abs(right).max())


BENCH = """#include <stdio.h>
#include <time.h>
#include "panda.h"
int main(void)
{
    double q[7], v[7], a[7], out[490], sum = 0;
    for (int f = 0; f < 3; f++) {
        double best = 1e9;
        for (int k = 0; k < 9; k++) {
            const clock_t begin = clock();
            for (int i = 0; i < 20000; i++) {
                for (int j = 0; j < 7; j++) { q[j] = i * 1e-4 + j; v[j] = .5 * j; a[j] = .1 * j; }
                if (f == 0) panda_inverse_dynamics(q, v, a, out);
                else if (f == 1) panda_gravity(q, out);
                else panda_regressor(q, v, a, out);
                sum += out[0];
            }
            const double us = (double)(clock() - begin) / CLOCKS_PER_SEC / 20000 * 1e6;
            if (us < best) best = us;
        }
        printf("%.4f ", best);
    }
    return sum > 1e300;
}
"""


def microseconds(folder) -> list[float]:
    """Time of a call [µs]: inverse dynamics, gravity, regressor."""
    (folder / "bench.c").write_text(BENCH)
    subprocess.run(
        [compiler(), "-std=gnu99", "-O3", "-o", "bench", "bench.c", "-lm"], cwd=folder, check=True
    )
    done = subprocess.run(["./bench"], cwd=folder, check=True, capture_output=True, text=True)
    return [float(x) for x in done.stdout.split()]


def test_fast_enough_for_any_controller(panda):
    """Generous, as other processes have the machine too; the figures are printed."""
    times = microseconds(panda[2])
    print("inverse dynamics, gravity, regressor [µs]:", times)
    assert times[0] < 3.0


def moved(built, name, n, dof, start, tau, duration, steps):
    """Return positions of the independent joints after steps of equal length."""
    state = ctypes.create_string_buffer(8 * (2 * dof + n) + 8 * dof + 64)
    zero = np.zeros(dof)
    assert caller(built.x_start)(state, start, zero)
    found = [start.copy()]
    for _ in range(steps):
        assert caller(built.x_step)(state, tau, duration / steps)
        found.append(np.frombuffer(state, dtype=float, count=dof).copy())
    return np.array(found)


@pytest.mark.parametrize("name", ["arm", "four_bar", "five_bar"])
def test_the_motion_is_idents(name, robots, tmp_path):
    """Constant torques, from rest: joints slide, stop and stick."""
    mechanism = ident.load(robots / name)
    for kind in ("viscous", "coulomb", "rotor_inertia"):
        for joint in mechanism.driven:
            mechanism = mechanism.with_effect(f"{kind}:{joint}")
    values = {full: 0.05 for e in mechanism.effects for full in e.names}
    made = export(mechanism, "c", values=values, out=tmp_path / "machine.h")
    made.write()
    calls = [
        "int start(machine_state *s,const REAL q[],const REAL v[])",
        "int step(machine_state *s,const REAL tau[],REAL duration)",
    ]
    built = library(tmp_path, "machine", calls)
    from ident.export.equations import Equations

    joints = Equations(made.translation, SMOOTH).independent
    start = np.array([mechanism.assembled[mechanism.joint(j).index] for j in joints])
    tau, t = 0.3 * np.ones(len(joints)), np.linspace(0, 0.6, 61)
    n = len(made.machine.links)
    found = moved(built, "machine", n, len(joints), start, tau, 0.6, 60)
    columns = {f"tau.{j}": np.full(61, 0.3) for j in joints}
    columns |= {f"q.{j}": np.full(61, x) for j, x in zip(joints, start, strict=True)}
    run = ident.integrate(
        mechanism, Torques(Log.from_arrays("constant", t, columns)), values=values, rate=100.0
    )
    at = [mechanism.joint_index[j] for j in joints]
    np.testing.assert_allclose(found, run.y[:, at], rtol=0, atol=1e-6)
    assert np.ptp(found, axis=0).max() > 0.01


def test_loops_have_the_torques_of_ident(robots, tmp_path):
    mechanism = ident.load(robots / "five_bar").with_effect("viscous")
    values = {full: 0.2 for e in mechanism.effects for full in e.names}
    export(mechanism, "c", values=values, out=tmp_path / "five.h").write()
    built = library(
        tmp_path, "five",
        ["int inverse_dynamics(const REAL q[],const REAL v[],const REAL a[],REAL tree[],"
         "REAL tau[])"],
    )  # fmt: skip
    t = np.arange(0.0, 2.0, 0.005)
    columns = {}
    for i, joint in enumerate(("left", "right")):
        q0, w = mechanism.assembled[mechanism.joint(joint).index], 3.0 + i
        columns |= {
            f"q.{joint}": q0 + 0.2 * np.sin(w * t),
            f"v.{joint}": 0.2 * w * np.cos(w * t),
            f"a.{joint}": -0.2 * w * w * np.sin(w * t),
        }
    log, _ = ident.simulate(mechanism, Log.from_arrays("run", t, columns), values=values)
    tree = mechanism.assembled.copy()
    for k in range(0, len(log.t), 20):
        q, v, a = (np.array([log.columns[f"{c}.{j}"][k] for j in ("left", "right")]) for c in "qva")
        tau = np.zeros(2)
        assert caller(built.x_inverse_dynamics)(q, v, a, tree, tau)
        right = [log.columns[f"tau.{j}"][k] for j in ("left", "right")]
        np.testing.assert_allclose(tau, right, rtol=0, atol=1e-10)


def test_flags_are_strict():
    assert {"-Wconversion", "-Werror", "-std=c99"} <= {*FLAGS}
    assert CENTRE


def test_the_example_of_a_loop_follows_its_reference(root, tmp_path):
    mechanism = ident.load(root / "robots" / "arm")
    for kind in ("viscous", "coulomb"):
        for joint in mechanism.driven:
            mechanism = mechanism.with_effect(f"{kind}:{joint}")
    values = {full: 0.1 for e in mechanism.effects for full in e.names}
    export(mechanism, "c", values=values, out=tmp_path / "arm.h").write()
    source = (root / "examples" / "control_loop.c").read_text()
    (tmp_path / "control_loop.c").write_text(source)
    subprocess.run(
        [compiler(), *FLAGS, "-I.", "-o", "loop", "control_loop.c", "-lm"], cwd=tmp_path, check=True
    )
    done = subprocess.run(["./loop"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_drives_follow_late_commands_within_limits(robots, tmp_path):
    mechanism = ident.load(robots / "servo_arm")
    kp, kd = {"yaw": 20.0, "shoulder": 30.0, "elbow": 10.0}, 0.7
    own = {"yaw": "limit=0.8", "shoulder": "delay=0.004", "elbow": "limit=99"}
    for joint, words in own.items():
        mechanism = mechanism.without(f"servo:{joint}")
        mechanism = mechanism.with_drives(f"{joint}:kp={kp[joint]},kd={kd},{words}")
    late = {n: 0.0 for e in mechanism.effects if e.kind == "command_delay" for n in e.names}
    values = {n: 0.1 for e in mechanism.effects for n in e.names if "servo" not in n} | late
    export(mechanism, "c", values=values, out=tmp_path / "servo.h").write()
    built = library(
        tmp_path, "servo",
        ["void drives_command(servo_drives *d,REAL t,const REAL command[],const REAL rate[],"
         "const REAL feedforward[])",
         "int drives_torque(const servo_drives *d,REAL t,const REAL q[],const REAL v[],"
         "REAL tau[])"],
    )  # fmt: skip
    state = ctypes.create_string_buffer(8 * 64 * (1 + 3 * 3) + 64)
    random, dt, tau = np.random.default_rng(0), 1e-3, np.zeros(3)
    command, torque = caller(built.x_drives_command), caller(built.x_drives_torque)
    assert not torque(state, 0.0, tau, tau, np.zeros(3))
    commands = random.normal(scale=0.1, size=(200, 3))
    for k, ref in enumerate(commands):
        q, v = random.normal(scale=0.1, size=(2, 3))
        feedforward = np.full(3, 0.01)
        command(state, k * dt, ref, None, feedforward)
        assert torque(state, k * dt, q, v, tau)
        late = np.array([ref[0], commands[max(k - 4, 0)][1], ref[2]])
        expected = np.array([*kp.values()]) * (late - q) - kd * v + feedforward
        expected[0] = np.clip(expected[0], -0.8, 0.8)
        np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-12)
    assert not torque(state, 0.13, q, v, tau)  # older than all commands that are held
