"""A closed loop, and a real robot whose log is made to change."""

from dataclasses import replace

import numpy as np
import pytest

import ident


@pytest.fixture(scope="module")
def tx40(shared_data):
    """A monitor that has learnt the first 5.4 s of the log, and the rest of it."""
    place = shared_data / "staubli_tx40"
    mechanism = ident.load(place / "tx40.urdf")
    for effect in ("viscous", "coulomb", "coupling:joint_5,joint_6", "rotor_inertia"):
        mechanism = mechanism.with_effect(effect)
    motion = ident.complete(mechanism.with_effect("torque_offset"), place / "tx40.csv")
    fit = ident.identify(mechanism.with_effect("torque_offset"), motion)
    (e,) = motion.experiments
    first = replace(motion, experiments=(e.at_samples(slice(0, 27_000)),))
    kinds = ("viscous", "coulomb", "payload", "torque_offset", "torque_gain", "gravity_tilt")
    monitor = ident.Monitor.of(fit, first, interval=0.1, patience=1.5, kinds=kinds)

    def watched(channel=None, torque=None):
        tau = e.tau.copy()
        if channel is not None:
            tau[:, channel] += (e.t >= 6.5) * torque(e.yd[:, channel])
        rest = replace(e, tau=tau).at_samples(slice(27_000, None))
        own = monitor.fresh()
        return own.watch(replace(motion, experiments=(rest,))) + own.finish()

    return watched


@pytest.mark.slow
def test_a_real_robot_that_does_not_change_raises_no_alarm(tx40):
    assert tx40() == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("channel", "label", "size", "torque"),
    [
        (1, "torque_offset:joint_2", 5.0, lambda v: 5.0),
        (2, "coulomb:joint_3", 3.0, lambda v: 3.0 * np.sign(v)),
        (3, "viscous:joint_4", 0.6, lambda v: 0.6 * v),
    ],
)
def test_a_change_added_to_a_real_log_is_found(tx40, channel, label, size, torque):
    (alarm,) = tx40(channel, torque)
    assert alarm.onset == pytest.approx(6.5, abs=0.25)
    assert alarm.best.label == label
    (step,) = alarm.best.steps
    assert step.change == pytest.approx(size, abs=3 * step.stderr)
    assert not alarm.suspects or label in alarm.suspects


@pytest.mark.slow
def test_a_loop_shows_the_friction_of_a_passive_joint(robots):
    mechanism = replace(ident.load(robots / "five_bar"), multipliers=ident.Multipliers("free"))
    mechanism = mechanism.with_effect("viscous").with_effect("coulomb")
    usual = {n: 0.03 if n.endswith("Fv") else 0.05 for e in mechanism.effects for n in e.names}

    def run(seed, seconds, begins=np.inf):
        rng = np.random.default_rng(seed)
        t = np.arange(round(100 * seconds)) / 100
        columns = {}
        for joint, centre in (("left", 2.1), ("right", 1.04)):
            share = rng.uniform(0.5, 1.0, 3)
            x = np.full(len(t), centre)
            for a, f in zip(0.4 * share / share.sum(), (0.3, 0.62, 1.06), strict=True):
                x = x + a * np.sin(2 * np.pi * (f * rng.uniform(0.85, 1.15) * t + rng.uniform()))
            columns[f"q.{joint}"] = x
        motion = ident.Log.from_arrays("five_bar.csv", t, columns)
        rough = mechanism.with_effect("coulomb:left_elbow", {"Fc": 0.02})
        clean, faulty = (
            ident.simulate(m, motion, values=usual, columns=("q", "tau"))[0]
            for m in (mechanism, rough)
        )
        made = {}
        for name, x in clean.columns.items():
            sigma = 0.002 if name.startswith("tau.") else 2e-5
            y = np.where(clean.t < begins, x, faulty.columns[name])
            made[name] = y + sigma * rng.standard_normal(len(x))
        log = ident.Log.from_arrays("five_bar.csv", clean.t, made)
        return ident.complete(mechanism, log, cutoff=5.0, smoothing=0.13)

    fit = ident.identify(mechanism, run(1, 40.0))
    normal = [run(seed, 40.0) for seed in (2, 3, 4)]
    experiments = tuple(e for motion in normal for e in motion.experiments)
    monitor = ident.Monitor.of(fit, replace(normal[0], experiments=experiments))
    (alarm,) = monitor.watch(run(5, 45.0, begins=20.0))
    assert alarm.suspects == ("coulomb:left_elbow",)
    assert alarm.best.reactions["tip.y"] > 0.0
