"""A wrist whose position is logged with the wrong sign: light, so that its friction is most of it.

With its bodies free the model fits well, by dry friction that drives the joint: a diagnosis must
not take what is left for all that is wrong.
"""

import numpy as np
import pytest

import ident
from identification import motion_log, plant, robot


def test_a_diagnosis_names_the_sign_of_a_light_wrist():
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    values = {name: 0.3 for effect in mechanism.effects for name in effect.names}
    noise = (ident.Noise("tau", 0.01, relative=True), ident.Noise("q", 1e-5))
    log = plant(mechanism, motion_log("arm", seconds=12.0), values, noise=noise, seed=5).log
    columns = {
        name: -x if name in ("q.wrist", "v.wrist", "a.wrist") else x
        for name, x in log.columns.items()
    }
    turned = ident.Log.from_arrays("run.csv", log.t, columns)
    d = ident.diagnose(ident.identify(mechanism, ident.complete(mechanism, turned)))
    assert np.any([x.where == ("q.wrist",) or "wrist" in x.meaning for x in d.health.faults])
    assert "sign" in d.short


@pytest.mark.parametrize("wrong", ["q.wrist", "tau.wrist", "tau.elbow"])
def test_a_sign_is_named_where_it_is_wrong_in_a_joint_of_much_friction(wrong):
    """A turned torque makes the friction right, and leaves the small share of bodies there."""
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    names = [name for effect in mechanism.effects for name in effect.names]
    values = {name: 1.5 if "wrist" in name else 0.3 for name in names}
    noise = (ident.Noise("tau", 0.01, relative=True), ident.Noise("q", 5e-5))
    log = plant(mechanism, motion_log("arm", seconds=12.0), values, noise=noise, seed=5).log
    columns = {n: -x if n == wrong else x for n, x in log.columns.items() if n[0] not in "va"}
    turned = ident.Log.from_arrays("run.csv", log.t, columns)
    fit = ident.identify(robot("arm"), ident.complete(robot("arm"), turned))
    first = fit.health.faults[0]
    assert first.where == (wrong,)
    assert first.code == ("sign" if wrong.startswith("tau") else "position sign")
    assert f'"{wrong}" = {{ column = "{wrong}", scale = -1 }}' in first.remedy
    # what the log tells apart is not offered
    assert ", or turn" not in first.remedy
