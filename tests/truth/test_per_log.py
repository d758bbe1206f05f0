"""Effects with values of their own in each log: planted ones are identified, kept, predicted."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident import Log, MechanismError
from identification import motion_log, robot

OFFSETS = {"first.csv": 0.4, "second log.csv": -0.3, "third.csv": 0.1}  # N m


@pytest.fixture(scope="module")
def logs():
    arm, made = robot("arm").with_effect("torque_offset:elbow"), {}
    for period, (name, offset) in zip((4.0, 3.0, 5.0), OFFSETS.items(), strict=True):
        motion = motion_log("arm", 100.0, 4.0, period)
        log, _ = ident.simulate(arm, motion, values={"torque_offset.elbow.c": offset})
        made[name] = Log.from_arrays(name, log.t, log.columns)
    return made


@pytest.fixture(scope="module")
def fit(logs):
    arm = robot("arm").with_effect("torque_offset:elbow@log")
    motion = ident.complete(arm, [logs["first.csv"], logs["second log.csv"]])
    return ident.identify(arm, motion, validate=ident.complete(arm, logs["third.csv"]))


def test_each_log_has_its_value(fit):
    for name, word in (("first.csv", "first"), ("second log.csv", "second_log")):
        value = fit[f"torque_offset.elbow@{word}.c"]
        assert value.value == pytest.approx(OFFSETS[name], abs=1e-5)
        assert value.identifiable
    assert max(e.relative for e in fit.train.values()) < 1e-6
    assert max(e.relative for e in fit.held_out.values()) < 1e-6


def test_a_log_without_a_value_has_the_mean(fit):
    """Of 0.4 and −0.3 it is 0.05, so 0.05 of the true 0.1 N m are left."""
    errors = fit.validation["third.csv"]
    assert errors["elbow"].rms == pytest.approx(0.05, abs=1e-4)
    assert errors["yaw"].relative < 1e-6


def test_a_correction_has_its_value_too(logs):
    """Zeros of an encoder that is set anew before each log."""
    known = replace(robot("arm"), unknown=())
    zeros, read = (0.02, -0.01), []
    for zero, (name, log) in zip(zeros, list(logs.items())[:2], strict=True):
        truth, _ = ident.simulate(known, log)
        columns = {**truth.columns, "q.elbow": truth.columns["q.elbow"] - zero}
        read.append(Log.from_arrays(name, truth.t, columns))
    model = known.with_effect("encoder_offset:elbow@log")
    fit = ident.identify(model, ident.complete(model, read))
    found = [value.value for effect in fit.effects for value in effect.parameters]
    np.testing.assert_allclose(found, zeros, atol=2e-4)


def test_toml_and_json_state_it(fit, logs, tmp_path):
    (tmp_path / "arm.urdf").write_bytes((ROBOTS / "arm" / "arm.urdf").read_bytes())
    effect = '[[effect]]\nkind = "torque_offset"\njoint = "elbow"\nper = "log"\n'
    (tmp_path / "mechanism.toml").write_text(f'urdf = "arm.urdf"\n{effect}')
    arm = ident.load(tmp_path).with_calibration("exact")
    assert [e.label for e in arm.effects] == ["torque_offset:elbow@log"]
    fit.write(tmp_path / "out")
    entries = json.loads((tmp_path / "out" / "fit.json").read_text())["effects"]
    assert [entry["log"] for entry in entries] == ["first.csv", "second log.csv"]
    saved = ident.read_fit(tmp_path / "out", arm)
    motion = ident.complete(arm, logs["first.csv"])
    assert ident.compare(saved, motion=motion).errors
    known = ident.load(tmp_path / "out" / "identified")
    assert {effect.log for effect in known.effects} == {"first.csv", "second log.csv"}
    again = ident.identify(known, ident.complete(known, logs["third.csv"]))
    assert again.train["elbow"].rms == pytest.approx(0.05, abs=1e-3)


def test_an_error_of_the_calibration_is_not_counted_twice(logs):
    from ident.mechanism.causes import causes_of

    arm = ident.load(ROBOTS / "arm").with_effect("encoder_offset:elbow@log")
    names = [cause.name for cause in causes_of(arm, ("yaw", "elbow"), 100.0)]
    assert "zero of q.elbow" not in names
    assert "zero of q.yaw" in names


def test_what_is_no_log_is_refused(tmp_path, logs):
    (tmp_path / "arm.urdf").write_bytes((ROBOTS / "arm" / "arm.urdf").read_bytes())
    effect = '[[effect]]\nkind = "viscous"\njoint = "elbow"\nper = "day"\n'
    (tmp_path / "mechanism.toml").write_text(f'urdf = "arm.urdf"\n{effect}')
    with pytest.raises(MechanismError, match='valid: "log"'):
        ident.load(tmp_path)
