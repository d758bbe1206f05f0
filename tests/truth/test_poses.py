"""Rows at rest: tables of poses, and stretches at rest within a motion.

Truth is Pinocchio's regressor with planted parameters; friction at rest is drawn within ± F.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from tests.helpers import ROBOTS

import ident
from ident.errors import LogError
from ident.log import Log, read_log
from ident.mechanism.mechanism import Mechanism

ARM = """<robot name="arm2"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 -0.16"/><mass value="2.6"/>
<inertia ixx="0.022" ixy="0" ixz="0" iyy="0.022" iyz="0" izz="0.003"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.01 0 -0.14"/><mass value="1.5"/>
<inertia ixx="0.011" ixy="0" ixz="0" iyy="0.011" iyz="0" izz="0.0015"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="8" effort="40"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
<origin xyz="0 0 -0.35"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="8" effort="20"/></joint></robot>"""
JOINTS = ("shoulder", "elbow")
F = np.array([0.5, 0.25])  # N m, friction at rest


@pytest.fixture
def arm(tmp_path: Path) -> Mechanism:
    """Return an arm of two joints in the plane, its sensors exact."""
    (tmp_path / "arm2.urdf").write_text(ARM)
    return ident.load(tmp_path / "arm2.urdf").with_calibration("exact")


def torques(mechanism: Mechanism, pi: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return Γ(q, 0, 0) π (n, nv) by Pinocchio."""
    model, zero = mechanism.model, np.zeros(mechanism.model.nv)
    data = model.createData()
    return np.stack([pin.computeJointTorqueRegressor(model, data, x, zero, zero) @ pi for x in q])


def held(mechanism: Mechanism, seed: int, count: int = 30) -> dict[str, np.ndarray]:
    """Return the columns of poses with friction at rest within ± F."""
    random = np.random.default_rng(seed)
    q = random.uniform(-1.3, 1.3, (count, 2))
    tau = torques(mechanism, mechanism.prior, q) + F * random.uniform(-1, 1, (count, 2))
    columns = {f"q.{name}": q[:, i] for i, name in enumerate(JOINTS)}
    return columns | {f"tau.{name}": tau[:, i] for i, name in enumerate(JOINTS)}


def test_poses_are_recognised_without_time_and_by_their_order(arm: Mechanism, tmp_path: Path):
    columns = held(arm, 0)
    zero = {f"{x}.{name}": np.zeros(30) for x in "va" for name in JOINTS}
    order = np.argsort(columns["q.shoulder"])
    by_order = {name: x[order] for name, x in columns.items()}
    for name, given in {
        "no_time": columns,
        "numbered": {"t": np.arange(30.0), **columns},
        "backward": {"t": np.arange(30.0)[::-1], **columns},
        "rates": {"t": np.arange(30.0), **by_order, **zero},
    }.items():
        file = tmp_path / f"{name}.csv"
        table = np.column_stack([*given.values()])
        np.savetxt(file, table, delimiter=",", header=",".join(given), comments="")
        log = read_log(file)
        assert log.poses, name
        log.write(tmp_path / "again.csv")
        assert read_log(tmp_path / "again.csv", poses=True).poses
    t = np.arange(0, 5, 0.01)
    motion = {"q.shoulder": np.sin(t), "q.elbow": np.cos(2 * t), "tau.shoulder": np.sin(t)}
    table = np.column_stack([*motion.values()])
    np.savetxt(file, table, delimiter=",", header=",".join(motion), comments="")
    with pytest.raises(LogError, match="--poses"):  # rows in order, and no time
        read_log(file)
    assert not Log.from_arrays("run", t, motion).poses


