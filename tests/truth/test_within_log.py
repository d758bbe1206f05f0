"""An effect that sets in within a log is found, with its place, its size and its time."""

import re

import numpy as np
import pytest

import ident
from ident import Noise
from ident.diagnosis.changes import CODE, change_within
from identification import motion_log, plant, robot

RATE, SECONDS, CHANGED = 200.0, 6.0, 3.3
SENSORS = (Noise("tau", 0.01, relative=True), Noise("q", 1e-5))


@pytest.fixture(scope="module")
def steady():
    """An arm with friction, and what it logs before anything changes."""
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    values = {name: 0.4 for effect in mechanism.effects for name in effect.names}
    case = plant(mechanism, motion_log("arm", RATE, SECONDS), values, noise=SENSORS, seed=3)
    return mechanism, values, case.log


def diagnosed(mechanism, t, columns):
    log = ident.Log.from_arrays("run.csv", t, columns)
    return ident.diagnose(ident.identify(mechanism, ident.complete(mechanism, log)))


def test_friction_that_rises_within_a_log(steady):
    mechanism, values, log = steady
    changed = {**values, "coulomb.elbow.Fc": 1.2}
    other = plant(mechanism, motion_log("arm", RATE, SECONDS), changed, noise=SENSORS, seed=3).log
    columns = {
        name: np.where(log.t >= CHANGED, other.columns[name], x) if name[:4] == "tau." else x
        for name, x in log.columns.items()
    }
    d = diagnosed(mechanism, log.t, columns)
    assert CODE in {finding.code for finding in d.health.findings}
    change = change_within(d.selection.first)
    assert change is not None
    assert change.cause.words == "coulomb:elbow"
    assert change.time == pytest.approx(CHANGED, abs=0.3)
    assert change.values[0] == pytest.approx(0.8, abs=3 * change.stderr[0])
    assert d.best is None  # no effect that acts all the time
    assert "changed within the log" in d.short
    assert "data look wrong" not in d.short


def test_a_push_for_a_while(steady):
    """It is over after a second: no coloured noise, and not `from then on`."""
    mechanism, _, log = steady
    pushed = (log.t >= CHANGED) & (log.t < CHANGED + 0.9)
    columns = {**log.columns, "tau.elbow": log.columns["tau.elbow"] + 2.0 * pushed}
    d = diagnosed(mechanism, log.t, columns)
    meanings = [finding.meaning for finding in d.health.findings if finding.code == CODE]
    assert meanings
    assert "a push on elbow" in meanings[0]
    assert float(re.search(r"t = ([0-9.]+) to", meanings[0])[1]) == pytest.approx(CHANGED, abs=0.3)


def test_nothing_changes_in_a_steady_log(steady):
    mechanism, _, log = steady
    d = diagnosed(mechanism, log.t, dict(log.columns))
    assert CODE not in {finding.code for finding in d.health.findings}
    assert change_within(d.selection.first) is None


def test_friction_that_rises_within_a_log_is_no_noise(steady):
    """What is left follows the motion with one sign before, with the other after."""
    mechanism, values, log = steady
    changed = {**values, "coulomb.elbow.Fc": 1.2}
    other = plant(mechanism, motion_log("arm", RATE, SECONDS), changed, noise=SENSORS, seed=3).log
    columns = {
        name: np.where(log.t >= SECONDS / 2, other.columns[name], x) if name[:4] == "tau." else x
        for name, x in log.columns.items()
    }
    rising = ident.Log.from_arrays("run.csv", log.t, columns)
    fits = [ident.identify(mechanism, ident.complete(mechanism, x)) for x in (log, rising)]
    steady_noise, noise = (fit.noise["elbow"] for fit in fits)
    assert fits[1].train["elbow"].rms > 5 * steady_noise
    assert noise < 1.3 * steady_noise


