"""Planted faults of the data are found on the right channel; clean logs and missing effects pass.

Motions are analytic, torques the project's own simulation (held against Pinocchio and MuJoCo
elsewhere), faults are made on the log's columns.
"""

import json
import re
import time
from dataclasses import replace

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident import Column, Log, Noise, health
from ident.faults.channel_checks import copies, late_rates, log_findings
from ident.faults.data_checks import DataChecks
from ident.faults.fault import log_entries, log_entry
from ident.faults.small_errors import common_delay
from ident.show.motion import beyond_limits, data_findings
from ident.text import stamp
from identification import motion_log, plant, robot

NAMES = ("arm", "five_bar", "four_bar", "slider_crank")
DRIVEN = {"arm": "elbow", "five_bar": "left", "four_bar": "crank", "slider_crank": "theta"}


def planted(name, *kinds, noise=0.01, seed=0, values=None, **motion):
    mechanism = robot(name)
    for kind in ("viscous", "coulomb", *kinds):
        mechanism = mechanism.with_effect(kind)
    told = [Noise("tau", noise, relative=True)] if noise else []
    return plant(mechanism, motion_log(name, **motion), values, noise=told, seed=seed)


def changed(log, **columns):
    found = {**log.columns, **{key.replace("__", "."): x for key, x in columns.items()}}
    return Log.from_arrays(log.name, log.t, found)


def judged(mechanism, log, cutoff=None):
    fit = ident.identify(mechanism, ident.complete(mechanism, log, cutoff=cutoff))
    return health(fit)


def found(judgement):
    return {(each.code, each.where) for each in judgement.findings}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("noise", "seed"), [(0.0, 3), (0.01, 4), (0.03, 5)])
def test_clean_logs_are_healthy(name, noise, seed):
    p = planted(name, noise=noise, seed=seed)
    assert found(judged(p.mechanism, p.log)) == set()
    assert found(judged(p.mechanism, p.log, "auto")) == set()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["", "rotor_inertia", "spring"])
def test_a_missing_effect_is_no_fault_of_the_data(name, kind):
    """Rigid bodies alone are fitted to logs with friction, and with rotors or springs as well."""
    p = planted(name, *([kind] if kind else []), seed=6)
    assert found(judged(robot(name), p.log)) == set()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("rigid", [False, True])
def test_a_wrong_sign_is_found(name, rigid):
    p = planted(name, seed=7)
    joint = DRIVEN[name]
    log = changed(p.log, **{f"tau__{joint}": -p.log.columns[f"tau.{joint}"]})
    judgement = judged(robot(name) if rigid else p.mechanism, log)
    assert ("sign", (f"tau.{joint}",)) in found(judgement)
    (check,) = [c for c in judgement.findings if c.code == "sign"]
    assert f'[log] "tau.{joint}" = {{ column = "tau.{joint}", scale = -1 }}' in check.remedy


def test_two_wrong_signs_are_both_found():
    p = planted("arm", seed=8)
    c = p.log.columns
    log = changed(p.log, tau__yaw=-c["tau.yaw"], tau__shoulder=-c["tau.shoulder"])
    signs = {c for name, where in found(judged(p.mechanism, log)) if name == "sign" for c in where}
    assert signs == {"tau.yaw", "tau.shoulder"}


@pytest.mark.parametrize(
    ("name", "a", "b"),
    [("arm", "shoulder", "elbow"), ("arm", "yaw", "wrist"), ("five_bar", "left", "right")],
)
def test_exchanged_torques_are_found(name, a, b):
    p = planted(name, seed=9)
    c = p.log.columns
    log = changed(p.log, **{f"tau__{a}": c[f"tau.{b}"], f"tau__{b}": c[f"tau.{a}"]})
    assert ("swapped", (f"tau.{a}", f"tau.{b}")) in found(judged(p.mechanism, log))


@pytest.mark.parametrize(
    ("joint", "factor"), [("shoulder", 0.1), ("elbow", 10.0), ("elbow", 1000.0)]
)
def test_a_gross_scale_is_found(joint, factor):
    p = planted("arm", seed=10)
    log = changed(p.log, **{f"tau__{joint}": factor * p.log.columns[f"tau.{joint}"]})
    (check,) = [c for c in judged(p.mechanism, log).findings if c.code == "scale"]
    assert check.where == (f"tau.{joint}",)
    said = float(check.meaning.split("reads ")[1].split()[0])
    assert said == pytest.approx(factor, rel=0.25)


def test_a_small_gain_is_left_to_the_effect():
    p = planted("arm", seed=11)
    log = changed(p.log, tau__elbow=1.08 * p.log.columns["tau.elbow"])
    assert found(judged(p.mechanism, log)) == set()


def test_one_drive_of_another_magnitude_than_the_urdf_is_a_hint():
    motion = motion_log("four_bar")
    p = plant(robot("four_bar"), motion, noise=[Noise("tau", 0.01, relative=True)], seed=12)
    log = changed(p.log, tau__crank=50.0 * p.log.columns["tau.crank"])
    assert ("magnitude", ("tau.crank",)) in found(judged(p.mechanism, log))


HIDDEN = {
    "ripple": {"A": 1.0, "B": 0.5, "N": 3.0},
    "hysteresis": {"sigma": 20.0, "z0": 0.1},
    "load_friction": {"mu": 0.5},
    "elasticity": {"compliance": 0.05},
}


