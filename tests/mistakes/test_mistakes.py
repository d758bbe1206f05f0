"""A small part of the table of mistakes; `python tests/mistakes/table.py` makes the whole."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

import further  # noqa: F401  registers its kinds
from kinds import MADE, Mistake
from subjects import ROBOTS, Case, clean, positions_only, subjects
from verdict import judge

import ident

ACCEPTED = ("error", "named", "doubt", "right")
NAMED = (  # on the arm, by the right name
    "all torques in lb in",
    "one torque without its gear ratio of 101",
    "sign of all torques",
    "two torques exchanged",
    "one torque always zero",
    "two positions exchanged",
    "one position counted from the world, the URDF's from the link before",
    "two joints' names exchanged in the log",
    "gravity upside down",
    "time in ms",
    "one joint moved alone",
    "columns in the order of the alphabet, names in that of the URDF",
    "one torque of zero in every tenth cell, where none was read",
    "all torques computed by the URDF's model",
    "one torque commanded in three values",
    "one torque as signed integers that wrap at 16 bits",
)


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Case:
    subject = next(each for each in subjects() if each.name == "arm")
    return clean(subject, tmp_path_factory.mktemp("arm"))


@pytest.mark.parametrize("name", NAMED)
def test_a_mistake_is_named(arm, name, tmp_path):
    (mistake,) = (each for each in MADE if each.name == name)
    verdict = judge(arm, mistake, tmp_path)
    assert verdict.outcome in ("error", "named"), verdict.said


def test_a_gain_that_drifts_is_no_drift_of_an_offset(arm):
    """The formula of it is, with its constant: 1 to 1.3 times in 5 s."""
    gain = 1 + 0.06 * arm.columns["t"]
    case = positions_only(arm.logged(tau__elbow=gain * arm.columns["tau.elbow"]))
    log = ident.Log.from_arrays("run.csv", case.columns["t"],
                                {n: x for n, x in case.columns.items() if n != "t"})  # fmt: skip
    found = ident.diagnose(ident.identify(arm.truth, ident.complete(arm.truth, log)))
    assert found.best is None
    assert found.verdict == "unexplained"


def test_a_length_that_a_clock_could_be_is_said_to_be_either(arm):
    """Lengths 0.81 times as long and a clock 1/0.9 times as long make the same torques."""
    columns = positions_only(arm.logged(t=0.9 * arm.columns["t"])).columns
    log = ident.Log.from_arrays("run.csv", columns.pop("t"), columns)
    found = ident.diagnose(ident.identify(arm.truth, ident.complete(arm.truth, log)))
    said = " ".join(found.short.split())
    assert found.best is None or "Which of these it is remains open" in said.partition("error:")[0]
    assert found.best is None or "another scale of time" in said
    assert "ident add" not in said
    assert "Add " not in said
    assert any(each.code == "time" for each in found.health.findings)


@pytest.mark.parametrize("name", ["clock 10 % slow", "one length 10 % too long"])
def test_what_hardly_shows_is_not_called_something_else(arm, name, tmp_path):
    (mistake,) = (each for each in MADE if each.name == name)
    assert judge(arm, mistake, tmp_path).outcome in ACCEPTED


def test_what_noise_does_not_explain_is_said(tmp_path):
    """Of a Panda whose URDF has one length 10 % too long, one torque is left to 4.5 %."""
    panda = [each for each in subjects() if each.name == "panda"]
    if not panda:
        pytest.skip("the URDF is of the package example-robot-data")
    (mistake,) = (each for each in MADE if each.name == "one length 10 % too long")
    verdict = judge(clean(panda[0], tmp_path / "truth"), mistake, tmp_path)
    assert verdict.outcome in ACCEPTED, verdict.said
    assert any("more than noise of the sensors makes" in text for text in verdict.said)


def test_a_loop_of_one_angle_blames_no_sign_for_another_run(tmp_path):
    (loop,) = (each for each in subjects() if each.name == "parallelogram")
    (mistake,) = (each for each in MADE if each.name == "all torques of another run")
    verdict = judge(clean(loop, tmp_path / "truth"), mistake, tmp_path)
    assert verdict.outcome == "doubt", verdict.said


@pytest.mark.parametrize("name", ["gravity upside down", "zero of one position a right angle off"])
def test_bodies_unlike_the_urdf_are_doubted(name, tmp_path):
    """Of one angle any moments fit; those of the URDF are known to some 30 %."""
    (loop,) = (each for each in subjects() if each.name == "parallelogram")
    (mistake,) = (each for each in MADE if each.name == name)
    verdict = judge(clean(loop, tmp_path / "truth"), mistake, tmp_path)
    assert verdict.outcome == "doubt", verdict.said
    assert any("of another shape than the URDF's" in text for text in verdict.said)


def test_there_are_sixty_kinds():
    assert len({each.name for each in MADE}) == len(MADE) >= 60


ABSENT = (  # what a log on the way to `ident identify` may be, and no kind of the table is
    ("the brakes closed and the motors off for the last three tenths", lambda c: _ended(c, True)),
    ("the motors off for a moment", lambda c: _ended(c, False)),
    ("one torque that is a velocity",
     lambda c: c.logged(tau__elbow=np.gradient(c.columns["q.elbow"], c.columns["t"]))),
    ("a gain that drifts by 30 %",
     lambda c: c.logged(tau__elbow=c.columns["tau.elbow"]
                        * np.linspace(1, 1.3, len(c.columns["t"])))),
)  # fmt: skip


def _ended(case: Case, brakes: bool) -> Case:
    """Torques of zero, at the end with joints that stand, or in a part of the middle."""
    n = len(case.columns["t"])
    part = slice(int(0.7 * n), n) if brakes else slice(int(0.5 * n), int(0.56 * n))
    found = {name: x.copy() for name, x in case.columns.items()}
    for name, x in found.items():
        if name.startswith("tau."):
            x[part] = 0.0
        elif name.startswith("q.") and brakes:
            x[part] = x[part.start]
    return replace(case, columns=found)


@pytest.mark.parametrize(("name", "make"), ABSENT)
def test_a_mistake_beside_the_table_is_not_silent(arm, name, make, tmp_path):
    verdict = judge(arm, Mistake(name, make, "nothing names it"), tmp_path)
    assert verdict.outcome in ("error", "named", "doubt"), (verdict.outcome, verdict.said)


def _shipped(name: str, channel: str, change, folder: Path) -> list[str]:
    """The codes of what is said of a shipped log with one channel changed."""
    mechanism = ident.load(ROBOTS / name).with_effect("viscous").with_effect("coulomb")
    log = ident.read_log(ROBOTS / name / "run.csv")
    columns = {**log.columns, channel: change(log)}
    file = folder / "run.csv"
    table = np.column_stack([log.t, *columns.values()])
    np.savetxt(file, table, delimiter=",", header=",".join(["t", *columns]), comments="")
    motion = ident.complete(mechanism, file)
    return [each.code for each in ident.identify(mechanism, motion).all_findings]


def test_two_remedies_that_do_as_well_and_leave_much_are_none(tmp_path):
    """A torque that is stored backwards is neither exchanged nor turned."""
    codes = _shipped("arm", "tau.elbow", lambda log: log.columns["tau.elbow"][::-1], tmp_path)
    assert "poor fit" in codes
    assert not {"swapped", "sign", "delay"} & set(codes)


def test_a_clock_that_no_log_determines_is_not_named(tmp_path):
    """On the five-bar gravity does no work; a negative dry friction is no slow clock."""

    def compensated(log: ident.Log) -> np.ndarray:
        speed = np.gradient(log.columns["q.left"], log.t)
        return np.asarray(log.columns["tau.left"] - 0.126 * np.tanh(speed / 0.01))

    codes = _shipped("five_bar", "tau.left", compensated, tmp_path)
    assert "negative" in codes
    assert "time" not in codes
