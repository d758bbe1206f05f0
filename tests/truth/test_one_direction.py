"""A joint that turns one way shows no difference between its directions."""

import numpy as np

import ident
from helpers import ROBOTS
from ident.diagnosis.candidates import candidates_of
from identification import motion_log, plant, robot


def labels(fit):
    return {effect.label for effect in candidates_of(fit)}


def test_friction_of_one_direction_is_dry_and_viscous():
    """The shipped log of a crank that turns and turns, with the friction of its README."""
    mechanism = ident.load(ROBOTS / "four_bar")
    motion = ident.complete(mechanism, ROBOTS / "four_bar" / "run.csv")
    assert "direction_friction:crank" not in labels(ident.identify(mechanism, motion))
    history = ident.grow(mechanism, motion)
    assert {effect.label for effect in history.added} == {"coulomb:crank", "viscous:crank"}
    fit = history.steps[-1].fit
    for name, value in (("coulomb.crank.Fc", 0.12), ("viscous.crank.Fv", 0.02)):
        assert abs(fit[name].value - value) < 3 * fit[name].stderr


def test_it_is_sought_where_a_joint_moves_both_ways():
    mechanism = robot("arm")
    log = plant(mechanism, motion_log("arm", 100.0, 4.0), seed=1).log
    sought = labels(ident.identify(mechanism, ident.complete(mechanism, log)))
    assert {"direction_friction:elbow", "direction_friction:wrist"} <= sought
    one_way = log.columns | {"q.wrist": 0.6 * log.t - 1.2 + 0.1 * np.sin(4.0 * log.t)}
    again = ident.Log.from_arrays(
        "one_way", log.t, {n: x for n, x in one_way.items() if n[0] in "qt"}
    )
    sought = labels(ident.identify(mechanism, ident.complete(mechanism, again)))
    assert "direction_friction:elbow" in sought
    assert "direction_friction:wrist" not in sought
