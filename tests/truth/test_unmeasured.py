"""Joints of a tree without a torque sensor: their equations are left out, all others are exact."""

from dataclasses import replace

import monitored
import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident import Log, Noise
from ident.errors import FitError, MechanismError
from ident.mechanism.load import absolute
from identification import motion_log, plant, robot


@pytest.fixture(scope="module")
def planted():
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    return plant(mechanism, motion_log("arm"), noise=[Noise("tau", 0.01, relative=True)], seed=2)


def without(log, *names):
    columns = {k: x for k, x in log.columns.items() if k not in names}
    return Log.from_arrays(log.name, log.t, columns)


def arm(*names):
    mechanism = ident.load(ROBOTS / "arm", unmeasured=names)
    return mechanism.with_effect("viscous").with_effect("coulomb")


@pytest.mark.parametrize("joint", ["wrist", "elbow", "yaw"])
def test_planted_values_are_found_from_the_other_joints(planted, joint):
    mechanism = arm(joint)
    motion = ident.complete(mechanism, without(planted.log, f"tau.{joint}"), cutoff="auto")
    fit = ident.identify(mechanism, motion)
    x = np.array([planted.values.get(name, 0.0) for name in fit.columns.names])
    base = fit.estimate.base
    true = base.combined(x)
    off = np.abs(fit.estimate.solution.beta - true) / np.sqrt(np.diag(fit.covariance))
    assert 0 < fit.rank < planted.fit(cutoff="auto").rank
    assert np.sqrt(np.mean(off**2)) < 1.5
    assert off.max() < 5
    assert fit.train[joint].unmeasured
    assert all(not e.unmeasured and e.relative < 0.02 for j, e in fit.train.items() if j != joint)


def test_what_a_column_of_that_joint_holds_does_not_matter(planted):
    found = []
    for x in (
        np.zeros(len(planted.log.t)),
        np.random.default_rng(0).normal(size=len(planted.log.t)),
    ):
        columns = {**planted.log.columns, "tau.wrist": x}
        log = Log.from_arrays("run.csv", planted.log.t, columns)
        found.append(ident.identify(arm("wrist"), ident.complete(arm("wrist"), log)).estimate.x)
    np.testing.assert_array_equal(*found)


def test_a_diagnosis_names_what_is_missing_in_the_others_and_nothing_there(planted):
    bare = ident.load(ROBOTS / "arm", unmeasured=["wrist"]).with_effect("viscous")
    motion = ident.complete(bare, without(planted.log, "tau.wrist"), cutoff="auto")
    found = ident.diagnose(ident.identify(bare, motion))
    assert found.best is not None
    assert found.best.kind == "coulomb"
    assert not {"wrist"} & {j for e in (found.best, *found.group) for j in e.joints}
    whole = ident.diagnose(ident.identify(arm("wrist"), motion))
    assert whole.verdict == "nothing"
    assert not whole.fit.residual.traces[0].residual[:, 3].any()


def test_grow_and_files(planted, tmp_path):
    bare = ident.load(ROBOTS / "arm", unmeasured=["wrist"])
    log = without(planted.log, "tau.wrist")
    log.write(tmp_path / "run.csv")
    history = ident.grow(bare, ident.complete(bare, log, cutoff="auto"))
    assert {e.label for e in history.added} >= {"coulomb:yaw", "coulomb:shoulder", "coulomb:elbow"}
    assert not any("wrist" in e.joints for e in history.added)
    history.fit.write(tmp_path / "fit")
    again = ident.load(tmp_path / "fit" / "identified")
    assert again.unmeasured == ("wrist",)
    compared = ident.compare(history.fit, motion=ident.complete(again, tmp_path / "run.csv"))
    ((errors, where),) = zip(compared.errors.values(), compared.where.values(), strict=True)
    assert errors["wrist"].unmeasured
    assert {each.joint for each in where} == {"yaw", "shoulder", "elbow"}


