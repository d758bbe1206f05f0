"""Dry friction in forward simulation: what sticks, when it slides, where the load is shared."""

import numpy as np
import pytest
from scipy.optimize import brentq

import ident
from helpers import ROBOTS, write_mechanism
from ident import Log

G = 9.81
MASS, SLOPE = 2.0, 0.5
BLOCK = """<robot name="block"><link name="base"/><link name="block"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="s" type="prismatic"><parent link="base"/><child link="block"/>
<origin rpy="0 {slope} 0"/><axis xyz="1 0 0"/>
<limit effort="99" velocity="9" lower="-99" upper="99"/></joint></robot>"""


def block(folder, slope=SLOPE):
    mechanism = ident.load(write_mechanism(folder, BLOCK.format(slope=slope)))
    return mechanism.with_effect("coulomb:s")


PULL = MASS * G * np.sin(SLOPE)


@pytest.mark.parametrize("share", [1.0001, 1.2, 5.0])
def test_a_block_that_friction_can_hold_stays_put(tmp_path, share):
    run = ident.integrate(
        block(tmp_path), values={"coulomb.s.Fc": share * PULL}, start={"s": 0.1}, duration=0.5
    )
    np.testing.assert_array_equal(run.q[:, 0], 0.1)
    np.testing.assert_array_equal(run.v[:, 0], 0.0)
    np.testing.assert_allclose(run.friction["s"], PULL, rtol=1e-12)
    assert run.stuck["s"].all()
    assert not run.transitions


def test_a_block_that_friction_cannot_hold_slides(tmp_path):
    run = ident.integrate(block(tmp_path), values={"coulomb.s.Fc": 0.9 * PULL}, duration=1.0)
    way = 0.5 * 0.1 * PULL / MASS * run.t**2
    np.testing.assert_allclose(run.q[:, 0], way, atol=1e-10)


def test_friction_of_exactly_the_pull_holds(tmp_path):
    run = ident.integrate(block(tmp_path), values={"coulomb.s.Fc": PULL}, duration=0.5)
    assert np.abs(run.q[:, 0]).max() < 1e-9


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_thrown_block_stops_when_it_should(tmp_path, way):
    Fc, v0 = 1.4 * PULL, 2.0
    run = ident.integrate(
        block(tmp_path), values={"coulomb.s.Fc": Fc}, start={"v.s": way * v0}, duration=2.0
    )
    slowing = (Fc - way * PULL) / MASS
    (stop,) = run.transitions
    assert stop.mode == 0
    assert stop.t == pytest.approx(v0 / slowing, abs=1e-9)
    at_rest = run.t > stop.t
    np.testing.assert_array_equal(run.v[at_rest, 0], 0.0)
    np.testing.assert_allclose(run.q[at_rest, 0], way * v0**2 / 2 / slowing, atol=1e-9)
    assert np.ptp(run.q[at_rest, 0]) == 0.0


def test_stick_slip_at_the_analytic_instants(tmp_path):
    """A block on level ground, pulled by F0 sin ωt: breaks away at F0 sin ωt = Fc, and so on."""
    F0, w, Fc = 10.0, 3.0, 6.0
    t = np.arange(0, 4.0, 0.001)
    pull = Log.from_arrays(
        "pull", t, {"q.s": 0 * t + 1e-3 * np.sin(t), "tau.s": F0 * np.sin(w * t)}
    )
    mechanism = block(tmp_path, slope=0.0)
    run = ident.integrate(
        mechanism, ident.Torques(pull), values={"coulomb.s.Fc": Fc}, start={"s": 0.0, "v.s": 0.0}
    )

    def speed(t, since):  # m v̇ = F0 sin ωt − Fc
        return (F0 / w * (np.cos(w * since) - np.cos(w * t)) - Fc * (t - since)) / MASS

    expected, half = [], np.pi / w
    away = np.arcsin(Fc / F0) / w
    stop = brentq(lambda t: speed(t, away), away + 0.1, half + away + 0.5)
    assert stop < half + away  # at rest before the pull is large enough the other way
    for k in range(4):
        expected += [(away + k * half, (-1) ** k), (stop + k * half, 0)]
    expected = [each for each in expected if each[0] < t[-1]]
    assert [each.mode for each in run.transitions] == [mode for _, mode in expected]
    found = [each.t for each in run.transitions]
    np.testing.assert_allclose(found, [at for at, _ in expected], atol=2e-8)