@pytest.mark.parametrize("joint", ["wrist", "elbow"])
@pytest.mark.parametrize("kind", HIDDEN)
def test_a_hidden_effect_that_spoils_a_joint_is_no_fault_of_its_channel(joint, kind):
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    values = {f"{kind}.{joint}.{name}": value for name, value in HIDDEN[kind].items()}
    true = mechanism.with_effect(f"{kind}:{joint}")
    noise = [Noise("tau", 0.01, relative=True)]
    p = plant(true, motion_log("arm", 200.0, 8.0), values, noise=noise, seed=1)
    assert found(judged(mechanism, p.log)) == set()


@pytest.mark.parametrize("lag", [6, 10])
def test_a_delay_of_one_torque_is_found_in_milliseconds(lag):
    p = planted("arm", seed=13)
    log = changed(p.log, tau__elbow=np.roll(p.log.columns["tau.elbow"], lag))
    (check,) = [c for c in judged(p.mechanism, log).findings if c.code == "delay"]
    assert check.where == ("tau.elbow",)
    assert check.number == pytest.approx(5.0 * lag, rel=0.25)


def test_friction_that_is_early_at_reversals_is_no_delay_of_torques():
    p = planted("arm", seed=13)
    columns, dt = dict(p.log.columns), float(np.diff(p.log.t).mean())
    for name in ("yaw", "shoulder", "elbow", "wrist"):
        v, size = np.gradient(columns[f"q.{name}"], dt), 0.3 * columns[f"tau.{name}"].std()
        early = np.sign(np.roll(v, -2)) - np.sign(v)  # by 10 ms
        columns[f"tau.{name}"] = columns[f"tau.{name}"] + size * early
    found = judged(p.mechanism, Log.from_arrays(p.log.name, p.log.t, columns)).findings
    assert "delay" not in {each.code for each in found}


def test_a_delay_of_all_torques_is_one_finding():
    p = planted("arm", seed=14)
    late = {name: np.roll(x, 6) for name, x in p.log.columns.items() if name.startswith("tau.")}
    log = Log.from_arrays(p.log.name, p.log.t, {**p.log.columns, **late})
    (check,) = [c for c in judged(p.mechanism, log).findings if c.code == "delay"]
    assert len(check.where) == 4
    assert check.number == pytest.approx(30.0, rel=0.2)


def test_channels_that_are_no_measurements():
    p = planted("arm", seed=15)
    x, t = p.log.columns["tau.elbow"], p.log.t
    clean = planted("arm", seed=15, noise=0.0).log.columns["tau.elbow"]
    for columns, code, word in (
        ({"tau__elbow": np.repeat(x[::8], 8)[: len(x)]}, "staircase", "held for 8 samples"),
        ({"tau__elbow": np.where(np.arange(len(x)) % 200 < 80, 0.0, x)}, "zero", "exactly zero"),
        ({"tau__elbow": clean}, "noiseless", "not the least noise"),
        ({"tau_des_elbow": x / 0.12}, "copied", "0.12 times the column 'tau_des_elbow'"),
        ({"tau__elbow": np.where(abs(t - 1.0) < 0.2, x[160], x)}, "frozen", "from t = 0.8"),
    ):
        (finding,) = [c for c in judged(p.mechanism, changed(p.log, **columns)).findings
                      if c.code == code]  # fmt: skip
        assert finding.where == ("tau.elbow",)
        assert word in finding.meaning


def test_identify_says_what_the_channels_show():
    p = planted("arm", seed=20)
    log = changed(p.log, tau__wrist=np.zeros(len(p.log.t)))
    fit = ident.identify(p.mechanism, ident.complete(p.mechanism, log, cutoff=None))
    assert any("tau.wrist: always 0 while the joint moves" in said for said in fit.warnings)


def test_the_mapped_column_is_no_command_of_itself():
    p = planted("arm", seed=16)
    c = dict(p.log.columns)
    c["tau_set"] = c.pop("tau.elbow") / 0.5
    mechanism = replace(p.mechanism, columns={"tau.elbow": Column("tau_set", 0.5)})
    assert found(judged(mechanism, Log.from_arrays("run.csv", p.log.t, c))) == set()


def test_a_saturated_torque_is_found():
    p = planted("arm", seed=17)
    x = p.log.columns["tau.elbow"]
    limit = 0.6 * np.abs(x).max()
    judgement = judged(p.mechanism, changed(p.log, tau__elbow=np.clip(x, -limit, limit)))
    assert ("clipped", ("tau.elbow",)) in found(judgement)


def test_coarse_steps_are_found_and_fine_ones_are_not():
    p = planted("arm", seed=18)
    x = p.log.columns["tau.elbow"]
    for share, bad in ((0.1, True), (0.005, False)):
        step = share * np.sqrt(np.mean(x**2))
        judgement = judged(p.mechanism, changed(p.log, tau__elbow=np.round(x / step) * step))
        numbers = [each.number for each in judgement.findings if each.code == "steps"]
        assert numbers == ([pytest.approx(share / np.sqrt(12), rel=0.1)] if bad else [])


def test_steps_that_are_a_small_part_of_the_least_error_are_no_fault():
    """Not of what a model leaves that lacks friction: of what it leaves with all effects."""
    p = planted("arm", seed=18)
    x = p.log.columns["tau.elbow"]
    rms, random = np.sqrt(np.mean(x**2)), np.random.default_rng(0)
    step = 0.06 * rms  # an error of 1.7 %
    for noise, bad in ((0.2, False), (0.01, True)):
        noisy = x + noise * rms * random.normal(size=len(x))
        log = changed(p.log, tau__elbow=np.round(noisy / step) * step)
        codes = {(each.code, each.where) for each in judged(p.mechanism, log).findings}
        assert (("steps", ("tau.elbow",)) in codes) is bad


