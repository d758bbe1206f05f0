"""Rungs of a ladder that are announced, and the fit that ends it."""

import ident
from helpers import ROBOTS
from ident.diagnosis.grow import _contradicted
from ident.information.blocks import Error


def test_a_fit_that_leaves_more_contradicts_what_was_announced():
    announced = {"yaw": Error(0.2, 0.02, "N m"), "lift": Error(1.0, None, "N")}
    for rms, expected in ((0.1, False), (0.201, False), (0.5, True)):
        fitted = {"yaw": Error(rms, rms / 10, "N m"), "lift": Error(2.0, None, "N")}
        assert _contradicted(announced, fitted, 0.003) is expected


def test_a_spring_with_preload_leaves_no_offset_beside_it():
    arm, run = ident.load(ROBOTS / "arm"), ident.read_log(ROBOTS / "arm" / "run.csv")
    true = arm.with_effect("viscous").with_effect("coulomb").with_effect("spring:elbow")
    values = {name: 0.5 for effect in true.effects for name in effect.names}
    values |= {"spring.elbow.k": 6.0, "spring.elbow.b": -14.0}
    noise = [ident.Noise("tau", 0.003, True), ident.Noise("q", 1e-4)]
    log, _ = ident.simulate(true, run, values=values, noise=noise, seed=1, columns=["q", "tau"])
    grown = ident.grow(arm, ident.complete(arm, log))
    found = {effect.label for effect in grown.added if "elbow" in effect.joints}
    assert found == {"viscous:elbow", "coulomb:elbow", "spring:elbow"}
