"""Rungs of a ladder that are announced, and the fit that ends it."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import ident
from helpers import ROBOTS
from ident.diagnosis.grow import _contradicted, undetermined
from ident.diagnosis.result import announced_errors
from ident.information.blocks import Error
from ident.show.ladder import _larger


def test_a_fit_that_leaves_more_contradicts_what_was_announced():
    announced = {"yaw": Error(0.2, 0.02, "N m"), "lift": Error(1.0, None, "N")}
    for rms, expected in ((0.1, False), (0.201, False), (0.5, True)):
        fitted = {"yaw": Error(rms, rms / 10, "N m"), "lift": Error(2.0, None, "N")}
        assert _contradicted(announced, fitted, 0.003) is expected


def test_a_spring_with_preload_leaves_no_offset_beside_it():
    arm, run = ident.load(ROBOTS / "arm"), ident.read_log(ROBOTS / "arm" / "run.csv")
    true = arm.with_effect("viscous").with_effect("coulomb").with_effect("spring:elbow")
    values = {name: 0.5 for effect in true.effects for name in effect.names}
    values |= {"spring.elbow.k": 6.0, "spring.elbow.b": -14.0}
    noise = [ident.Noise("tau", 0.003, True), ident.Noise("q", 1e-4)]
    log, _ = ident.simulate(true, run, values=values, noise=noise, seed=1, columns=["q", "tau"])
    grown = ident.grow(arm, ident.complete(arm, log))
    found = {effect.label for effect in grown.added if "elbow" in effect.joints}
    assert found == {"viscous:elbow", "coulomb:elbow", "spring:elbow"}
    # also where the next rung leaves more in a joint
    assert all(len({effect.kind for effect in step.added}) <= 1 for step in grown.steps)


# --- validation ----------------------------------------------------------------------------------


def test_an_error_that_was_smaller_on_an_earlier_rung_is_told():
    def fit(**sizes):
        errors = {joint: Error(size, size, "N m") for joint, size in sizes.items()}
        return SimpleNamespace(validation={"other.csv": errors})

    rungs = [fit(a=0.5, b=0.3), fit(a=0.2, b=0.1), fit(a=0.3, b=0.105)]
    said = _larger(SimpleNamespace(fits=rungs, fit=rungs[-1], stopped=""))
    assert "On other.csv an earlier rung predicts a (20 % instead of 30 %) better" in said
    assert "b (" not in said
    assert not _larger(SimpleNamespace(fits=rungs[:2], fit=rungs[1], stopped=""))
    ended = _larger(SimpleNamespace(fits=rungs[:2], fit=rungs[1], stopped="cable:a: it rises"))
    assert "cable:a: it rises" in ended


def test_corrections_must_stand_out_of_their_errors():
    """An encoder offset of 26° ± 10° is no name, an offset of a torque of that sureness stays."""
    mechanism = ident.load(ROBOTS / "arm")
    for label in ("encoder_offset:elbow", "torque_offset:elbow"):
        mechanism = mechanism.with_effect(label)

    def values(value, stderr):
        own = (SimpleNamespace(value=value, stderr=stderr),)
        effects = [SimpleNamespace(effect=e, parameters=own) for e in mechanism.effects]
        return SimpleNamespace(
            mechanism=mechanism, without_faults=None, effects_with=lambda covariance: effects
        )

    assert undetermined(values(-0.45, 0.18), mechanism.effects) == "encoder_offset:elbow"
    assert undetermined(values(-0.45, 0.1), mechanism.effects) == ""


def test_errors_with_pauses_are_announced_in_motion():
    """Half of the log stands still, where friction holds any torque: those rows inform a model
    without dry friction alone.
    """
    arm, run = ident.load(ROBOTS / "arm"), ident.read_log(ROBOTS / "arm" / "run.csv")
    speed = 1.5 * np.maximum(0.0, np.sin(2 * np.pi * run.t / 2.5)) ** 2
    phase = np.cumsum(speed) * np.median(np.diff(run.t))
    columns = {name: CubicSpline(run.t, x)(phase) for name, x in run.columns.items()
               if name.startswith("q.")}  # fmt: skip
    true = arm.with_effect("viscous").with_effect("coulomb")
    values = {name: 6.0 if "coulomb" in name else 1.0 for e in true.effects for name in e.names}
    noise = [ident.Noise("tau", 0.003, True), ident.Noise("q", 1e-5)]
    log, _ = ident.simulate(
        true, ident.Log.from_arrays("pauses", run.t, columns), values=values, noise=noise, seed=1,
        columns=["q", "tau"],
    )  # fmt: skip
    # what sticking holds where nothing moves no model predicts
    held = 3.0 * np.sin(log.t) * (np.interp(log.t, run.t, speed) < 1e-3)
    stuck = {n: x + held * n.startswith("tau.") for n, x in log.columns.items()}
    motion = ident.complete(arm, ident.Log.from_arrays("pauses", log.t, stuck))
    _, first, *_ = ident.grow(arm, motion).steps
    assert {effect.label for effect in first.added} == {f"coulomb:{name}" for name in arm.driven}
    refitted = ident.identify(arm.with_effect("coulomb"), motion).held_out
    for joint, error in refitted.items():
        assert first.errors[joint].relative == pytest.approx(error.relative, rel=0.25)


def test_what_has_no_rows_is_announced_as_it_was():
    errors = {"yaw": Error(0.2, 0.02, "N m"), "locked": Error(1.0, 0.1, "N m")}
    now = announced_errors(errors, np.array([4.0, 0.0]), np.array([1.0, 0.0]))
    assert [e.rms for e in now.values()] == [0.1, 1.0]


TWO_AXES = """<robot name="two"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 -0.16"/><mass value="2.6"/>
<inertia ixx=".022" iyy=".022" izz=".003" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0 0 -0.14"/><mass value="1.5"/>
<inertia ixx=".011" iyy=".011" izz=".0015" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/></joint><joint name="elbow" type="continuous"><parent link="upper"/>
<child link="fore"/><origin xyz="0 0 -0.35"/><axis xyz="0 1 0"/></joint></robot>"""


def test_two_offsets_of_a_second_session_are_both_found(tmp_path):
    """The elbow's encoder was zeroed otherwise, the shoulder's amplifier has another zero."""
    (tmp_path / "two.urdf").write_text(TWO_AXES)
    bare = ident.load(tmp_path / "two.urdf").with_effect("viscous").with_effect("coulomb")
    friction = dict(
        zip([n for e in bare.effects for n in e.names], (0.5, 0.2, 0.6, 0.3), strict=True)
    )
    t, logs = np.arange(0.0, 12.0, 0.008), []
    for seed in (1, 2):
        rng, columns = np.random.default_rng(seed), {}
        for name in ("shoulder", "elbow"):
            a, b = rng.normal(size=(2, 7)) * 1.4 / np.arange(1, 8)
            w = 2 * np.pi * np.arange(1, 8) / 12.0
            columns[f"q.{name}"] = np.sin(np.outer(t, w)) @ a + np.cos(np.outer(t, w)) @ b
        noise = [ident.Noise("tau", 0.006, relative=True), ident.Noise("q", 2e-5)]
        log, _ = ident.simulate(
            bare,
            ident.Log.from_arrays(f"s{seed}", t, columns),
            values=friction,
            noise=noise,
            seed=seed,
        )
        kept = {n: x for n, x in log.columns.items() if n.startswith(("q.", "tau."))}
        logs.append(ident.Log.from_arrays(f"s{seed}", log.t, kept))
    first, second = logs
    fit = ident.identify(bare, ident.complete(bare, first))
    fit.write(tmp_path / "out")
    columns = dict(second.columns)
    columns["q.elbow"] = columns["q.elbow"] + 0.105
    columns["tau.shoulder"] = columns["tau.shoulder"] - 0.7
    known = ident.load(tmp_path / "out" / "identified")
    changed_log = ident.Log.from_arrays("s2", second.t, columns)
    history = ident.grow(known, ident.complete(known, changed_log))
    added = {effect.label for step in history.steps for effect in step.added}
    assert {"torque_offset:shoulder", "encoder_offset:elbow"} <= added