def test_a_joint_that_rests_before_its_fastest_move_is_not_frozen():
    """A servo of the first order at 50 Hz: at rest for 4 s, then ever smaller moves."""
    p = planted("arm", seed=18)
    t = np.arange(0.0, 12.0, 0.02)
    targets = np.select([t < 4, t < 6, t < 8, t < 10], [0.0, 1.0, 0.3, 0.8], 0.5)
    q = np.zeros_like(t)
    for k in range(1, len(t)):
        q[k] = q[k - 1] + (targets[k] - q[k - 1]) * -np.expm1(-0.02 / 0.06)
    columns = {f"q.{joint}": (1 + 0.1 * i) * q for i, joint in enumerate(p.mechanism.driven)}
    columns |= {f"tau.{joint}": np.sin(t + i) for i, joint in enumerate(p.mechanism.driven)}
    log = Log.from_arrays("servo", t, columns)
    found = log_findings(p.mechanism, ident.complete(p.mechanism, log))
    assert "frozen" not in {each.code for each in found if each.where[0].startswith("q.")}


def test_coarse_encoder_without_speeds_is_found():
    p = planted("arm", seed=19)
    c = {k: x for k, x in p.log.columns.items() if k[0] in "qt"}
    c["q.elbow"] = np.round(c["q.elbow"] / 4e-2) * 4e-2
    judgement = judged(p.mechanism, Log.from_arrays("run.csv", p.log.t, c), 8.0)
    assert ("steps", ("q.elbow",)) in found(judgement)


def test_an_encoder_offset_against_the_closures_is_found():
    mechanism = robot("four_bar").with_effect("viscous")
    motion = motion_log("four_bar")
    log, _ = ident.simulate(mechanism, motion, values={"viscous.crank.Fv": 0.1})
    y = ident.complete(mechanism, log, cutoff=None).experiments[0].y
    joint = next(j.name for j in mechanism.joints if j.in_tree and j.name != "crank")
    own = y[:, mechanism.joint_index[joint]]
    for offset, word in ((0.0, "agrees with"), (0.02, "differs from what")):
        moved = changed(log, **{f"q__{joint}": own + offset})
        notes = ident.complete(mechanism, moved, cutoff=None).notes
        assert any(f"q.{joint} {word} the closures" in note for note in notes)
    noise = [Noise("q", 1e-4), Noise("tau", 0.01, relative=True)]
    values = {"viscous.crank.Fv": 0.1}
    measured, _ = ident.simulate(
        mechanism, log, values=values, noise=noise, joints=["crank", joint], columns=("q", "tau")
    )
    for offset, codes in ((0.0, set()), (0.03, {"contradicted"})):
        moved = changed(measured, **{f"q__{joint}": measured.columns[f"q.{joint}"] + offset})
        assert {code for code, _ in found(judged(mechanism, moved, "auto"))} == codes


def test_friction_that_cannot_be_is_no_clean_verdict():
    p = planted("arm", seed=19)
    log, _ = ident.simulate(p.mechanism, p.log, values={**p.values, "viscous.yaw.Fv": -1.0})
    found = ident.diagnose(ident.identify(p.mechanism, ident.complete(p.mechanism, log)))
    assert found.verdict == "nothing"
    first, _, _ = str(found).partition("Good enough?")
    assert "viscous.yaw.Fv came out negative" in " ".join(first.split())


def test_a_dead_torque_is_found():
    p = planted("arm", seed=20)
    judgement = judged(p.mechanism, changed(p.log, tau__wrist=np.full(len(p.log.t), 0.02)))
    assert ("constant", ("tau.wrist",)) in found(judgement)


@pytest.mark.parametrize("kind", ["sign", "swapped", "scale"])
def test_a_wrong_position_is_found(kind):
    p = planted("arm", seed=21)
    c = dict(p.log.columns)
    for letter in "qva":
        a, b = c[f"{letter}.shoulder"], c[f"{letter}.elbow"]
        if kind == "swapped":
            c[f"{letter}.shoulder"], c[f"{letter}.elbow"] = b, a
        else:
            c[f"{letter}.elbow"] = b * (-1.0 if kind == "sign" else 180 / np.pi)
    unlimited = tuple(replace(j, lower=-np.inf, upper=np.inf) for j in p.mechanism.joints)
    mechanism = replace(p.mechanism, joints=unlimited)
    judgement = judged(mechanism, Log.from_arrays("run.csv", p.log.t, c))
    assert {name for name, _ in found(judgement)} == {f"position {kind}"}


