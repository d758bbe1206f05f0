"""Planted parameters are found again; effects one by one are in test_recovered."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import ident
from helpers import ROBOTS
from ident.fit.prediction import predict
from identification import close, motion_log, plant, robot

NAMES = ["arm", "four_bar", "five_bar", "slider_crank", "pendulum"]
GROWN = ("viscous", "coulomb", "spring", "rotor_inertia", "torque_offset")


# --- free of noise -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_planted_parameters_are_found(name):
    """Inertias 30 % off the URDF's, and friction, spring, offset and rotor on every drive."""
    mechanism = robot(name)
    for kind in GROWN:
        mechanism = mechanism.with_effect(kind)
    case = plant(mechanism, motion_log(name, 100.0), seed=3)
    fit = case.fit()
    assert close(fit.estimate.solution.beta, case.base(fit), 1e-6)
    assert max(error.relative for error in fit.train.values()) < 1e-8


@pytest.mark.parametrize("name", NAMES)
def test_a_fit_predicts_another_motion(name):
    """RNEA of the planted tree, its closures' forces taken out: what the fit must say of it."""
    mechanism = robot(name)
    case = plant(mechanism, motion_log(name, 100.0), seed=4)
    other = plant(mechanism, smaller(motion_log(name, 100.0, 3.0, 3.0), 0.6), seed=4)
    assert other.values == case.values
    fit = case.fit()
    (said,) = fit.predict(ident.complete(mechanism, other.log, cutoff=None, torques=False))
    motion = ident.complete(mechanism, other.log, cutoff=None)
    (e,) = motion.experiments
    pi = np.array([case.values[n] for n in mechanism.bodies.names])
    model = mechanism.model.copy()
    for i in range(1, model.njoints):
        body = pi[10 * (i - 1) : 10 * i]
        model.inertias[i] = (
            pin.Inertia.FromDynamicParameters(body) if body[0] else pin.Inertia.Zero()
        )
    data = model.createData()
    free = np.array([pin.rnea(model, data, *state) for state in zip(e.q, e.v, e.a, strict=True)])
    if mechanism.closures:  # along the directions in which the loop moves, rates of u being 1
        free = np.einsum("nij,ni->nj", e.pinv[:, :, -len(motion.independent) :], free)
    else:
        free = free[:, [mechanism.joint(name).index for name in said.joints]]
    assert close(said.predicted, free, 1e-6)


def smaller(log, share):
    """The motion with all oscillations smaller: other states, other leverages."""
    columns = {}
    for name, x in log.columns.items():
        columns[name] = x[0] + share * (x - x[0]) if name.startswith("q.") else share * x
    return ident.Log.from_arrays("other.csv", log.t, columns)


def test_an_effect_that_a_rigid_parameter_replaces_is_said():
    """A rotor on a first vertical joint is the same column as the link's Lzz."""
    mechanism = robot("arm") + ident.effect("rotor_inertia", "yaw")
    case = plant(mechanism, motion_log("arm", 100.0), seed=6)
    fit = case.fit()
    (value,) = fit.effects[0].parameters
    assert not value.identifiable
    assert value.stderr is None
    assert value.value == 0.0
    assert any("rotor_inertia.yaw.Ia cannot be identified" in said for said in fit.warnings)
    assert close(fit.estimate.solution.beta, case.base(fit), 1e-6)


# --- the logs that come with the robots (1 % torque noise) -------------------------------------


SHIPPED = {
    "four_bar": ({"viscous.crank.Fv": 0.02, "coulomb.crank.Fc": 0.12},
                 {"rocker_link.m": 0.908, "rocker_link.mx": 0.0803, "rocker_link.Lyy": 0.0125}),
    "five_bar": ({"viscous.left.Fv": 0.03, "viscous.right.Fv": 0.02,
                  "coulomb.left.Fc": 0.06, "coulomb.right.Fc": 0.04}, {}),
    "arm": ({"viscous.yaw.Fv": 1.2, "viscous.shoulder.Fv": 1.5, "viscous.elbow.Fv": 0.5,
             "viscous.wrist.Fv": 0.02, "coulomb.yaw.Fc": 2.0, "coulomb.shoulder.Fc": 2.5,
             "coulomb.elbow.Fc": 0.9, "coulomb.wrist.Fc": 0.04},
            {"hand.m": 1.2638, "hand.mx": 0.1234, "hand.Lyy": 0.0158, "hand.Lzz": 0.0160}),
}  # fmt: skip