@pytest.mark.parametrize(
    ("name", "joints", "said"),
    [
        ("arm", ["wris"], "did you mean 'wrist'"),
        ("arm", ["yaw", "shoulder", "elbow", "wrist"], "no torque is left"),
        ("five_bar", ["left"], "closures pass its torque on"),
        ("five_bar", ["left_elbow"], "is no driven joint"),
    ],
)
def test_what_cannot_be_left_out_is_refused(name, joints, said):
    with pytest.raises(MechanismError, match=said):
        ident.load(ROBOTS / name, unmeasured=joints)


def test_one_name_is_no_list():
    with pytest.raises(MechanismError, match=r"\['wrist'\]"):
        ident.load(ROBOTS / "arm", unmeasured="wrist")


def test_a_locked_joint_needs_no_torque_either():
    mechanism = ident.load(ROBOTS / "arm", unmeasured=["wrist"], locked={"wrist": None})
    assert mechanism.unmeasured == ()


def test_a_time_basis_needs_all_torques(planted):
    mechanism = replace(absolute(arm("wrist")), multipliers=ident.Multipliers("linear", 0.02))
    motion = ident.complete(mechanism, without(planted.log, "tau.wrist"), cutoff="auto")
    with pytest.raises(FitError, match="--basis free"):
        ident.identify(mechanism, motion)


def test_portions_are_the_log_in_one_piece(planted, tmp_path):
    without(planted.log, "tau.wrist").write(tmp_path / "run.csv")
    whole = ident.identify(arm("wrist"), ident.complete(arm("wrist"), tmp_path / "run.csv"))
    parts = ident.gather(arm("wrist"), [tmp_path / "run.csv"]).fit
    for joint in ("yaw", "shoulder", "elbow"):
        assert parts.train[joint].rms == pytest.approx(whole.train[joint].rms, rel=0.05)
    assert parts.train["wrist"].unmeasured


def test_a_stream_needs_no_torque_there(planted):
    log = without(planted.log, "tau.wrist")
    online = ident.Online(arm("wrist"), like=ident.complete(arm("wrist"), log))
    online.update(log)
    found = online.finish()
    assert found.rank == ident.identify(arm("wrist"), ident.complete(arm("wrist"), log)).rank


def test_a_monitor_watches_the_other_joints():
    """Whatever the column of that joint holds raises no alarm, and it has no error."""
    mechanism = arm("wrist")
    fit = ident.identify(mechanism, monitored.run(1, 25.0))
    monitor = ident.Monitor.of(fit, monitored.run(2, 25.0), patience=4.0)
    design = monitor.design
    charts = design.subjects(monitor.watched.columns.names, monitor.watched.joints)
    watched = {about for about, weight in zip(charts, design.weight, strict=True) if weight > 0}
    errors = {about for about in watched if about.startswith("error of ")}
    assert errors == {f"error of {joint}" for joint in mechanism.measured}
    assert "coulomb.elbow.Fc" in watched
    assert "coulomb.wrist.Fc" not in watched
    harmless = monitored.run(4, 12.0, {6.0: ("", {"coulomb.wrist.Fc": 3.0})})
    assert monitor.fresh().watch(harmless) == []
    (alarm,) = monitor.watch(monitored.run(3, 14.0, {6.0: ("", {"coulomb.elbow.Fc": 1.3})}))
    assert alarm.suspects == ("coulomb:elbow",)
    assert {*alarm.errors} == {*mechanism.measured}


def test_a_joint_whose_torque_is_measured_later_has_not_changed(planted, tmp_path):
    mechanism = arm("wrist")
    motion = ident.complete(mechanism, without(planted.log, "tau.wrist"), cutoff="auto")
    ident.identify(mechanism, motion).write(tmp_path / "fit")
    again = robot("arm").with_effect("viscous").with_effect("coulomb")
    whole = ident.complete(again, planted.log, cutoff="auto")
    saved = ident.read_fit(tmp_path / "fit" / "fit.json", again)
    text = " ".join(str(ident.compare(saved, motion=whole)).split())
    assert "no sign of a change" in text
    assert "changed since" not in text