@pytest.mark.parametrize("opposite", [False, True])
def test_a_position_counted_from_another_link_is_found(opposite):
    """The elbow of an arm is parallel to its shoulder; its axis may point the other way."""
    p = planted("arm", seed=21)
    at, turned = p.mechanism.model.names.tolist().index("elbow"), p.mechanism.model.copy()
    mechanism, log = p.mechanism, p.log
    if opposite:
        turn = turned.jointPlacements[at].rotation @ np.diag([1.0, -1.0, -1.0])
        turned.jointPlacements[at].rotation = turn
        mechanism = mechanism.with_same_kinematics(model=turned)
        values = dict.fromkeys((n for e in mechanism.effects for n in e.names), 0.1)
        log = ident.simulate(mechanism, log, values=values)[0]
    c, sign = dict(log.columns), -1.0 if opposite else 1.0
    for letter in "qva":
        c[f"{letter}.elbow"] = c[f"{letter}.elbow"] + sign * c[f"{letter}.shoulder"]
    judgement = judged(mechanism, Log.from_arrays("run.csv", log.t, c))
    assert {name for name, _ in found(judgement)} == {"position from"}
    assert f"q.elbow {'+' if opposite else '-'} q.shoulder" in str(judgement)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_a_scale_of_time_between_those_that_are_tried_is_found(scale):
    arm, log = robot("arm"), ident.read_log(ROBOTS / "arm" / "run.csv")
    rates = {"v": scale, "a": scale**2}
    columns = {name: x * rates.get(name[0], 1.0) for name, x in log.columns.items()}
    fitted = arm.with_effect("viscous").with_effect("coulomb")
    (fault,) = judged(fitted, Log.from_arrays("run.csv", log.t / scale, columns)).faults
    assert fault.code == "time"
    assert float(fault.meaning.split("clock ")[1].split()[0]) == pytest.approx(scale, rel=0.02)


def test_it_prints_and_is_json():
    p = planted("arm", seed=22)
    judgement = judged(p.mechanism, changed(p.log, tau__elbow=-p.log.columns["tau.elbow"]))
    assert "tau.elbow" in str(judgement)
    assert "scale = -1" in str(judgement)
    assert "tau.elbow" in judgement._repr_html_()
    told = json.loads(json.dumps(judgement.json(), allow_nan=False))
    assert told[0]["code"] == "sign"
    assert not judgement.good


def test_it_is_fast():
    p = planted("arm", seed=24, rate=2500.0)
    fit = p.fit()
    start = time.process_time()
    health(fit)
    assert time.process_time() - start < 3.0


def test_a_copy_of_a_log_counts_once_and_validates_nothing():
    p = planted("arm", seed=25)
    copy = Log.from_arrays("copy.csv", p.log.t, p.log.columns)
    both = ident.identify(p.mechanism, ident.complete(p.mechanism, [p.log, copy]))
    assert ("copy", ("copy.csv",)) in found(health(both))
    motions = (ident.complete(p.mechanism, log) for log in (p.log, copy))
    fit = ident.identify(p.mechanism, next(motions), validate=next(motions))
    assert any("no validation" in text for text in fit.warnings)


def test_a_locked_joint_that_moves_is_found():
    p = planted("arm", seed=26)
    mechanism = ident.load(ROBOTS / "arm", locked={"elbow": 0.0})
    assert ("locked", ("q.elbow",)) in found(judged(mechanism, p.log))


def test_a_delay_that_explains_little_is_none():
    p = planted("four_bar", seed=27)
    log = changed(p.log, q__crank=p.log.columns["q.crank"] + np.pi / 2)
    assert "delay" not in {name for name, _ in found(judged(p.mechanism, log))}


def test_copies_are_found_in_part_rounded_and_in_other_folders(tmp_path, monkeypatch):
    p = planted("arm", seed=27, noise=0.02)
    cut = {name: x[100:500] for name, x in p.log.columns.items()}
    rounded = {name: np.round(x, 3) for name, x in p.log.columns.items()}
    for log in (
        Log.from_arrays("part.csv", p.log.t[100:500], cut),
        Log.from_arrays("rounded.csv", p.log.t + 7.0, rounded),
    ):
        both = ident.identify(p.mechanism, ident.complete(p.mechanism, [p.log, log]))
        assert ("copy", (log.name,)) in found(health(both))
    other = planted("arm", seed=28, noise=0.02).log  # the same motion, measured again
    both = ident.identify(p.mechanism, ident.complete(p.mechanism, [p.log, other]))
    assert "copy" not in {code for code, _ in found(health(both))}
    monkeypatch.setattr("ident.streams.logs.LOGS", 2)  # from which an excerpt takes stretches
    monkeypatch.setattr("ident.streams.logs.SAMPLES", 400)
    paths = [tmp_path / f"{number}" / "run.csv" for number in range(6)]
    for path, seed in zip(paths, (30, 31, 32, 33, 30, 30), strict=True):
        path.parent.mkdir()
        planted("arm", seed=seed, seconds=1.0).log.write(path)
    validate = [paths[-1]]
    gathered = ident.gather(p.mechanism, paths[:-1], validate=validate).fit
    copies = {each.where for each in gathered.all_findings if each.code == "copy"}
    assert copies == {("run.csv (5)",), ("run.csv",)}


def test_a_model_without_unknowns_is_judged_too():
    p = planted("arm", seed=29)
    known = replace(robot("arm"), unknown=())
    assert judged(known, p.log) is not None


def test_one_factor_of_all_torques_is_found():
    mechanism, log = robot("five_bar"), ident.read_log(ROBOTS / "five_bar" / "run.csv")
    torques = {n: 1.3 * x for n, x in log.columns.items() if n.startswith("tau.")}
    for factor, shown in ((torques, [pytest.approx(1.3, rel=0.05)]), ({}, [])):
        fit = ident.identify(mechanism, ident.complete(mechanism, changed(log, **factor)))
        assert [e.number for e in fit.health.findings if e.code == "magnitude"] == shown


