"""What a torque channel is, held against torques that were made to be that."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import ident
from helpers import ROBOTS
from ident import Log, Noise
from ident.motion.torque_class import (
    TorqueClass,
    informing,
    switched_levels,
    torque_verdict,
    torque_verdicts,
)
from identification import motion_log, plant, robot

T = np.arange(0.0, 8.0, 0.005)
NOISY = np.random.default_rng(0).normal(size=len(T))
SINE = np.sin(3 * T) + 0.4 * np.cos(7.1 * T)
MEASURED = SINE + 0.01 * NOISY
CHANNELS = {
    "a measurement": (MEASURED, TorqueClass.MEASURED, ""),
    "constant": (np.full(len(T), 1.2), TorqueClass.DEAD, "constant"),
    "noise": (0.01 * NOISY, TorqueClass.DEAD, "noise_only"),
    "three values": (2.0 * np.sign(np.round(SINE)), TorqueClass.COMMANDED, "switched"),
    "two values": (2.0 * np.sign(SINE), TorqueClass.COMMANDED, "switched"),
    "held": (np.repeat(MEASURED[::8], 8), TorqueClass.COMMANDED, "staircase"),
    "zero": (np.where(SINE > 0, MEASURED, 0.0), TorqueClass.COMMANDED, "zero"),
    "clipped": (np.clip(MEASURED, -0.6, 0.6), TorqueClass.MEASURED, ""),
    "a coarse sensor": (0.25 * np.round(4 * MEASURED), TorqueClass.MEASURED, ""),
}


@pytest.mark.parametrize("name", CHANNELS)
def test_the_class_of_samples(name):
    x, kind, cause = CHANNELS[name]
    verdict = torque_verdict("tau.a", x, np.ones(len(x), dtype=bool), {"tau.a": x})
    assert (verdict.kind, verdict.cause) == (kind, cause)


def test_a_command_is_found_by_its_column_or_by_its_missing_noise():
    moving = np.ones(len(T), dtype=bool)
    columns = {"tau.a": 1.5 * SINE, "cmd.a": SINE, "tau.b": MEASURED}
    assert torque_verdict("tau.a", 1.5 * SINE, moving, columns).cause == "copied"
    del columns["cmd.a"]
    assert torque_verdict("tau.a", 1.5 * SINE, moving, columns).cause == "noiseless"


def test_values_of_a_command_that_switches():
    assert switched_levels(CHANNELS["three values"][0]) == (-2.0, 0.0, 2.0)
    assert switched_levels(np.zeros(100)) == ()
    assert switched_levels(np.repeat([0.0, 1.0], 50)) == ()  # one step is no switching


@pytest.fixture(scope="module")
def arm():
    return robot("arm").with_effect("viscous").with_effect("coulomb")


def test_a_dead_channel_has_no_vote(arm):
    """The knots and the cut-off are those of the log without this torque."""
    log = plant(arm, motion_log("arm"), noise=[Noise("tau", 0.01, relative=True)]).log
    noise = np.random.default_rng(3).normal(size=len(log.t))
    dead = Log.from_arrays(log.name, log.t, {**log.columns, "tau.wrist": 5.0 * noise})
    assert informing(torque_verdicts(arm, dead.t, dead.columns)) == {"yaw", "shoulder", "elbow"}
    bands = [ident.complete(arm, x).band for x in (log, dead)]
    assert bands[0].cutoff == pytest.approx(bands[1].cutoff)
    assert bands[0].noise == pytest.approx(bands[1].noise, rel=0.5)


def gravity_of(mechanism, log):
    """Torques of a tree at rest, by Pinocchio."""
    model, columns = mechanism.model, dict(log.columns)
    at = {joint.name: joint.index for joint in mechanism.joints}
    q = np.zeros((len(log.t), model.nq))
    for name, i in at.items():
        q[:, i] = log.columns[f"q.{name}"]
    tau = [pin.computeGeneralizedGravity(model, model.createData(), x) for x in q]
    columns |= {f"tau.{name}": np.array(tau)[:, i] for name, i in at.items()}
    return Log.from_arrays(log.name, log.t, columns)


@pytest.mark.parametrize(
    ("name", "terms"),
    [("arm", "gravity and inertia"), ("arm", "gravity alone"), ("five_bar", "gravity and inertia")],
)
def test_torques_of_a_model_are_no_measurement(name, terms):
    """Not good enough, whatever the error: a fit returns the model."""
    mechanism, planned = robot(name), motion_log(name)
    if terms == "gravity alone":
        log = gravity_of(mechanism, planned)
    else:
        log, _ = ident.simulate(mechanism, planned)
    motion = ident.complete(mechanism, log)
    assert {x.kind for x in motion.torques.values()} == {TorqueClass.COMPUTED}
    assert {x.column for x in motion.torques.values()} == {terms}
    fit = ident.identify(mechanism, motion)
    (finding,) = [x for x in fit.health.findings if x.code == "computed"]
    assert finding.where == tuple(f"tau.{joint}" for joint in mechanism.measured)


def test_a_measurement_is_no_models(arm):
    log = plant(arm, motion_log("arm"), noise=[Noise("tau", 0.01, relative=True)]).log
    for x in (log, ident.read_log(ROBOTS / "arm" / "run.csv")):
        classes = {v.kind for v in ident.complete(arm, x).torques.values()}
        assert classes == {TorqueClass.MEASURED}


def findings_of(mechanism, log):
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    return {x.code: x for x in fit.health.findings}


def test_gravity_that_a_controller_has_subtracted_is_named(arm):
    name, mechanism = "arm", arm
    noise = [Noise("tau", 0.01, relative=True)]
    planted = plant(mechanism, motion_log(name), noise=noise, seed=1, spread=0.1, offset=0.0)
    free = replace(mechanism, model=mechanism.model.copy())
    free.model.gravity = pin.Motion.Zero()
    log, _ = ident.simulate(free, motion_log(name), values=planted.values, noise=noise)
    motion = ident.complete(mechanism, log)
    assert {x.kind for x in motion.torques.values()} == {TorqueClass.COMPENSATED}
    assert "gravity = [0.0, 0.0, 0.0]" in findings_of(mechanism, log)["compensated"].remedy
    assert "compensated" not in findings_of(mechanism, planted.log)


def test_torques_of_one_joint_alone_that_a_model_has_computed(arm):
    log = plant(arm, motion_log("arm"), noise=[Noise("tau", 0.01, relative=True)]).log
    clean, _ = ident.simulate(robot("arm"), motion_log("arm"))
    columns = {**log.columns, "tau.elbow": clean.columns["tau.elbow"]}
    mixed = Log.from_arrays(log.name, log.t, columns)
    assert ident.complete(arm, mixed).torques["elbow"].kind == TorqueClass.COMPUTED
    assert findings_of(arm, mixed)["computed"].where == ("tau.elbow",)


def test_torques_of_the_open_tree_of_a_loop_are_named():
    """Its closures would carry no force."""
    mechanism = robot("four_bar")
    motion = ident.complete(mechanism, ident.simulate(mechanism, motion_log("four_bar"))[0])
    (e,) = motion.experiments
    data = mechanism.model.createData()
    names = [joint.name for joint in mechanism.joints if joint.in_tree]
    pi = mechanism.prior * 1.2
    rows = zip(e.q, e.v, e.a, strict=True)
    tau = np.stack([pin.computeJointTorqueRegressor(mechanism.model, data, *x) @ pi for x in rows])
    columns = {f"{c}.{name}": x[:, i] for c, x in (("q", e.y), ("tau", tau))
               for i, name in enumerate(names)}  # fmt: skip
    every = replace(mechanism, driven=tuple(names), passive=())
    log = Log.from_arrays("tree", e.t, columns)
    verdicts = ident.complete(every, log).torques
    assert {x.cause for x in verdicts.values()} == {"open_tree"}
    assert "without them" in findings_of(every, log)["computed"].meaning


def test_one_drives_torque_in_several_columns_is_named(arm):
    log = plant(arm, motion_log("arm"), noise=[Noise("tau", 0.01, relative=True)]).log
    columns = {**log.columns, "tau.elbow": 1.5 * log.columns["tau.shoulder"]}
    shared = findings_of(arm, Log.from_arrays(log.name, log.t, columns))["shared"]
    assert "passive" in shared.remedy
