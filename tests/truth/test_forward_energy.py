"""Forward simulation without losses keeps its energy, and its closures, in time."""

import time

import numpy as np
import pinocchio as pin
import pytest

import ident
from helpers import ROBOTS, J, tree_urdf, write_mechanism

CASES = {
    "pendulum": {},
    "slider_crank": {"v.theta": 6.0},
    "four_bar": {"q.crank": 0.3, "v.crank": 8.0},
    "five_bar": {"v.left": 1.5, "v.right": -1.0},
}


def drift(mechanism: ident.Mechanism, run: ident.Run) -> float:
    """Largest change of the mechanical energy over the largest kinetic energy."""
    model, data = mechanism.model, mechanism.model.createData()
    states = list(zip(run.q, run.v, strict=True))
    kinetic = np.array([pin.computeKineticEnergy(model, data, q, v) for q, v in states])
    total = kinetic + [pin.computePotentialEnergy(model, data, q) for q, _ in states]
    return float(np.abs(total - total[0]).max() / kinetic.max())


@pytest.mark.parametrize("name", CASES)
def test_a_loop_keeps_energy_and_closures(name):
    mechanism = ident.load(ROBOTS / name)
    began = time.process_time()
    run = ident.integrate(mechanism, start=CASES[name], duration=3.0, rate=100.0)
    assert time.process_time() - began < 5.0
    assert run.t[-1] == pytest.approx(3.0)
    assert drift(mechanism, run) < 1e-7
    rows = mechanism.kinematics.closure_rows(run.q)
    assert np.abs(rows.value).max() < 1e-11
    assert np.abs(np.einsum("nij,nj->ni", rows.rate, run.v)).max() < 1e-10
    assert run.closure_error == np.abs(rows.value).max()


def test_an_arm_of_three_joints_keeps_its_energy(tmp_path):
    joints = [J("a", axis="0 1 0"), J("b", axis="1 0 0", parent="a"), J("c", parent="b")]
    mechanism = ident.load(write_mechanism(tmp_path, tree_urdf(joints, seed=3)))
    run = ident.integrate(mechanism, start={"a": 0.4, "v.b": 2.0}, rate=50.0)
    assert drift(mechanism, run) < 1e-7


def test_the_pendulum_of_the_paper_swings_as_it_was_integrated():
    """run.csv was integrated by another program from θ alone, with the true inertia."""
    pendulum, log = ident.load(ROBOTS / "pendulum"), ident.read_log(ROBOTS / "pendulum/run.csv")
    run = ident.integrate(pendulum, values={"rod.Izz": 0.2}, duration=5.0, rate=100.0)
    for name, series in run.log.columns.items():
        np.testing.assert_allclose(series, log.columns[name], atol=1e-7, err_msg=name)
    reactions = ident.read_log(ROBOTS / "pendulum/reactions.csv")
    known = np.stack(list(reactions.columns.values()), axis=1)
    np.testing.assert_allclose(run.multipliers, known, atol=1e-6)


def test_the_slider_crank_runs_as_it_was_integrated():
    crank, log = (
        ident.load(ROBOTS / "slider_crank"),
        ident.read_log(ROBOTS / "slider_crank/run.csv"),
    )
    true = {"rod.Ixx": 4e-3, "rod.Iyy": 4e-4, "rod.Izz": 4e-3}
    run = ident.integrate(crank, ident.Torques(log), values=true, joints=["theta"])
    np.testing.assert_allclose(run.log.columns["q.theta"], log.columns["q.theta"], atol=1e-8)
    np.testing.assert_allclose(run.log.columns["v.theta"], log.columns["v.theta"], atol=1e-8)
    reactions = ident.read_log(ROBOTS / "slider_crank/reactions.csv")
    known = np.stack(list(reactions.columns.values()), axis=1)
    np.testing.assert_allclose(run.multipliers, known, atol=1e-7)


def test_absolute_coordinates_move_alike():
    """Six coordinates a body, 20 closure equations: the same motion."""
    crank = ident.load(ROBOTS / "slider_crank")
    options = {"duration": 1.0, "rate": 100.0, "joints": ["theta", "s"], "tolerance": 1e-10}
    here = ident.integrate(crank, start={"v.theta": 6.0}, **options)
    free = ident.integrate(ident.absolute(crank), start={"v.theta": 6.0}, **options)
    for name, series in here.log.columns.items():
        size = np.abs(series).max()
        np.testing.assert_allclose(free.log.columns[name], series, atol=1e-7 * size + 1e-12)
    assert free.closure_error < 1e-11
    assert np.abs(np.linalg.norm(free.q.reshape(101, -1, 7)[:, :, 3:], axis=2) - 1).max() < 1e-12