def test_currents_of_several_drives_are_no_wrong_scale_of_one():
    """Each torque over its own constant: the factors, and no fault where these are 1."""
    arm, log = robot("arm"), ident.read_log(ROBOTS / "arm" / "run.csv")
    fitted = arm.with_effect("viscous").with_effect("coulomb")
    constants = {"yaw": 12.0, "shoulder": 19.0, "elbow": 6.0, "wrist": 4.0}
    amperes = {f"tau__{n}": log.columns[f"tau.{n}"] / K for n, K in constants.items()}
    fit = ident.identify(fitted, ident.complete(fitted, changed(log, **amperes)))
    (fault,) = fit.health.faults
    assert fault.code == "units"
    assert set(fault.where) == {f"tau.{n}" for n in constants}
    about = dict(re.findall(r"(\w+) ([\d.]+)[,]", fault.remedy))
    assert all(abs(np.log(float(about[n]) / K)) < 0.5 for n, K in constants.items())
    fit = ident.identify(arm, ident.complete(arm, log))
    assert not {each.code for each in fit.health.findings} & {"units", "magnitude", "scale"}


@pytest.mark.parametrize("factor", [0.4, 2.5])
def test_known_friction_that_changed_is_no_scale(factor):
    """Last month's model on a log in which the dry friction of the wrist is another one."""
    model = replace(robot("arm").with_effect("coulomb:wrist", {"Fc": 0.6}), unknown=())
    changed_one = robot("arm").with_effect("coulomb:wrist", {"Fc": 0.6 * factor})
    noise = [Noise("tau", 0.005, relative=True)]
    p = plant(changed_one, motion_log("arm"), spread=0.0, offset=0.0, noise=noise, seed=2)
    assert found(judged(model, p.log)) == set()
    log = changed(p.log, tau__elbow=2.5 * p.log.columns["tau.elbow"])
    assert ("scale", ("tau.elbow",)) in found(judged(model, log))


def test_no_factor_makes_a_torque_that_the_equations_forget():
    """The smaller the factor, the less of what known bodies need is left: no small torque fits."""
    model = replace(robot("arm").with_effect("coulomb:wrist", {"Fc": 0.6}), unknown=())
    fit = ident.identify(model, ident.complete(model, planted("arm", seed=2).log))
    equations = DataChecks.of(fit.problem, fit.estimate, fit.relative).equations
    logged = equations.as_logged
    wrist = equations.driven.index("wrist")
    errors = [
        equations.noise(logged.replaced("scale", f, gain={wrist: f}))[wrist]
        for f in np.geomspace(1.0, 1e-8, 9)
    ]
    assert np.all(np.diff(errors[2:]) > 0)


@pytest.mark.parametrize("lag", [4e-3, -3e-3])
def test_some_milliseconds_of_all_torques_are_measured(lag):
    p = planted("arm", noise=0.01, seconds=8.0, seed=2)
    late = {
        key.replace(".", "__"): np.interp(p.log.t - lag, p.log.t, x)
        for key, x in p.log.columns.items()
        if key.startswith("tau.")
    }
    fit = ident.identify(p.mechanism, ident.complete(p.mechanism, changed(p.log, **late)))
    c = fit.checks
    delay = common_delay(c.estimate, c.table, c.use, c.common)
    assert abs(delay.delay - lag) < max(3 * delay.stderr, 0.15 * abs(lag))
    assert delay.stderr < 0.3 * abs(lag)
    assert [len(x.where) for x in fit.health.findings if x.code == "delay"] == [
        len(fit.motion.independent)
    ]
    assert any("--with delay:" in x.remedy for x in fit.health.findings)


@pytest.mark.parametrize("kind", ["", "hysteresis", "stribeck", "elasticity"])
def test_friction_and_gears_are_no_delay_of_all_torques(kind):
    stiff = {"compliance": 1e-3, "damping": 1.0}  # drawn at random, some hold no link
    values = {f"elasticity.{j}.{k}": x for j in robot("arm").driven for k, x in stiff.items()}
    values = values if kind == "elasticity" else {}
    p = planted("arm", *([kind] if kind else []), seconds=8.0, seed=3, values=values)
    fitted = robot("arm").with_effect("viscous").with_effect("coulomb")
    c = ident.identify(fitted, ident.complete(fitted, p.log)).checks
    assert common_delay(c.estimate, c.table, c.use, c.common) is None


@pytest.mark.parametrize("wrong", [("wrist",), ("elbow", "wrist")])
def test_a_wrong_factor_is_no_missing_effect_that_does_as_well_only_here_or_only_elsewhere(wrong):
    """Of one torque, effects of one kind at all drives leave as little on average of all joints;
    of two, in the joints that feel the last factor.
    """
    p = plant(planted("arm").mechanism, motion_log("arm", 100.0, 6.0), seed=3,
              noise=[Noise("tau", 0.01, relative=True), Noise("q", 1e-5)])  # fmt: skip
    ten = {f"tau__{joint}": 10 * p.log.columns[f"tau.{joint}"] for joint in wrong}
    judgement = judged(p.mechanism, changed(p.log, **ten), "auto")
    assert {(each.code, each.where) for each in judgement.faults} == {
        ("scale", (f"tau.{joint}",)) for joint in wrong
    }
    assert [each.number for each in judgement.faults] == pytest.approx([0.1] * len(wrong), rel=0.05)


def test_the_line_to_copy_keeps_the_scale_of_its_channel():
    mechanism = replace(robot("arm"), columns={"tau.elbow": Column("current_3", 2.5, 0.0)})
    own = '[log] "tau.elbow" = { column = "current_2", scale = 2.5 }'
    assert log_entry(mechanism, "tau.elbow", 1.0, "current_2") == own
    assert log_entry(robot("arm"), "tau.yaw", 1.0, "b") == '[log] "tau.yaw" = { column = "b" }'