def test_friction_turns_round_without_sticking(tmp_path):
    """A strong spring: half swings of amplitude x₀ − 2 n Fc/k, the classic staircase."""
    k, Fc, x0 = 200.0, 5.0, 0.5
    mechanism = block(tmp_path, slope=0.0).with_effect("spring:s")
    values = {"coulomb.s.Fc": Fc, "spring.s.k": k, "spring.s.b": 0.0}
    run = ident.integrate(mechanism, values=values, start={"s": x0}, duration=4.0, rate=250.0)
    w, d = np.sqrt(k / MASS), Fc / k
    # half swings go on until |x| ≤ Fc/k
    ends = [x0]
    while abs(ends[-1]) > d:
        ends.append(-(ends[-1] - 2 * d * np.sign(ends[-1])))
    times = [each.t for each in run.transitions]
    np.testing.assert_allclose(times, np.arange(1, len(ends)) * np.pi / w, atol=1e-8)
    assert run.transitions[-1].mode == 0
    assert run.q[-1, 0] == pytest.approx(ends[-1], abs=1e-8)
    assert np.ptp(run.q[run.t > times[-1], 0]) == 0.0


# --- several joints ----------------------------------------------------------------------------


def test_friction_of_a_loop_is_shared_by_its_joints():
    """Held as long as Σ F |leverage| suffices, whichever joint holds; the cut pin's joint too."""
    names = ("crank", "coupler", "rocker", "closure.pin")
    mechanism = ident.load(ROBOTS / "four_bar")
    for name in names:
        mechanism = mechanism.with_effect(f"coulomb:{name}")
    log = ident.Log.from_arrays("at", np.arange(20) * 0.01, {"q.crank": np.full(20, 0.3)})
    e = ident.complete(mechanism, log, cutoff=None, torques=False).experiments[0]
    lever = np.array([e.leverage[0, mechanism.joint_index[name], 0] for name in names])
    (needed,) = ident.simulate(ident.load(ROBOTS / "four_bar"), log)[1].predicted[0]
    for share, holds in ((1.001, True), (0.999, False)):
        F = share * abs(needed) / np.abs(lever).sum()
        values = {f"coulomb.{name}.Fc": F for name in names}
        run = ident.integrate(mechanism, values=values, start={"crank": 0.3}, duration=0.3)
        assert run.stuck["crank"][1:].all() == holds
        assert (np.ptp(run.y[:, 0]) < 1e-12) == holds
        assert all(np.abs(f).max() <= F * (1 + 1e-6) for f in run.friction.values()) or holds


def test_friction_in_loops_only_takes_energy():
    """Where every joint has friction: energy falls and the machine comes to rest for good."""
    mechanism = ident.load(ROBOTS / "four_bar")
    names = ("crank", "coupler", "rocker", "closure.pin")
    for name in names:
        mechanism = mechanism.with_effect(f"coulomb:{name}")
    values = {f"coulomb.{name}.Fc": 0.05 for name in names}
    run = ident.integrate(mechanism, values=values, start={"crank": 1.0, "v.crank": -3.0})
    assert run.closure_error < 1e-11
    rates = {name: run.yd[:, mechanism.joint_index[name]] for name in names}
    for name in names:
        power = run.friction[name] * rates[name]
        assert (power >= -1e-9).all()
        sliding = ~run.stuck[name] & (np.abs(rates[name]) > 1e-9)
        np.testing.assert_allclose(np.abs(run.friction[name][sliding]), 0.05, rtol=1e-12)
    rest = run.t > run.transitions[-1].t
    assert rest.sum() > 500
    assert np.abs(run.v[rest]).max() < 1e-14
