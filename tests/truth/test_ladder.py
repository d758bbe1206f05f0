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
        return SimpleNamespace(mechanism=mechanism, logged_effects=effects)

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