def test_one_line_turns_all_torques_where_a_pattern_makes_them(tmp_path, robots):
    """As it is written into mechanism.toml it does."""
    toml = (robots / "arm" / "mechanism.toml").read_text()
    (tmp_path / "arm.urdf").write_text((robots / "arm" / "arm.urdf").read_text())

    def loaded(log: str) -> ident.Mechanism:
        (tmp_path / "mechanism.toml").write_text(f"{toml}\n[log]\n{log}\n")
        return ident.load(tmp_path)

    for given, line in (
        ("", '"tau.*" = { column = "tau.*", scale = -1 }'),
        ('"tau.*" = "effort_*"', '"tau.*" = { column = "effort_*", scale = -1 }'),
    ):
        mechanism = loaded(given)
        torques = [f"tau.{name}" for name in mechanism.driven]
        assert log_entries(mechanism, torques, -1.0) == f"[log] {line}"
        assert {loaded(line).columns[each].scale for each in torques} == {-1.0}
    assert log_entries(mechanism, torques[:2], -1.0).count("[log]") == 2
    assert log_entries(mechanism, (), 0.5) == ""  # time is of no joint
    passive = robot("five_bar").passive[:2]
    assert log_entries(robot("five_bar"), [f"tau.{x}" for x in passive], -1.0).count("[log]") == 2
    by_one = loaded("\n".join(f'"{each}" = "current_{i}"' for i, each in enumerate(torques)))
    first = log_entry(by_one, torques[0], -1.0)
    assert log_entries(by_one, torques, -1.0) == f"{first}, and the same for the others"


def test_the_line_to_copy_keeps_the_offset_of_its_columns(tmp_path, robots, spoken):
    """Torques are counts around 2048, of which [log] makes N m with the wrong sign."""
    p = planted("arm", seed=3)
    counts = {f"adc_{j}": 2048 - p.log.columns[f"tau.{j}"] / 0.01 for j in p.mechanism.driven}
    positions = {k: x for k, x in p.log.columns.items() if k.startswith("q.")}
    log = tmp_path / "run.csv"
    Log.from_arrays("run.csv", p.log.t, {**positions, **counts}).write(log)
    (tmp_path / "arm.urdf").write_text((robots / "arm" / "arm.urdf").read_text())
    toml = (robots / "arm" / "mechanism.toml").read_text()

    def checked(line):
        (tmp_path / "mechanism.toml").write_text(f"{toml}\n[log]\n{line}\n")
        status, text, _ = spoken("check", tmp_path, log)
        assert status == 0
        return " ".join(text.split())

    text = checked('"tau.*" = { column = "adc_*", scale = 0.01, offset = -20.48 }')
    assert "the sign is against that of q.yaw" in text
    line = '"tau.*" = { column = "adc_*", scale = -0.01, offset = 20.48 }'
    assert f"write [log] {line}" in text
    assert "no channel looks wrong" in checked(line)
    one = ident.load(tmp_path)
    (own,) = {one.columns[name].offset for name in one.columns}
    assert f"offset = {own:g} }}" in log_entry(one, "tau.elbow", 1.0, "adc_wrist")


def test_times_from_1970_keep_their_fractions():
    assert [stamp(1763971201.254), stamp(12.3456789)] == ["1763971201.25", "12.3457"]


def test_a_rotor_that_bodies_stand_in_for_is_no_other_shape_of_theirs():
    mechanism = robot("arm")
    hidden = mechanism.with_effect("rotor_inertia:elbow")
    noise = (Noise("tau", 0.005, relative=True), Noise("q", 1e-5))
    case = plant(hidden, motion_log("arm", 100.0, 10.0), {"rotor_inertia.elbow.Ia": 2.0},
                 noise=noise, seed=1)  # fmt: skip
    fit = ident.identify(mechanism, ident.complete(mechanism, case.log))
    assert not fit.health.findings


# --- what real machines showed -----------------------------------------------------------------


def test_velocities_that_are_always_zero_are_derived():
    """Some loggers write a column that nobody fills."""
    p = planted("arm")
    zero = {f"v.{j}": np.zeros(len(p.log.t)) for j in p.mechanism.driven}
    positions = {k: x for k, x in p.log.columns.items() if k[:2] not in ("v.", "a.")}
    bare = Log.from_arrays("run.csv", p.log.t, positions)
    log = Log.from_arrays("run.csv", p.log.t, {**positions, **zero})
    motion, without = (ident.complete(p.mechanism, each) for each in (log, bare))
    assert motion.band == without.band
    np.testing.assert_array_equal(motion.experiments[0].yd, without.experiments[0].yd)
    (note,) = [each for each in motion.notes if "always 0" in each]
    assert all(name in note for name in zero)


def test_a_joint_that_stands_still_keeps_its_zero_velocity():
    p = planted("arm")
    at = {"q.wrist": np.full(len(p.log.t), 0.2), "v.wrist": np.zeros(len(p.log.t))}
    motion = ident.complete(p.mechanism, changed(p.log, **at))
    assert not [each for each in motion.notes if "always 0" in each]


