"""Correlation, essential parameters, and what a motion does not tell."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from helpers import ROBOTS
from ident import Log, Noise
from ident.cli.app import main
from identification import motion_log, plant, robot


@pytest.fixture(scope="module")
def arm():
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    noise = [Noise("tau", 0.02, relative=True)]
    case = plant(mechanism, motion_log("arm", 200.0, 8.0), noise=noise)
    return case, case.fit(cutoff="auto")


# --- correlation -------------------------------------------------------------------------------


def test_correlation_is_the_covariance_in_units_of_standard_errors(arm):
    _, fit = arm
    s = np.array([v.stderr for v in fit.base_parameters])
    np.testing.assert_allclose(fit.correlation.matrix * np.outer(s, s), fit.covariance, atol=1e-12)
    names = fit.correlation.names
    assert [v.name.split()[0] for v in fit.base_parameters] == list(names)
    assert fit.correlation[names[0], names[0]] == pytest.approx(1.0)
    a, b, r = fit.correlation.pairs(0.0)[0]
    assert fit.correlation[a, b] == r == fit.correlation[b, a]
    with pytest.raises(KeyError, match="leads no base parameter"):
        fit.correlation["nothing", names[0]]


def test_two_friction_terms_at_one_speed_are_known_only_together():
    """At nearly constant speed Fv v and Fc sign v are one column; repeated runs agree with r."""
    mechanism = robot("arm")
    mechanism = replace(mechanism, unknown=()).with_effect("viscous:yaw").with_effect("coulomb:yaw")
    t = np.arange(0, 8, 0.005)
    q = 0.8 * np.arcsin(0.995 * np.sin(2 * np.pi * 0.4 * t))  # a triangle with round corners
    log = Log.from_arrays(
        "t", t, {"q.yaw": q} | {f"q.{j}": 0 * t for j in ("shoulder", "elbow", "wrist")}
    )
    found = []
    for seed in range(24):
        case = plant(mechanism, log, noise=[Noise("tau", 0.05)], seed=seed)
        fit = case.fit(cutoff="auto")
        found.append(fit.estimate.solution.x - case.base(fit))
    r = np.corrcoef(np.array(found).T)[0, 1]
    said = fit.correlation["viscous.yaw.Fv", "coulomb.yaw.Fc"]
    assert r < -0.9
    assert said == pytest.approx(r, abs=0.08)
    if said < -0.95:
        assert "known only together" in str(fit)


# --- essential parameters ----------------------------------------------------------------------


def test_what_is_not_there_is_not_essential(tmp_path):
    """Friction is planted on two of four joints: the other two joints' terms go."""
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    none = {name: 0.0 for effect in mechanism.effects for name in effect.names}
    planted = none | {"viscous.shoulder.Fv": 0.6, "coulomb.elbow.Fc": 0.7}
    noise = [Noise("tau", 0.01, relative=True)]
    case = plant(mechanism, motion_log("arm", 200.0, 8.0), planted, noise=noise)
    fit = case.fit(cutoff="auto")
    essential = fit.essential
    kept = {n for n in essential.names if n.split(".")[0] in ("viscous", "coulomb")}
    assert {"viscous.shoulder.Fv", "coulomb.elbow.Fc"} <= kept
    gone = {d.name for d in essential.dropped}
    assert len(gone & (none.keys() - {"viscous.shoulder.Fv", "coulomb.elbow.Fc"})) >= 4
    for joint, error in essential.full.items():
        assert essential.reduced[joint].rms <= 1.01 * error.rms
    assert essential.values["coulomb.elbow.Fc"] == pytest.approx(0.7, rel=0.05)
    assert essential.line in " ".join(str(fit).split())
    fit.write(tmp_path)
    data = json.loads((tmp_path / "fit.json").read_text())
    assert {p["name"] for p in data["essential"]["parameters"]} == set(essential.names)
    assert [d["name"] for d in data["essential"]["dropped"]] == [d.name for d in essential.dropped]


def test_held_out_errors_of_the_full_model_are_those_of_the_fit(arm):
    """From the base parameters alone, with weights kept: the same as `fit.held_out`."""
    _, fit = arm
    if len(fit.estimate.sigma) != len(fit.held_out):
        pytest.skip("torques and motion were weighed together")
    for joint, error in fit.essential.full.items():
        assert error.rms == pytest.approx(fit.held_out[joint].rms, rel=1e-6)


def test_the_reduced_model_is_least_squares_without_the_dropped_columns(arm):
    """Against numpy on the rows themselves."""
    from ident.fit.table import Table

    _, fit = arm
    table = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
    base = fit.estimate.base
    kept = [i for i in base.independent if fit.columns.names[i] in fit.essential.names]
    x = np.where(fit.estimate.held, fit.estimate.solution.x, 0.0)
    rows, right = [], []
    for u, sigma in enumerate(fit.problem.row_scale(fit.estimate)):
        told = table.informed[:, u]
        A = table.A[told, u] / sigma
        rows.append(A[:, kept])
        right.append(table.b[told, u] / sigma - A @ x)
    beta = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    said = [fit.essential.values[fit.columns.names[i]] for i in kept]
    np.testing.assert_allclose(said, beta, rtol=1e-6, atol=1e-9)


