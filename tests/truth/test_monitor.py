"""Planted changes of a running arm: seen, named, measured; and nothing said where there is none."""

import json

import numpy as np
import pytest
from monitored import arm, joined, known, run

import ident
from ident.equations.rows import rows

LOAD = {  # 0.3 kg at (8, 2, 0) cm
    "m": 0.3, "mx": 0.024, "my": 0.006, "mz": 0.0, "Lxx": 2.4e-4, "Lxy": -4.8e-4, "Lyy": 2.1e-3,
    "Lxz": 0.0, "Lyz": 0.0, "Lzz": 2.2e-3,
}  # fmt: skip


@pytest.fixture(scope="module")
def monitor():
    """Its reference was identified from one noisy log, normal running learnt from three others."""
    mechanism, _ = arm()
    fit = ident.identify(mechanism, run(1, 40.0))
    normal = joined(*(run(seed, 40.0) for seed in (2, 3, 4)))
    return ident.Monitor.of(fit, normal, patience=8.0)


def test_normal_running_raises_no_alarm(monitor):
    own = monitor.fresh()
    assert own.watch(run(10, 120.0)) == []
    assert own.evidence < own.threshold


def test_the_usual_errors_are_those_of_normal_running(monitor):
    """As shares of its own torques, whatever runs now."""
    mechanism, _ = arm()
    normal = joined(*(run(seed, 40.0) for seed in (2, 3, 4)))
    fitted = ident.identify(mechanism, normal)
    for joint, error in monitor.usual_errors.items():
        assert error.relative == pytest.approx(fitted.train[joint].relative, rel=0.1)


def test_a_change_is_named_and_measured(monitor):
    own = monitor.fresh()
    changed = run(11, 40.0, {20.0: ("", {"coulomb.elbow.Fc": 0.8 + 0.3})})
    (alarm,) = own.watch(changed)
    assert alarm.verdict == "named"
    assert alarm.suspects == ("coulomb:elbow",)
    assert alarm.onset == pytest.approx(20.0, abs=0.51)
    assert 20.0 < alarm.detected < 23.0
    (step,) = alarm.best.steps
    assert step.unit == "N m"
    assert step.change == pytest.approx(0.3, abs=4 * step.stderr)
    assert step.stderr < 0.02
    assert "coulomb:elbow: Fc +0.3" in str(alarm)
    assert not alarm.from_start
    assert json.loads(json.dumps(alarm.json()))["best"]["label"] == "coulomb:elbow"
    # what was named is the new normal, known better by then than at first
    at = own.watched.columns.index["coulomb.elbow.Fc"]
    assert own.reference[at] - own.normal[at] == pytest.approx(0.3, abs=0.01)


def test_what_is_there_from_the_first_interval_may_be_older(monitor):
    (alarm,) = monitor.fresh().watch(run(19, 30.0, {0.0: ("", {"coulomb.elbow.Fc": 1.1})}))
    assert alarm.suspects == ("coulomb:elbow",)
    assert alarm.from_start
    assert f"changed before the log began ({alarm.onset:.2f} s or earlier)" in alarm.headline


def test_a_second_change_is_found_after_the_first(monitor):
    own = monitor.fresh()
    first = {"coulomb.elbow.Fc": 1.1}
    load = {f"payload.hand.{name}": x for name, x in LOAD.items()}
    alarms = own.watch(
        run(12, 60.0, {15.0: ("", first), 40.0: ("payload:hand", {**first, **load})})
    )
    assert [alarm.suspects for alarm in alarms] == [("coulomb:elbow",), ("payload:hand",)]
    mass = alarms[1].best.steps[0]
    assert (mass.name, mass.unit) == ("m", "kg")
    assert alarms[1].onset == pytest.approx(40.0, abs=0.51)