def test_a_wrong_joint_makes_no_noise_of_others(steady):
    """A spring in the shoulder that the model lacks spoils bodies that the elbow moves too."""
    mechanism, values, log = steady
    sprung = mechanism.with_effect("spring:shoulder")
    given = {**values, "spring.shoulder.k": 25.0, "spring.shoulder.b": 0.0}
    log = plant(sprung, motion_log("arm", RATE, SECONDS), given, noise=SENSORS, seed=3).log
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    known = ident.identify(sprung, ident.complete(sprung, log))
    for joint, noise in known.noise.items():
        assert fit.noise[joint] < 1.3 * noise


def warmed(steady, joints, start=0.0):
    """The diagnosis of a log in which the friction of joints falls by a third from a time on."""
    mechanism, values, _ = steady
    motion, without = motion_log("arm", RATE, 2 * SECONDS), dict.fromkeys(values, 0.0)
    log = plant(mechanism, motion, values, noise=SENSORS, seed=3).log
    rigid = plant(mechanism, motion, without, seed=3).log
    share = 1 - 0.33 * np.maximum(log.t - start, 0) / (np.ptp(log.t) - start)
    columns = {
        name: rigid.columns[name] + share * (x - rigid.columns[name])
        if name in {f"tau.{joint}" for joint in joints}
        else x
        for name, x in log.columns.items()
    }
    d = diagnosed(mechanism, log.t, columns)
    return d, next(x for x in d.health.findings if x.code == CODE)


def test_friction_that_falls_as_the_machine_warms(steady):
    """All friction falls by a third over the log: no exchange of torques by a few percent."""
    d, finding = warmed(steady, steady[0].driven)
    assert re.search(r"(coulomb|viscous):\w+ changes steadily", finding.meaning)
    assert finding.meaning.startswith("all through run.csv")
    assert {*finding.where} == {"run.csv", *steady[0].driven}
    size = float(re.search(r"([-+][0-9]+) % of its value until the end", finding.meaning)[1])
    assert size == pytest.approx(-100 * 0.33 / (1 - 0.33 / 2), abs=8)
    assert "temperature_friction" in finding.remedy
    assert "Next: warm" in d.short


def test_one_joint_that_warms_is_the_only_one(steady):
    _, finding = warmed(steady, ["elbow"])
    assert finding.where == ("run.csv", "elbow")
    assert "all through" in finding.meaning


def test_friction_that_changes_from_some_time_on_has_that_time(steady):
    _, finding = warmed(steady, ["elbow"], start=SECONDS)
    time = re.search(r"from t = ([0-9.]+) s", finding.meaning)
    assert float(time[1]) == pytest.approx(SECONDS, abs=1.5)


def test_the_interval_of_a_change_holds_errors_of_the_calibration(steady):
    """Torques are read up to 6 % wrong, which no noise shows, by gains that are good for 3 %."""
    mechanism, values, _ = steady
    changed, sensors = {**values, "coulomb.elbow.Fc": 3.4}, (Noise("tau", 0.001, relative=True),)
    before, after = (
        plant(mechanism, motion_log("arm", RATE, SECONDS), x, noise=sensors, seed=3).log
        for x in (values, changed)
    )
    gains = 1.06, 1.06, 1.06, 0.94
    columns = {
        name: np.where(before.t >= CHANGED, after.columns[name], x) if name[:4] == "tau." else x
        for name, x in before.columns.items()
    }
    for joint, gain in zip(mechanism.driven, gains, strict=True):
        columns[f"tau.{joint}"] = gain * columns[f"tau.{joint}"]
    log = ident.Log.from_arrays("run.csv", before.t, columns)
    changes = []
    for calibration in ("exact", "tau=3%"):
        calibrated = mechanism.with_calibration(calibration)
        d = ident.diagnose(ident.identify(calibrated, ident.complete(calibrated, log)))
        change = change_within(d.selection.first)
        assert change is not None
        assert change.cause.words == "coulomb:elbow"
        changes.append(change)
    by_noise, by_all = (float(change.stderr[0]) for change in changes)
    off = abs(changes[1].values[0] - 3.0)
    assert off > 3 * by_noise
    assert off < 3 * by_all
    assert by_all == pytest.approx(0.03 * changes[1].values[0], rel=0.5)
    assert f"± {by_all:.1g}" in changes[1].finding().meaning