def test_one_stretch_of_time_tells_nothing_of_essentials(arm):
    _, fit = arm
    first = fit.information.where(lambda block: block.block == 0)
    one = replace(fit, problem=replace(fit.problem, information=first))
    assert one.essential is None


# --- what a motion does not tell ---------------------------------------------------------------


@pytest.fixture(scope="module")
def still_wrist():
    """The arm's log with a wrist that does not move."""
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    log = motion_log("arm", 200.0, 8.0)
    columns = dict(log.columns)
    columns |= {c: np.full_like(log.t, log.columns[c].mean()) for c in columns if c == "q.wrist"}
    columns |= {c: 0 * log.t for c in columns if c in ("v.wrist", "a.wrist")}
    noise = [Noise("tau", 0.01, relative=True)]
    return plant(mechanism, Log.from_arrays("still.csv", log.t, columns), noise=noise).fit(
        cutoff="auto"
    )


def test_a_joint_that_stood_still_is_the_advice(still_wrist):
    said = still_wrist.unexcited
    names = {each.name for each in said.lost}
    assert {"viscous.wrist.Fv", "coulomb.wrist.Fc"} <= names
    by_name = {each.name: each for each in said.lost}
    assert by_name["viscous.wrist.Fv"].why == "unfelt"
    assert by_name["viscous.wrist.Fv"].joints == ("wrist",)
    assert by_name["coulomb.wrist.Fc"].joints == ("wrist",)
    (sentence,) = [s for s in said.advice if "swing wrist by ±0.5 rad" in s]
    assert "it moved through" in sentence
    assert "hand." in sentence
    assert all(s in str(said) for s in said.advice)


def test_the_advice_helps(still_wrist):
    """What is swung tells what it was said to tell, by another simulation."""
    mechanism, said = still_wrist.mechanism, still_wrist.unexcited
    log = motion_log("arm", 200.0, 8.0)
    columns = {c: log.columns[c] for c in log.columns if c.startswith("q.")}
    mean = columns["q.wrist"].mean()
    w = 2 * np.pi * np.array([0.7, 1.1])
    columns["q.wrist"] = mean + 0.25 * np.sin(np.outer(log.t, w)).sum(axis=1)
    noise = [Noise("tau", 0.01, relative=True)]
    fit = plant(mechanism, Log.from_arrays("swing.csv", log.t, columns), noise=noise).fit(
        cutoff="auto"
    )
    told = {fit.columns.names[i] for i in fit.estimate.base.independent}
    hoped = {each.name for each in said.lost if each.joints[:1] == ("wrist",)}
    assert len(hoped) >= 4
    assert hoped <= told


def test_a_motion_that_tells_all_is_said_to(arm):
    _, fit = arm
    assert fit.unexcited.lost == ()
    assert str(fit.unexcited) == "this motion tells all that a motion can tell"


def test_a_loop_with_one_drive_still_is_advised_to_move_it():
    """A five-bar whose right drive is held: what only its motion shows."""
    mechanism = robot("five_bar").with_effect("viscous").with_effect("coulomb")
    t = np.arange(0, 6, 0.005)
    log = Log.from_arrays(
        "held.csv", t, {"q.left": 2.1 + 0.4 * np.sin(3 * t), "q.right": np.full_like(t, 1.04)}
    )
    noise = [Noise("tau", 0.01, relative=True)]
    said = plant(mechanism, log, noise=noise).fit(cutoff="auto").unexcited
    assert said.lost
    assert {each.joints[0] for each in said.lost if each.joints} == {"right"}


@pytest.fixture(scope="module")
def small():
    """±0.02 rad, and noise."""
    t, rest = np.arange(0, 6, 0.005), {"yaw": 0.0, "shoulder": -0.6, "elbow": 1.0, "wrist": 0.2}
    columns = {f"q.{j}": x + 0.02 * np.sin((1.3 + i) * t) for i, (j, x) in enumerate(rest.items())}
    return plant(robot("arm"), Log.from_arrays("s", t, columns), noise=[Noise("tau", 0.1)])


def test_small_motion_hides_in_noise(small):
    """Held at the prior, and said which swing would show it."""
    hidden = [each for each in small.fit(cutoff="auto").unexcited.lost if each.why == "noise"]
    assert hidden
    assert all(each.after < each.before for each in hidden)
    assert all(each.joints for each in hidden)


def test_standard_errors_hold_the_priors_of_what_is_held(small):
    """Base parameters are off by the wrong priors of the held unknowns, 300 times the noise."""
    fit = small.fit(cutoff="auto")
    assert fit.estimate.held.any()
    off = fit.estimate.solution.beta - small.base(fit)
    assert (np.abs(off) < 3 * np.sqrt(np.diag(fit.covariance))).all()


def test_the_command_shows_both(small, capsys, monkeypatch, tmp_path):
    told = {c: x for c, x in small.log.columns.items() if c[0] in "qt"}
    Log.from_arrays("s", small.log.t, told).write(tmp_path / "s.csv")
    command = ["ident", "identify", str(ROBOTS / "arm"), str(tmp_path / "s.csv")]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code
    said = capsys.readouterr()
    assert "essential: " in said.out
    assert "note: to tell " in said.err
    assert ": swing " in said.err
