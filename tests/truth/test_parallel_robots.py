"""Machines of robots/ with loops, balls or a base that flies: what is hidden in their logs."""

import numpy as np
import pytest

import ident
from helpers import ROBOTS

CASES = {
    "stewart": ("viscous", "coulomb:leg4", {"coulomb.leg4.Fc": 14.0}),
    "delta": (
        "viscous", "spring:arm2_drive", {"spring.arm2_drive.k": 3.5, "spring.arm2_drive.b": 0.4},
    ),
    "redundant_planar": ("viscous", "coulomb:drive2", {"coulomb.drive2.Fc": 0.12}),
    "quadrotor": (
        "", "body_drag:body",
        {"body_drag.body.Dx": 0.25, "body_drag.body.Dy": 0.25, "body_drag.body.Dz": 0.1},
    ),
}  # fmt: skip
FREEDOM = {"stewart": 6, "delta": 3, "redundant_planar": 2, "quadrotor": 6}


@pytest.fixture(scope="module", params=CASES)
def fit(request):
    common, _, _ = CASES[request.param]
    mechanism = ident.load(ROBOTS / request.param)
    mechanism = mechanism.with_effect(common) if common else mechanism
    motion = ident.complete(mechanism, ROBOTS / request.param / "run.csv")
    return ident.identify(mechanism, motion)


def test_what_is_hidden_is_named(fit):
    _, label, _ = CASES[fit.mechanism.name]
    assert [effect.label for effect in ident.diagnose(fit).group] == [label]


def test_with_it_values_are_the_truth(fit):
    _, label, truth = CASES[fit.mechanism.name]
    assert fit.mechanism.degrees_of_freedom == FREEDOM[fit.mechanism.name]
    mechanism = fit.mechanism.with_effect(label)
    values = ident.identify(mechanism, fit.motion).effects
    found = {x.name: x for effect in values for x in effect.parameters}
    for name, x in truth.items():
        assert abs(found[name].value - x) < max(3 * found[name].stderr, 0.02 * x), name


@pytest.mark.parametrize("name", ["stewart", "delta"])
def test_grow_adds_what_acts_in_the_loops(name):
    mechanism = ident.load(ROBOTS / name)
    history = ident.grow(mechanism, ident.complete(mechanism, ROBOTS / name / "run.csv"))
    grown = history.steps[-1].fit
    common, label, truth = CASES[name]
    kinds = {effect.kind for effect in grown.mechanism.effects}
    assert {label} == {e.label for e in grown.mechanism.effects if e.kind != common}
    assert common in kinds
    for full, x in truth.items():
        assert abs(grown[full].value - x) < max(3 * grown[full].stderr, 0.02 * x), full
    assert max(error.relative for error in grown.train.values()) < 0.006


def test_thrust_factors_are_known_with_a_known_mass():
    mechanism = ident.load(ROBOTS / "quadrotor").with_effect("body_drag:body")
    motion = ident.complete(mechanism, ROBOTS / "quadrotor" / "run.csv")
    values = ident.identify(mechanism, motion).effects
    factors = [x.value for e in values if e.effect.kind == "thrust" for x in e.parameters[:1]]
    np.testing.assert_allclose(factors, 1.1e-5, rtol=0.01)
