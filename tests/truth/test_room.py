"""What is kept of a log saves time: no result depends on how much room there is for it."""

from dataclasses import replace

import numpy as np
import pytest

from helpers import ROBOTS
from ident.fit import identify
from ident.log import Log
from ident.mechanism import load
from ident.motion import complete
from ident.motion.state import Store
from identification import motion_log, plant, robot


@pytest.mark.parametrize(
    ("name", "effects"),
    [
        ("arm", ("viscous", "load_friction", "stribeck")),
        ("arm", ("viscous", "elasticity:elbow")),
        ("four_bar", ("viscous", "load_friction")),
    ],
)
def test_a_fit_is_the_same_with_and_without_room(name, effects, monkeypatch):
    mechanism = robot(name)
    for effect in effects:
        mechanism = mechanism.with_effect(effect)
    log = plant(mechanism, motion_log(name, 100.0, 4.0), seed=1).log

    def numbers():
        fit = identify(mechanism, complete(mechanism, log))
        values = [v for e in fit.effects for v in e.parameters] + [*fit.parameters]
        pairs = [(v.value, v.stderr or 0.0) for v in values]
        return np.array(pairs), fit.estimate.x, fit.covariance

    kept = numbers()
    monkeypatch.setattr(Store, "LIMIT", 0)
    for one, other in zip(kept, numbers(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_is_kept_in_any_case_is_bounded(monkeypatch):
    """Rows of Γ for loads that a search asks for: the least of what a state keeps, and most."""
    mechanism = robot("arm").with_effect("viscous").with_effect("load_friction")
    log = plant(mechanism, motion_log("arm", 100.0, 4.0), seed=1).log
    monkeypatch.setattr(Store, "LIMIT", 0)
    most = []
    for limit in (Store.OF_STATE, 100_000):
        monkeypatch.setattr(Store, "OF_STATE", limit)
        motion = complete(mechanism, log)
        identify(mechanism, motion, estimator="least-squares")
        (e,) = motion.experiments
        most.append(sum(x.nbytes for _, arrays in e.store._arrays.values() for x in arrays))
        assert most[-1] <= limit
    assert most[0] > most[1] > 0


def test_the_load_of_a_late_torque_is_not_interpolated_between_coarse_samples(monkeypatch):
    """Where tangents do not fit, forces are those of the motion as it was."""
    mechanism, effects = robot("arm"), ("coulomb", "torque_gain:elbow", "payload:hand")
    for effect in effects:
        mechanism = mechanism.with_effect(effect)
    model = replace(mechanism, calibration=load(ROBOTS / "arm").calibration)
    log = plant(mechanism, motion_log("arm", 50.0, 4.0, 2.0), seed=1).log
    random = np.random.default_rng(3)
    columns = {
        name: x + 0.01 * np.std(x) * random.standard_normal(len(x)) * name.startswith("tau")
        for name, x in log.columns.items()
    }
    noisy = Log.from_arrays("noisy", log.t, columns)

    def numbers():
        fit = identify(model, complete(model, noisy))
        values = [v for e in fit.effects for v in e.parameters] + [*fit.parameters]
        return np.array([(v.value, v.stderr or 0.0) for v in values])

    monkeypatch.setattr("ident.equations.terms.MOST_BYTES", 0)
    found = numbers()
    monkeypatch.setattr("ident.equations.rows.series_step", lambda *_: 1)
    np.testing.assert_array_equal(found, numbers())
    monkeypatch.setattr("ident.equations.rows.series_step", lambda *_: 2)  # as it would be
    assert not np.allclose(numbers(), found, rtol=0.01, atol=1e-9)