def test_lone_samples_are_judged_by_the_noise_of_motion():
    """A drive may be ten times as noisy in motion, of which a log may hold less than half."""
    p = planted("arm", noise=0.0)
    random = np.random.default_rng(0)
    still = 12 * 200
    q = {k: np.append(np.full(still, x[0]), x) for k, x in p.log.columns.items()}
    q |= {k: np.append(np.zeros(still), p.log.columns[k]) for k in q if k[:2] in ("v.", "a.")}
    t = np.arange(len(q["q.yaw"])) * 0.005
    noise = np.where(np.arange(len(t)) < still, 0.001, 0.1) * random.standard_normal(len(t))
    noisy = {**q, "tau.yaw": q["tau.yaw"] + noise}
    motion = ident.complete(p.mechanism, Log.from_arrays("run.csv", t, noisy))
    assert "lone samples" not in str([*log_findings(p.mechanism, motion)])
    noisy["tau.yaw"][still + 100 :: 100] += 10.0
    motion = ident.complete(p.mechanism, Log.from_arrays("run.csv", t, noisy))
    assert "lone samples" in str([*log_findings(p.mechanism, motion)])


def test_torques_with_the_other_sign_are_named_where_little_else_is_explained():
    """The bodies are those of the URDF turned over, whatever friction is missing."""
    p = plant(robot("arm"), motion_log("arm"), noise=[Noise("tau", 0.3, relative=True)], spread=0.1)
    log = changed(p.log, **{f"tau.{j}": -p.log.columns[f"tau.{j}"] for j in p.mechanism.driven})
    checks = ident.identify(p.mechanism, ident.complete(p.mechanism, log, cutoff="auto")).checks
    hints = [*checks._magnitudes()]
    (sign,) = [each for each in hints if "its negative" in each.meaning]
    assert set(sign.where) >= {"tau.shoulder", "tau.elbow"}
    assert not any({*sign.where} & {*each.where} for each in hints if each is not sign)


def test_a_log_without_any_motion():
    """Positions of several logs at rest, each at another place, identify gravity."""
    t, arm = np.arange(0.0, 2.0, 0.01), robot("arm")
    rest = [
        Log.from_arrays(f"{at}.csv", t, {
            f"{c}.{name}": np.full(len(t), at if c == "q" else 0.3)
            for c in ("q", "tau") for name in arm.driven
        })
        for at in (0.2, 0.5)
    ]  # fmt: skip
    one, two = (ident.complete(arm, x, cutoff=None) for x in (rest[0], rest))
    assert "no motion" in {each.code for each in log_findings(arm, one)}
    assert "no motion" not in {each.code for each in log_findings(arm, two)}


def test_the_other_sign_is_named_in_any_unit():
    p = plant(robot("arm"), motion_log("arm"), noise=[Noise("tau", 0.01)], spread=0.1)
    milli = {f"tau.{j}": -1e3 * p.log.columns[f"tau.{j}"] for j in p.mechanism.driven}
    motion = ident.complete(p.mechanism, changed(p.log, **milli), cutoff="auto")
    hints = [*ident.identify(p.mechanism, motion).checks._magnitudes()]
    (sign,) = [each for each in hints if "its negative" in each.meaning]
    assert "gravity = [0, 0, 9.81] at the top of mechanism.toml" in sign.remedy


def test_a_urdf_without_masses_has_no_shape():
    p = planted("arm")
    massless = p.mechanism.with_same_kinematics(model=p.mechanism.model.copy())
    for i in range(1, massless.model.njoints):
        massless.model.inertias[i].setZero()
    assert not massless.prior.any()
    assert "shape" not in str(judged(massless, p.log))


def test_dry_friction_that_drives_a_joint_is_the_first_thing_said():
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    large = {name: 3.0 if name == "coulomb.wrist.Fc" else 0.2
             for e in mechanism.effects for name in e.names}  # fmt: skip
    p = plant(mechanism, motion_log("arm"), large, noise=[Noise("tau", 0.01, relative=True)])
    log = changed(p.log, **{"tau.wrist": -p.log.columns["tau.wrist"]})
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    (driving,) = [each for each in fit.findings if each.code == "friction drives"]
    assert driving.where == ("tau.wrist",)
    assert "sign looks wrong of tau.wrist" in " ".join(str(fit).split())
    right = ident.identify(mechanism, ident.complete(mechanism, p.log))
    assert not [each for each in right.findings if each.code == "friction drives"]


def test_a_torque_beyond_the_drive_is_told_by_check():
    p = planted("arm")
    log = changed(p.log, **{"tau.elbow": 1e3 * p.log.columns["tau.elbow"]})
    (said,) = beyond_limits(p.mechanism, ident.complete(p.mechanism, log))
    assert "tau.elbow" in said
    assert "check their units" in said
    assert not beyond_limits(p.mechanism, ident.complete(p.mechanism, p.log))


def test_terms_are_moments_inertias_and_effects():
    """Of every unknown the physics in which it acts."""
    mechanism = ident.load(ROBOTS / "arm").with_effect("viscous")
    fit = ident.identify(mechanism, ident.complete(mechanism, ROBOTS / "arm" / "run.csv"))
    terms = fit.columns.terms
    first = [name for name, term in zip(fit.columns.names, terms, strict=True) if term == 0]
    assert {name.rpartition(".")[2] for name in first} == {"m", "mx", "my", "mz"}
    assert len({*terms}) == 2 + 4


def test_a_log_of_which_much_is_left_whatever_every_machine_has():
    """As `ident check` tells; what friction and a rotor explain is no such log."""
    ripple = {"ripple.elbow.A": 15.0, "ripple.elbow.B": 0.0, "ripple.elbow.N": 11.0}
    for effect, found in (("ripple:elbow", True), ("coulomb:elbow", False)):
        p = plant(robot("arm").with_effect(effect), motion_log("arm"), ripple)
        motion = ident.complete(robot("arm"), p.log, cutoff=None)
        hints = [x for x in data_findings(robot("arm"), motion) if x.code == "poor fit"]
        assert bool(hints) == found
        assert all(x.where == ("tau.elbow",) for x in hints)
        assert all(x.meaning.startswith("with friction, rotors and offsets") for x in hints)