@pytest.fixture(scope="module", params=SHIPPED)
def shipped(request):
    mechanism = ident.load(ROBOTS / request.param).with_effect("viscous").with_effect("coulomb")
    fit = ident.identify(mechanism, ident.complete(mechanism, ROBOTS / request.param / "run.csv"))
    return fit, *SHIPPED[request.param]


def test_shipped_logs_show_what_their_readme_says(shipped):
    fit, effects, _ = shipped
    found = {v.name: v for each in fit.effects for v in each.parameters}
    assert set(found) == set(effects)
    for name, true in effects.items():
        assert found[name].value == pytest.approx(true, rel=0.03)
        assert abs(found[name].value - true) < 4 * found[name].stderr
    assert max(error.relative for error in fit.train.values()) < 0.01


def test_shipped_logs_show_the_planted_bodies(shipped):
    fit, effects, bodies = shipped
    names = fit.mechanism.bodies.names
    true = dict(zip(names, fit.mechanism.prior, strict=True)) | bodies | effects
    x = np.array([true[name] for name in fit.columns.names])
    base = fit.estimate.base
    beta = x[base.independent] + base.K @ x[base.dependent]
    stderr = np.sqrt(np.diag(fit.covariance))
    off = (fit.estimate.solution.beta - beta) / stderr
    # the README rounds planted values to 4 digits
    rounding = 5e-5 * np.abs(beta) / stderr
    assert (np.abs(off) < 4 + rounding).all(), dict(
        zip((v.name for v in fit.base_parameters), off.round(2), strict=True)
    )
    large = np.abs(beta) > 0.1 * np.abs(beta).max()
    np.testing.assert_allclose(fit.estimate.solution.beta[large], beta[large], rtol=0.03)


def test_shipped_priors_alone_do_not_explain_the_log(shipped):
    """The planted tool or rocker matters: the URDF's bodies with the fitted friction do worse."""
    fit, _, bodies = shipped
    if not bodies:
        return
    (said,) = predict(fit.mechanism, fit.motion, replace(fit.point, pi=fit.mechanism.prior))
    (own,) = fit.predict()
    worst = np.linalg.norm(said.residual, axis=0) / np.linalg.norm(own.residual, axis=0)
    assert worst.max() > 3


def test_unknown_links_only(robots):
    """`unknown` limits what moves: the tool in the hand alone is found, all else known. The log is
    simulated, so that its sensors are exact.
    """
    arm = ident.load(robots / "arm").with_effect("viscous").with_effect("coulomb")
    arm = arm.with_calibration("exact")
    arm = replace(arm, unknown=tuple(n for n in arm.unknown if n.startswith("hand.")))
    fit = ident.identify(arm, ident.complete(arm, robots / "arm" / "run.csv"))
    found = {v.name: v for v in fit.parameters}
    for name, true in SHIPPED["arm"][1].items():
        if name in found and found[name].identifiable:
            assert abs(found[name].value - true) < 4 * found[name].stderr + 1e-4
    assert found["hand.m"].value == pytest.approx(1.2638, rel=0.02)
    assert found["hand.m"].stderr < 0.03


def test_dry_friction_does_not_depend_on_the_speed_of_standstill():
    """Torques with sign(v) itself; a ramp would bias Fc by up to 4e-3."""
    mechanism, motion = robot("arm"), motion_log("arm", 500.0, 20.0)
    rigid = plant(mechanism.with_effect("viscous"), motion)
    level = {name: 0.3 for name in mechanism.driven}
    columns = dict(rigid.log.columns)
    for name, Fc in level.items():
        columns[f"tau.{name}"] = columns[f"tau.{name}"] + Fc * np.sign(columns[f"v.{name}"])
    log = ident.Log.from_arrays("sign.csv", rigid.log.t, columns)
    both = mechanism.with_effect("viscous").with_effect("coulomb")
    motion = ident.complete(both, log, cutoff=8.0)
    e = motion.experiments[0]
    for times in (0.3, 1.0, 3.0):
        other = replace(motion, experiments=(replace(e, still=times * e.still),))
        fit = ident.identify(both, other, estimator="least-squares")
        for name, Fc in level.items():
            assert fit[f"coulomb.{name}.Fc"].value == pytest.approx(Fc, rel=1.5e-3)