def test_gravity_from_poses_is_that_of_least_squares_with_honest_errors(arm: Mechanism):
    inside, errors, references = [], [], []
    for seed in range(12):
        columns = held(arm, seed)
        motion = ident.complete(arm, Log.from_arrays("poses", np.arange(30.0), columns))
        assert motion.poses
        assert motion.experiments[0].rate == 0
        fit = ident.identify(arm, motion)
        base, n = fit.estimate.base, len(fit.columns.rigid)
        truth = base.combined(arm.prior[fit.columns.rigid])
        off = fit.estimate.solution.beta - truth
        inside += [*(np.abs(off) < 1.96 * np.sqrt(np.diag(fit.scatter)))]
        q = np.stack([columns[f"q.{name}"] for name in JOINTS], axis=1)
        tau = np.stack([columns[f"tau.{name}"] for name in JOINTS], axis=1)
        model, zero = arm.model, np.zeros(2)
        data = model.createData()
        gamma = np.stack([pin.computeJointTorqueRegressor(model, data, x, zero, zero) for x in q])
        A = (gamma / F[:, None]).reshape(-1, n)[:, base.independent]
        known = np.linalg.lstsq(A, (tau / F).ravel())[0]
        errors.append(np.sum(off**2))
        references.append(np.sum((known - truth) ** 2))
    assert 0.85 < np.mean(inside) <= 1.0
    assert np.mean(errors) < 1.1 * np.mean(references)
    codes = {finding.code for finding in fit.all_findings}
    assert not codes & {"magnitude", "noise", "poor fit", "standstill"}


def test_poses_and_a_motion_are_fitted_together(arm: Mechanism):
    t = np.arange(0, 6, 0.01)
    q = np.zeros((len(t), 2))
    q[:, 1] = 0.8 * np.sin(2 * t)  # the shoulder is held, and nothing lifts it
    model = arm.model
    data = model.createData()
    v, a = np.zeros_like(q), np.zeros_like(q)
    v[:, 1], a[:, 1] = 1.6 * np.cos(2 * t), -3.2 * np.sin(2 * t)
    rows = zip(q, v, a, strict=True)
    tau = np.stack([pin.rnea(model, data, *row) for row in rows])
    tau[:, 1] += 0.25 * np.sign(v[:, 1])
    tau[:, 0] += 0.3
    columns = {f"{x}.{n}": y[:, i] for x, y in zip(("q", "v", "a", "tau"), (q, v, a, tau),
               strict=True) for i, n in enumerate(JOINTS)}  # fmt: skip
    logs = [Log.from_arrays("run", t, columns), Log.from_arrays("poses", np.arange(30.0),
            held(arm, 1))]  # fmt: skip
    mechanism = arm.with_effect("coulomb")
    fit = ident.identify(mechanism, ident.complete(mechanism, logs))
    assert [e.poses for e in fit.motion.experiments] == [False, True]
    value = fit["upper.mx"]
    assert value.identifiable
    assert value.stderr
    assert abs(value.value) < 3 * value.stderr < 0.1
    friction = fit["coulomb.elbow.Fc"]
    assert friction.value == pytest.approx(0.25, abs=0.02)


KNOWN = """urdf = "arm2.urdf"
parameters = { unknown = [] }
calibration = { clock = "exact", tau = "exact", q = "exact", length = "exact", lateness = "exact" }
effect = [{ kind = "coulomb", joint = "shoulder", Fc = 1.0 },
          { kind = "coulomb", joint = "elbow", Fc = 0.25 }]
"""


def test_a_payload_that_only_held_axes_lift_comes_out_with_friction_at_rest(
    arm: Mechanism, tmp_path: Path
):
    (tmp_path / "mechanism.toml").write_text(KNOWN)
    loaded = ident.load(tmp_path).with_effect("payload:fore")
    random, t, inside = np.random.default_rng(2), np.arange(0, 6, 0.01), []
    model = arm.model
    for _ in range(8):
        mass = random.uniform(1, 3)
        pi = arm.prior.copy()
        load = pin.Inertia(mass, np.array([0.0, 0, -0.3]), 1e-3 * np.eye(3))
        pi[10:] += load.toDynamicParameters()
        q, v, a = np.zeros((3, len(t), 2))
        q[:, 0], q[:, 1] = random.uniform(0.5, 1.2), np.sin(2 * t)
        v[:, 1], a[:, 1] = 2 * np.cos(2 * t), -4 * np.sin(2 * t)
        data = model.createData()
        tau = np.stack([pin.computeJointTorqueRegressor(model, data, *x) @ pi
                        for x in zip(q, v, a, strict=True)])  # fmt: skip
        tau += 0.01 * random.standard_normal(tau.shape)
        tau[:, 0] += random.uniform(-1, 1)
        tau[:, 1] += 0.25 * np.sign(v[:, 1])
        columns = {f"{x}.{n}": y[:, i] for x, y in zip(("q", "v", "a", "tau"), (q, v, a, tau),
                   strict=True) for i, n in enumerate(JOINTS)}  # fmt: skip
        fit = ident.identify(loaded, ident.complete(loaded, Log.from_arrays("wrist", t, columns)))
        value = fit["payload.fore.m"]
        assert value.identifiable
        assert value.stderr
        assert 0.1 < value.stderr < 0.6
        inside.append(abs(value.value - mass) < 1.96 * value.stderr)
    assert np.mean(inside) > 0.7