def test_a_fault_is_named_where_nothing_is_unknown():
    """Not even an effect: all of the model is known, as in the folder of a fit."""
    p = planted("arm", noise=0.01, seed=6)
    known = replace(p.mechanism, effects=(), unknown=())
    values = dict(zip(known.bodies.names, known.prior, strict=True))
    log, _ = ident.simulate(known, p.log, values=values)
    turned = changed(log, tau__elbow=-log.columns["tau.elbow"])
    fit = ident.identify(known, ident.complete(known, turned))
    assert ("sign", ("tau.elbow",)) in found(health(fit))
    assert ident.diagnose(fit).health.faults


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("stamps", ["kept", "counted on"])
def test_every_second_row_of_a_log_is_a_copy(first, stamps):
    p = planted("arm", noise=0.01, seed=2)
    columns = {name: x[first::2] for name, x in p.log.columns.items()}
    t = p.log.t[first::2] if stamps == "kept" else 2 * p.log.t[: len(p.log.t[first::2])]
    thinned = Log.from_arrays("thinned.csv", t, columns)
    other = planted("arm", noise=0.01, seed=3).log
    assert [x.code for x in copies(p.log, thinned, "", "")] == ["copy"]
    assert [x.code for x in copies(thinned, p.log, "", "")] == ["copy"]
    assert copies(other, thinned, "", "") == []


def test_a_late_velocity_is_named():
    p = planted("arm", noise=0.01, seed=2)
    assert [*late_rates(p.log, p.mechanism)] == []
    late = np.interp(p.log.t - 0.025, p.log.t, p.log.columns["v.elbow"])
    (finding,) = late_rates(changed(p.log, v__elbow=late), p.mechanism)
    assert finding.where == ("v.elbow", "q.elbow")
    late[50] = 1e300
    assert [x.number for x in late_rates(changed(p.log, v__elbow=late), p.mechanism)]
    assert finding.number == pytest.approx(25.0, rel=0.05)


@pytest.mark.parametrize(("which", "meaning"), [
    ("q.", "it is the positions"), ("v.", "it is the velocities"), ("tau.", "against the positions")
])  # fmt: skip
def test_which_of_positions_velocities_and_torques_is_late_is_a_contest(which, meaning):
    """Two of the three agree."""
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    noise = [Noise("tau", 0.01, relative=True), Noise("q", 1e-5), Noise("v", 1e-3)]
    log = plant(mechanism, motion_log("arm", 200.0, 8.0), noise=noise, seed=1).log
    columns = {name: x for name, x in log.columns.items() if name[0] != "a"}
    for name, x in columns.items():
        if name.startswith(which):
            columns[name] = np.interp(log.t - 0.012, log.t, x)
    motion = ident.complete(mechanism, Log.from_arrays("late", log.t, columns))
    findings = ident.identify(mechanism, motion).health.findings
    (finding,) = (x for x in findings if x.code in ("late rates", "delay"))
    assert meaning in finding.meaning
    assert f"{which}elbow" in finding.meaning


def test_a_channel_of_two_publishers_is_named():
    p = planted("arm", noise=0.01, seed=2)
    turn = np.arange(len(p.log.t)) % 2 == 0
    x = np.where(turn, p.log.columns["tau.elbow"], p.log.columns["tau.elbow"] + 5.0)
    codes = {code for code, where in found(judged(p.mechanism, changed(p.log, tau__elbow=x)))}
    assert "alternating" in codes


def test_a_command_in_three_values_is_an_experiment():
    """No other finding tells to leave its samples empty."""
    p = planted("arm", noise=0.01, seed=2)
    x = p.log.columns["tau.elbow"] - np.median(p.log.columns["tau.elbow"])
    switched = changed(
        p.log, tau__elbow=np.abs(x).max() * np.sign(np.round(2 * x / np.abs(x).max()))
    )
    motion = ident.complete(p.mechanism, switched)
    codes = [x.code for x in log_findings(p.mechanism, motion) if "tau.elbow" in x.where]
    assert codes == ["switched"]
    assert motion.experiments[0].usable.mean() > 0.9


@pytest.mark.parametrize(("read", "sign"), [("elbow", 1.0), ("shoulder", 1.0), ("shoulder", -1.0)])
def test_an_encoder_behind_the_gears_of_joints_before_it_is_found(read, sign):
    """The wrist of an arm, whose axis is across that of the joints one and two links up."""
    p = planted("arm", seed=21)
    c = dict(p.log.columns)
    for letter in "qva":
        c[f"{letter}.wrist"] = c[f"{letter}.wrist"] + sign * c[f"{letter}.{read}"]
    unlimited = tuple(replace(j, lower=-np.inf, upper=np.inf) for j in p.mechanism.joints)
    mechanism = replace(p.mechanism, joints=unlimited)
    judgement = judged(mechanism, Log.from_arrays("run.csv", p.log.t, c))
    assert [(fault.code, fault.where[:2]) for fault in judgement.faults] == [
        ("position from", (f"q.{read}", "q.wrist"))
    ]
    assert f"q.wrist {'-' if sign > 0 else '+'} q.{read}" in str(judgement)
