"""No cause is named with a value that no machine can have."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import ident
from ident.diagnosis.candidates import candidates_of
from ident.diagnosis.selection import can_be
from ident.effects import KINDS
from ident.fit.findings import beyond_range
from ident.information.blocks import Error
from identification import robot


@pytest.fixture(scope="module")
def arm():
    return robot("arm")


def known(arm, prior):
    """The arm with known bodies."""
    return SimpleNamespace(bodies=arm.bodies, prior=prior, unknown=(), lengths=arm.lengths)


def test_a_load_that_is_more_than_there_is(arm):
    payload = ident.effect("payload", "hand")
    mass = arm.prior[arm.bodies.columns("hand").start]
    dm = np.zeros(len(payload.unknowns))
    error = np.full(len(dm), 0.01)
    for size, possible in ((0.5, True), (-0.5, True), (-1.2, False)):
        dm[0] = size * mass
        assert can_be(known(arm, arm.prior), payload, dm, error) == possible
    massless = arm.prior.copy()
    massless[arm.bodies.columns("hand")] = 0.0
    dm[0] = 0.5
    assert not can_be(known(arm, massless), payload, dm, error)


@pytest.mark.parametrize("name", ["Im", "Fvm", "Fcm"])
def test_no_inertia_or_friction_of_a_coupling_is_negative(arm, name):
    coupling = ident.effect("coupling", "elbow,wrist")
    at = [parameter.name for parameter in coupling.unknowns].index(name)
    values = np.zeros(len(coupling.unknowns))
    values[at] = -0.1
    assert not can_be(arm, coupling, values, np.full(len(values), 0.01))
    assert can_be(arm, coupling, values, np.full(len(values), 0.2))


def test_a_machine_that_swings_freely_has_no_load_that_takes_its_forces_off(arm):
    """τ = 0 everywhere is explained by forces that take off all known ones."""
    motion = ident.complete(arm, arm.urdf.parent / "run.csv")
    free = {joint: Error(1.0, None, "N m") for joint in motion.independent}
    fit = replace(ident.identify(arm, motion), train=free, held_out={})
    kinds = {effect.kind for effect in candidates_of(fit)}
    assert not {"load_friction", "torque_gain"} & kinds
    assert {"viscous", "coulomb"} <= kinds


def test_a_cable_describes_and_is_no_cause_and_has_a_range(arm):
    assert KINDS["cable"].descriptive
    model = arm.with_effect("cable:elbow").with_effect("viscous")
    motion = ident.complete(model, arm.urdf.parent / "run.csv")
    whole = motion.experiments[0]
    y = whole.y[:, model.joint("elbow").index]
    part = replace(motion, experiments=(replace(whole, usable=y < np.median(y)),))
    assert not [*beyond_range(model, motion, part)]
    (finding,) = beyond_range(model, part, motion)
    assert finding.where == ("elbow",)
    assert finding.number == pytest.approx(0.5, abs=0.02)