def service(seed: int, seconds: float = 24.0) -> tuple[set[str], float, float, ident.Motion]:
    """A log in which a body is put on the hand and dry friction of a joint grows by half at 8 s:
    labels of both, the mass [kg], the change of the friction [N m], the motion.
    """
    joint, m = ("yaw", "shoulder", "elbow")[seed % 3], (0.5, 0.75, 1.0)[seed // 3 % 3]
    body = {key: x * m / LOAD["m"] for key, x in LOAD.items()}
    _, values = arm()
    name = f"coulomb.{joint}.Fc"
    changed = {f"payload.hand.{key}": x for key, x in body.items()} | {name: 1.5 * values[name]}
    motion = run(100 + seed, seconds, {8.0: ("payload:hand", changed)})
    return {"payload:hand", f"coulomb:{joint}"}, m, 0.5 * values[name], motion


def test_a_load_and_a_friction_that_change_together_are_both_named(monitor):
    causes, m, Fc, motion = service(2)
    (alarm,) = monitor.fresh().watch(motion)
    assert alarm.verdict == "named"
    assert set(alarm.best.label.split(" + ")) == causes
    step = {step.name: step for step in alarm.best.steps}
    assert step["m"].change == pytest.approx(m, abs=4 * step["m"].stderr)
    assert step["Fc"].change == pytest.approx(Fc, abs=4 * step["Fc"].stderr)
    assert alarm.onset == pytest.approx(8.0, abs=0.51)
    assert "A load on hand and dry friction in elbow" in alarm.headline


@pytest.mark.slow
def test_both_changes_of_a_service_are_named_in_most_logs(monitor):
    named = 0
    for seed in range(20):
        causes, _, _, motion = service(seed)
        own = monitor.fresh()
        alarms = own.watch(motion) + own.finish()
        labels = {part for x in alarms for label in x.suspects for part in label.split(" + ")}
        named += labels == causes
    assert named >= 17


@pytest.mark.slow
def test_one_cause_is_not_joined_by_another(monitor):
    for seed in range(20):
        _, values = arm()
        load = {f"payload.hand.{key}": x for key, x in LOAD.items()}
        friction = {"coulomb.shoulder.Fc": 1.5 * values["coulomb.shoulder.Fc"]}
        label, changed = ("payload:hand", load) if seed % 2 else ("", friction)
        own = monitor.fresh()
        alarms = own.watch(run(200 + seed, 24.0, {8.0: (label, changed)})) + own.finish()
        assert not [x for alarm in alarms for x in alarm.suspects if "payload:hand + " in x]


def test_noise_that_grows_with_a_load_is_no_second_change(monitor):
    load = {f"payload.hand.{name}": x for name, x in LOAD.items()}
    alarms = monitor.fresh().watch(run(16, 60.0, {20.0: ("payload:hand", load)}, louder=4.0))
    assert [alarm.suspects for alarm in alarms] == [("payload:hand",)]


def test_an_absurd_sample_raises_no_alarm(monitor):
    mechanism, _ = arm()
    log = run(14, 30.0).logs[0]
    for column, value in (("q.elbow", 100.0), ("tau.elbow", 1e20)):
        odd = log.columns[column].copy()
        odd[1500] = value
        columns = {**log.columns, column: odd}
        motion = ident.complete(
            mechanism, ident.Log.from_arrays("odd.csv", log.t, columns), cutoff=6.0, smoothing=0.12
        )
        own = monitor.fresh()
        assert own.watch(motion) + own.finish() == []


def test_what_the_library_does_not_explain_is_not_named(monitor):
    own = monitor.fresh()
    alarms = own.watch(run(13, 45.0, {20.0: ("spring:elbow", {"spring.elbow.k": 1.0,
                                                             "spring.elbow.b": 0.0})}))  # fmt: skip
    assert alarms
    assert {alarm.verdict for alarm in alarms} == {"cannot tell"}
    assert alarms[0].suspects == ()
    assert "cannot tell what" in alarms[0].headline


def test_rows_in_any_pieces_raise_the_same_alarm(monitor):
    motion = run(14, 35.0, {20.0: ("", {"viscous.yaw.Fv": 0.75})})
    (whole,) = monitor.fresh().watch(motion)
    own, found = monitor.fresh(), []
    w = own.watched
    for part in rows(w.scene(motion.experiments[0]), w.cutoff, 0.02):
        for i in range(0, len(part.t), 7):
            cut = {n: getattr(part, n)[i : i + 7] for n in type(part).__dataclass_fields__}
            found += own.absorb(type(part)(**cut))
    (alarm,) = found
    assert alarm.suspects == whole.suspects == ("viscous:yaw",)
    assert alarm.evidence == pytest.approx(whole.evidence, rel=1e-6)
    assert alarm.best.steps[0].change == pytest.approx(whole.best.steps[0].change, rel=1e-6)


def test_the_end_of_a_log_names_what_waits(monitor):
    own = monitor.fresh()
    assert own.watch(run(15, 22.5, {20.0: ("", {"viscous.yaw.Fv": 0.8})})) == []
    assert own.raised is not None
    (alarm,) = own.finish()
    assert alarm.best.label == "viscous:yaw"
    assert own.finish() == []


def test_a_known_mechanism_is_a_reference(monitor):
    mechanism, values = arm()
    reference = known(mechanism, values)
    own = ident.Monitor.of(reference, joined(*(run(seed, 40.0) for seed in (2, 3))), patience=5.0)
    (alarm,) = own.watch(run(16, 30.0, {20.0: ("", {"coulomb.yaw.Fc": 1.6})}))
    assert alarm.suspects == ("coulomb:yaw",)
    assert "false alarms  0.1 an hour at most" in str(own)


def test_errors_say_what_is_valid():
    mechanism, values = arm()
    motion = run(2, 12.0)
    with pytest.raises(ident.FitError, match=r"a reference must be known, and .* is not"):
        ident.Monitor.of(mechanism, motion)
    reference = known(mechanism, values)
    with pytest.raises(ident.FitError, match="no change of 'viscus' can be watched for"):
        ident.Monitor.of(reference, motion, kinds=["viscus"])
    with pytest.raises(
        ident.FitError, match=r"intervals of 0\.4 s; valid: 40.* longer logs, of 16\.2 s"
    ):
        ident.Monitor.of(reference, motion)
    with pytest.raises(ident.FitError, match=r"intervals of 0\.5 s; valid: 40"):
        ident.Monitor.of(reference, motion, interval=0.5)
    with pytest.raises(ident.FitError, match="valid: above 0"):
        ident.Monitor.of(reference, motion, interval=0.0)


def test_twenty_seconds_are_enough():
    """Ends of a log are left out: it has less than forty half seconds."""
    mechanism, values = arm()
    own = ident.Monitor.of(known(mechanism, values), run(2, 19.5), patience=5.0)
    assert 0.4 <= own.seconds < 0.5
    assert not own.watch(run(18, 30.0))


def test_memory_does_not_grow(monitor):
    own = monitor.fresh()
    motion = run(17, 30.0)
    for _ in range(5):
        own.watch(motion)
    assert len(own._recent) <= own._recent.maxlen == 240
    assert len(own._cutter.waiting) <= 2
    assert np.isfinite(own.evidence)


def test_a_change_behind_a_torque_channel_of_a_wrong_scale_is_measured_in_its_own_unit():
    """The channel of the elbow reads 0.75 times the torque, as the reference has it."""
    (mechanism, values), given = arm(), {"torque_gain.elbow.g": -0.25}
    scaled = mechanism.with_effect("torque_gain:elbow")
    reference = known(scaled, {**values, **given})
    normal = joined(*(run(seed, 20.0, {0.0: ("torque_gain:elbow", given)}) for seed in (2, 3)))
    monitor = ident.Monitor.of(reference, normal, patience=8.0)
    then = {**given, "coulomb.elbow.Fc": 1.3}
    changed = run(11, 25.0, {0.0: ("torque_gain:elbow", given), 10.0: ("torque_gain:elbow", then)})
    (alarm,) = monitor.watch(changed)
    assert alarm.suspects == ("coulomb:elbow",)
    (step,) = alarm.best.steps
    assert step.change == pytest.approx(0.5, abs=4 * step.stderr)
    assert step.stderr < 0.03
