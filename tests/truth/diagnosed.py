"""Diagnoses of small planted logs, made once, for the tests of what is said and written of them."""

from __future__ import annotations

from functools import cache

import casadi as ca

import ident
from ident import Diagnosis, History, Noise
from identification import Planted, motion_log, plant, robot

NOISE = (Noise("tau", 0.02, relative=True), Noise("q", 1e-5))
FRICTION = {"viscous.elbow.Fv": 0.3, "coulomb.elbow.Fc": 0.6}


@cache
def planted(name: str = "arm") -> Planted:
    """A log of a robot with friction in its joints."""
    friction = ["viscous", "coulomb"] if name == "arm" else ["viscous:rocker"]
    mechanism = robot(name)
    for effect in friction:
        mechanism = mechanism.with_effect(effect)
    values = FRICTION if name == "arm" else {"viscous.rocker.Fv": 0.2}
    return plant(mechanism, motion_log(name, 100.0, 8.0), values, noise=NOISE, seed=3)


@cache
def clean() -> Diagnosis:
    """Of the model that made the log."""
    return ident.diagnose(planted().fit(cutoff="auto"))


@cache
def lacking() -> Diagnosis:
    """Of a model without the elbow's dry friction."""
    return _without("coulomb:elbow", planted())


@cache
def loop() -> Diagnosis:
    """Of a closed loop without its friction."""
    return _without("viscous:rocker", planted("four_bar"))


def _without(effect: str, case: Planted) -> Diagnosis:
    return ident.diagnose(case.fit(mechanism=case.mechanism.without(effect), cutoff="auto"))


@cache
def grown() -> History:
    """From the model without the elbow's dry friction."""
    case = planted()
    bare = case.mechanism.without("coulomb:elbow")
    return ident.grow(bare, ident.complete(bare, case.log))


@cache
def lawful() -> Diagnosis:
    """Of a model that lacks a torque which no effect of the library has."""
    odd = ident.user_effect("odd", lambda s: {"A": ca.sin(3 * s.q) * ca.sign(s.v)})(("elbow",))
    friction = planted().mechanism
    case = plant(friction + odd, motion_log("arm", 100.0, 8.0), {**FRICTION, "odd.elbow.A": 0.6},
                 noise=NOISE, seed=3)  # fmt: skip
    return ident.diagnose(case.fit(mechanism=friction, cutoff="auto"))
