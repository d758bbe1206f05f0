"""Bands of the motion of edited machines, against the motion of the edited true one."""

from dataclasses import replace

import numpy as np
import pytest

import ident
from ident.errors import MechanismError
from ident.export.band import band, covariance_of, inseparable
from ident.export.machine import machine_of
from ident.fit.files import Saved
from ident.simulate.inverse import Noise
from ident.simulate.replay import replay

TRUTH = {"viscous.elbow.Fv": 0.5, "coulomb.elbow.Fc": 0.9}
MOON = (0.0, 0.0, -1.62)


@pytest.fixture(scope="module")
def fitted(robots):
    """An arm whose bodies are known, but for forearm and hand, with friction in the elbow."""
    mechanism = ident.load(robots / "arm").with_calibration("exact")
    both = ("forearm.", "hand.")
    forearm = [name for name in mechanism.unknown if name.startswith(both)]
    mechanism = replace(mechanism, unknown=tuple(forearm))
    mechanism = mechanism.with_effect("viscous:elbow").with_effect("coulomb:elbow")
    log = ident.read_log(robots / "arm" / "run.csv")
    columns = {name: x[:1000] for name, x in log.columns.items() if name.startswith("q.")}
    reference = ident.Log.from_arrays("run", log.t[:1000], columns)
    noise = (Noise("tau", 0.01, relative=True), Noise("q", 2e-5))
    made, _ = ident.simulate(mechanism, reference, values=TRUTH, noise=noise)
    return ident.identify(mechanism, ident.complete(mechanism, made)), reference


def test_the_band_holds_the_motion_under_another_gravity(fitted):
    fit, reference = fitted
    true = machine_of(fit.mechanism, TRUTH, gravity=MOON)
    run = ident.integrate(
        true.mechanism, ident.PD(reference), duration=0.4, values=TRUTH, pi=true.point.pi
    )
    motion = ident.complete(true.mechanism, run.log)
    edited = machine_of(fit, gravity=MOON)
    widths = band(edited, covariance_of(fit), motion, {}, 0.4)
    saved = Saved("ident", edited.mechanism, edited.point)
    (ours,) = replay(saved, motion=motion, window=0.4).with_band("ident", widths).runs["ident"]
    assert min(ours.within.values()) > 0.6
    assert np.mean(list(ours.within.values())) > 0.85
    # and it is no wider than errors of one per cent of a torque can make it: 10 mrad in 0.4 s
    assert np.nanmax(np.where(np.isfinite(ours.band), ours.band, np.nan)) < 0.05


def test_an_edit_of_what_the_log_cannot_separate_is_named(fitted):
    fit, _ = fitted
    combined = next(b.name for b in fit.base_parameters if " " in b.name)
    name = next(word for word in combined.split() if word.startswith(("forearm.", "hand.")))
    assert inseparable(fit, {name: 0.1}, ()) == {name: [name]}
    assert inseparable(fit, {"viscous.elbow.Fv": 0.1}, ["coulomb:elbow"]) == {}


def test_gravity_is_three_numbers(fitted):
    fit, _ = fitted
    np.testing.assert_allclose(machine_of(fit, gravity=MOON).gravity, MOON)
    with pytest.raises(MechanismError, match="three numbers"):
        machine_of(fit, gravity=(0.0, -9.81))
