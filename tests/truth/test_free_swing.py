"""A machine that swings freely: torques of 0 are what was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ident
from ident.assess.fit import assess_fit
from ident.log import Log

URDF = """<robot name="pendulum"><link name="base"/>
<link name="rod"><inertial><origin xyz="0 0 -0.2"/><mass value="0.4"/>
<inertia ixx="0.004" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.0001"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/>
<axis xyz="0 1 0"/><limit lower="-7" upper="7" velocity="30" effort="5"/></joint></robot>"""
FC, FV = 8e-3, 1e-3  # N m, N m s/rad


@pytest.fixture(scope="module")
def swing() -> tuple[np.ndarray, np.ndarray]:
    """Return times and angles of a pendulum with friction, by small steps of its own equation."""
    inertia, weight, step, q, v, angles = 0.004 + 0.4 * 0.04, 9.81 * 0.08, 2.5e-4, 2.0, 0.0, []
    for k in range(32_000):
        if k % 20 == 0:
            angles.append(q)
        v -= step * (weight * np.sin(q) + FC * np.tanh(v / 5e-4) + FV * v) / inertia
        q += step * v
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(angles))
    return 0.005 * np.arange(len(angles)), np.array(angles) + noise


@pytest.mark.parametrize("passive", [False, True])
def test_friction_of_a_free_pendulum_without_false_warnings(swing, tmp_path: Path, passive: bool):
    (tmp_path / "pendulum.urdf").write_text(URDF)
    joints = 'joints = { passive = ["hinge"] }\n' * passive
    toml = f'urdf = "pendulum.urdf"\nparameters = {{ unknown = [] }}\n{joints}'
    (tmp_path / "mechanism.toml").write_text(toml)
    bare = ident.load(tmp_path)
    mechanism = bare.with_effect("coulomb:hinge").with_effect("viscous:hinge")
    t, q = swing
    columns = {"q.hinge": q} | ({} if passive else {"tau.hinge": 0 * q})
    fit = ident.identify(mechanism, ident.complete(mechanism, Log.from_arrays("free", t, columns)))
    assert fit["coulomb.hinge.Fc"].value == pytest.approx(FC, rel=0.06)
    assert fit["viscous.hinge.Fv"].value == pytest.approx(FV, rel=0.1)
    for name in ("coulomb.hinge.Fc", "viscous.hinge.Fv"):
        value = fit[name]
        assert 1e-3 < value.stderr / value.value < 0.1
    codes = {finding.code for finding in fit.all_findings}
    assert not codes & {"constant", "zero", "calibration", "swings freely", "poor fit"}
    share = assess_fit(fit).freely
    assert share is not None
    assert 0 < share < 0.01


def test_a_dead_channel_of_a_machine_that_is_pushed_is_still_named(tmp_path: Path):
    (tmp_path / "pendulum.urdf").write_text(URDF)
    (tmp_path / "mechanism.toml").write_text('urdf = "pendulum.urdf"\nparameters = {unknown = []}')
    mechanism = ident.load(tmp_path).with_effect("coulomb:hinge")
    t = np.arange(0, 8, 0.005)
    columns = {"q.hinge": np.sin(3 * t), "tau.hinge": 0 * t}
    fit = ident.identify(mechanism, ident.complete(mechanism, Log.from_arrays("dead", t, columns)))
    assert "constant" in {finding.code for finding in fit.all_findings}


def test_friction_that_differs_by_direction_has_a_level_and_a_slope(tmp_path: Path):
    (tmp_path / "pendulum.urdf").write_text(URDF)
    (tmp_path / "mechanism.toml").write_text('urdf = "pendulum.urdf"\nparameters = {unknown = []}')
    mechanism = ident.load(tmp_path).with_calibration("exact")
    for kind in ("coulomb", "viscous", "direction_friction"):
        mechanism = mechanism.with_effect(f"{kind}:hinge")
    t = np.arange(0, 12, 0.005)
    q = np.sin(1.3 * t) + 0.6 * np.sin(3.1 * t)
    v = 1.3 * np.cos(1.3 * t) + 1.86 * np.cos(3.1 * t)
    a = -1.69 * np.sin(1.3 * t) - 5.766 * np.sin(3.1 * t)
    levels, slopes = np.where(v > 0, 0.30, 0.20), np.where(v > 0, 0.06, 0.10)
    tau = 0.02 * a + 9.81 * 0.08 * np.sin(q) + levels * np.sign(v) + slopes * v
    tau += 0.01 * np.random.default_rng(1).standard_normal(len(t))
    columns = {"q.hinge": q, "v.hinge": v, "a.hinge": a, "tau.hinge": tau}
    fit = ident.identify(mechanism, ident.complete(mechanism, Log.from_arrays("two", t, columns)))
    for name, truth in {
        "coulomb.hinge.Fc": 0.25, "viscous.hinge.Fv": 0.08,
        "direction_friction.hinge.dFc": 0.05, "direction_friction.hinge.dFv": -0.02,
    }.items():  # fmt: skip
        assert abs(fit[name].value - truth) < 4 * fit[name].stderr + 1e-3