def test_robots_of_the_project_take_poses(tmp_path: Path):
    mechanism = ident.load(ROBOTS / "four_bar").with_calibration("exact")
    run = read_log(ROBOTS / "four_bar" / "run.csv")
    names = [name for name in run.columns if name.startswith(("q.", "tau."))]
    some = np.random.default_rng(0).permutation(len(run.t))[:40]
    columns = {name: run.columns[name][some] for name in names}
    log = Log.from_arrays("poses", np.arange(40.0), columns)
    motion = ident.complete(mechanism, log, poses=True)
    assert np.abs(motion.experiments[0].v).max() == 0
    assert motion.closure_error < 1e-8


def test_planned_poses_determine_gravity_better_than_random_ones(arm: Mechanism, tmp_path: Path):
    plan = ident.excite_poses(arm, 12, seed=1)
    plan.write(tmp_path / "plan.csv")
    log = read_log(tmp_path / "plan.csv", poses=True)
    assert log.poses
    assert len(log.t) == 12
    q = np.stack([log.columns[f"q.{name}"] for name in JOINTS], axis=1)
    model, zero = arm.model, np.zeros(2)
    data = model.createData()

    def information(q: np.ndarray) -> float:
        rows = [pin.computeJointTorqueRegressor(model, data, x, zero, zero) for x in q]
        some = [arm.bodies.names.index(name) for name in ("fore.mx", "fore.mz")]
        A = np.concatenate([row[:, some] for row in rows])
        return float(np.linalg.slogdet(A.T @ A)[1])

    random = np.random.default_rng(0)
    others = [information(random.uniform(-3, 3, (12, 2))) for _ in range(20)]
    assert information(q) > np.median(others)
    assert all(x.stderr > 0 for x in plan.parameters)
    assert len(plan.parameters) == 4


def test_a_load_that_held_axes_lift_is_named_and_nothing_of_their_own(
    arm: Mechanism, tmp_path: Path
):
    """A first moment of the wrist's motion shows the load; its mass is as open as friction is."""
    (tmp_path / "mechanism.toml").write_text(KNOWN)
    known, random, t = ident.load(tmp_path), np.random.default_rng(5), np.arange(0, 6, 0.01)
    pi = arm.prior.copy()
    pi[10:] += pin.Inertia(1.2, np.array([0.0, 0, -0.1]), 1e-3 * np.eye(3)).toDynamicParameters()
    q, v, a = np.zeros((3, len(t), 2))
    q[:, 0], q[:, 1] = 0.9, np.sin(2 * t)
    v[:, 1], a[:, 1] = 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    data = arm.model.createData()
    rows = zip(q, v, a, strict=True)
    tau = np.stack([pin.computeJointTorqueRegressor(arm.model, data, *x) @ pi for x in rows])
    tau += 0.01 * random.standard_normal(tau.shape)
    tau[:, 0] += 0.8
    tau[:, 1] += 0.25 * np.sign(v[:, 1])
    columns = {f"{x}.{n}": y[:, i] for x, y in zip(("q", "tau"), (q, tau), strict=True)
               for i, n in enumerate(JOINTS)}  # fmt: skip
    motion = ident.complete(known, Log.from_arrays("wrist", t, columns))
    diagnosis = ident.diagnose(ident.identify(known, motion))
    assert diagnosis.best is not None
    assert diagnosis.best.label == "payload:fore"
    assert all("shoulder" not in x.label for x in (diagnosis.best, *diagnosis.group))
    assert not diagnosis.health.findings


def test_poses_grow_a_spring_without_the_past_that_they_have_not(arm: Mechanism):
    columns = held(arm, 3, 60)
    columns["tau.elbow"] = columns["tau.elbow"] + 4.0 * (columns["q.elbow"] - 0.5)
    log = Log.from_arrays("held", np.arange(60.0), columns).as_poses()
    grown = ident.grow(arm, ident.complete(arm, log))
    assert [joint for effect in grown.added for joint in effect.joints] == ["elbow"]
