"""What a diagnosis announces is what the refit delivers."""

from __future__ import annotations

from contextlib import suppress
from functools import cache, reduce
from operator import add

import pytest

import ident
from helpers import ROBOTS
from ident import Diagnosis, Fit, Mechanism, Motion, Noise
from ident.assess.exploration import Exploration
from ident.diagnosis.grow import Step
from ident.diagnosis.result import announced_with
from identification import Planted, motion_log, plant, robot

NOISE = [Noise("tau", 0.01, relative=True)]
HIDDEN = {
    "arm": ("coulomb:elbow", {"coulomb.elbow.Fc": 0.6}),
    "four_bar": ("viscous:rocker", {"viscous.rocker.Fv": 0.2}),
}


@cache
def planted(name: str) -> Planted:
    effect, values = HIDDEN[name]
    mechanism = robot(name).with_effect(effect)
    return plant(mechanism, motion_log(name, 100.0, 8.0), values, noise=NOISE, seed=3)


@cache
def bare(name: str) -> Fit:
    return planted(name).fit(mechanism=robot(name), cutoff="auto")


@cache
def diagnosed(name: str) -> Diagnosis:
    return ident.diagnose(bare(name))


class EnoughStepsError(Exception):
    """Ends a search."""


def first_steps(mechanism: Mechanism, motion: Motion) -> list[Step]:
    """The model that is given and the first group of effects that a search adds."""
    steps: list[Step] = []

    def reached(step: Step) -> None:
        steps.append(step)
        if len(steps) == 2:
            raise EnoughStepsError

    with suppress(EnoughStepsError):
        ident.grow(mechanism, motion, step=reached)
    return steps


@pytest.mark.parametrize("name", HIDDEN)
def test_the_fall_announced_is_the_fall_delivered(name):
    """With a motion completed and both models fitted anew, from nothing that the diagnosis knew."""
    d, case = diagnosed(name), planted(name)
    linear = [each for each in d.candidates if each.effect.linear]
    assert HIDDEN[name][0] in {each.effect.label for each in linear}
    motion = ident.complete(robot(name), case.log)
    old = ident.identify(robot(name), motion)
    for each in linear:
        new = ident.identify(robot(name).with_effect(each.effect.label), motion)
        for joint in motion.independent:
            for told, fit in ((each.before, old), (each.after, new)):
                assert told[joint].rms == pytest.approx(fit.held_out[joint].rms, rel=1e-6)
                assert told[joint].relative == pytest.approx(fit.held_out[joint].relative, rel=1e-6)
        errors = (fit.held_out[each.joint].rms for fit in (new, old))
        assert each.fall == pytest.approx(1 - next(errors) / next(errors), abs=1e-6)
        assert each.json()["error_after"] == each.after[each.joint].relative


def test_the_ladder_announces_the_same():
    first, second = first_steps(robot("arm"), bare("arm").motion)
    (added,) = second.added
    found = next(e for e in diagnosed("arm").candidates if e.effect.label == added.label)
    for joint, error in second.errors.items():
        assert error.rms == pytest.approx(found.after[joint].rms, rel=1e-9)
        assert first.errors[joint].rms == pytest.approx(found.before[joint].rms, rel=1e-9)


def test_diagnose_explore_and_grow_begin_with_the_same_group():
    """Friction is missing in all joints: it is added at once, with the same error announced, and a
    diagnosis has the error of the fit that follows.
    """
    mechanism = robot("arm")
    motion = ident.complete(mechanism, ROBOTS / "arm" / "run.csv")
    fit = ident.identify(mechanism, motion, estimator="least-squares")
    d = ident.diagnose(fit)
    assert {each.label for each in d.group} == {f"coulomb:{name}" for name in mechanism.driven}
    assert d.rivals == ()
    _, rung = first_steps(mechanism, motion)
    assert [each.label for each in rung.added] == [each.label for each in d.group]
    announced = announced_with(d.selection, d.members_of_group)
    for joint, error in rung.errors.items():
        assert error.rms == pytest.approx(announced[joint].rms, rel=1e-9)
    model = reduce(add, d.group, mechanism)
    for joint, error in ident.identify(model, motion).held_out.items():
        assert error.rms == pytest.approx(d.after[joint].rms, rel=1e-6)
    offered = Exploration.of(mechanism, motion).screened().candidates
    assert offered[0].label == d.group[0].label


def test_a_short_log_has_its_name_though_the_best_candidate_makes_no_better_set():
    log = ident.read_log(ROBOTS / "arm" / "run.csv")
    some = {name: x[:450] for name, x in log.columns.items()}
    mechanism = robot("arm")
    motion = ident.complete(mechanism, ident.Log.from_arrays("short", log.t[:450], some))
    d = ident.diagnose(ident.identify(mechanism, motion))
    assert d.verdict == "missing"
    true = {f"{kind}:{joint}" for kind in ("viscous", "coulomb") for joint in mechanism.driven}
    assert d.best.label in true
    assert {each.label for each in d.selection.named} <= true
