"""Correlation, and what a motion does not tell."""

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
    assert {"viscous.wrist.Fv", "coulomb.wrist.Fc"} <= set(said.where)
    assert "(it moves wrist by " in str(said)
    assert "hand." in str(said)


def test_the_advice_helps(still_wrist):
    """A motion of the joint that is named tells what was lost, by another simulation."""
    mechanism = still_wrist.mechanism
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
    hoped = set(still_wrist.unexcited.where)
    assert len(hoped) >= 4
    assert hoped <= told


def test_a_motion_that_tells_all_is_said_to(arm):
    _, fit = arm
    assert fit.unexcited is None


def test_a_loop_with_one_drive_still_is_advised_to_move_it():
    """A five-bar whose right drive is held: what only its motion shows."""
    mechanism = robot("five_bar").with_effect("viscous").with_effect("coulomb")
    t = np.arange(0, 6, 0.005)
    log = Log.from_arrays(
        "held.csv", t, {"q.left": 2.1 + 0.4 * np.sin(3 * t), "q.right": np.full_like(t, 1.04)}
    )
    noise = [Noise("tau", 0.01, relative=True)]
    said = plant(mechanism, log, noise=noise).fit(cutoff="auto").unexcited
    assert "(it moves right by " in str(said)


@pytest.fixture(scope="module")
def small():
    """±0.02 rad, and noise."""
    t, rest = np.arange(0, 6, 0.005), {"yaw": 0.0, "shoulder": -0.6, "elbow": 1.0, "wrist": 0.2}
    columns = {f"q.{j}": x + 0.02 * np.sin((1.3 + i) * t) for i, (j, x) in enumerate(rest.items())}
    return plant(robot("arm"), Log.from_arrays("s", t, columns), noise=[Noise("tau", 0.1)])


def test_small_motion_hides_in_noise(small):
    """Held at the prior, and listed."""
    fit = small.fit(cutoff="auto")
    held = {fit.columns.names[i] for i in np.flatnonzero(fit.estimate.fixed)}
    assert held & set(fit.unexcited.where)


def test_standard_errors_hold_the_priors_of_what_is_held(small):
    """Base parameters are off by the wrong priors of the held unknowns, 300 times the noise."""
    fit = small.fit(cutoff="auto")
    assert fit.estimate.fixed.any()
    off = fit.estimate.solution.beta - small.base(fit)
    assert (np.abs(off) < 3 * np.sqrt(np.diag(fit.covariance))).all()


def test_the_command_shows_both(small, capsys, monkeypatch, tmp_path):
    told = {c: x for c, x in small.log.columns.items() if c[0] in "qt"}
    Log.from_arrays("s", small.log.t, told).write(tmp_path / "s.csv")
    command = ["ident", "identify", str(ROBOTS / "arm"), str(tmp_path / "s.csv"), "--verbose"]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code
    said = capsys.readouterr()
    assert "this motion does not determine " in said.err
