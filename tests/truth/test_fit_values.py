"""What a fit says of its parameters: base combinations, priors, names, standard errors."""

import sys
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

import ident
from helpers import ROBOTS, J, tree_urdf, write_mechanism
from ident import Log, Noise
from ident.fit.identify import estimate_of
from ident.information.chance import covariance
from ident.mechanism.parameters import regressor
from identification import close, motion_log, plant, robot


def tree(tmp_path, joints, seed=0):
    """A random tree and a log of q, v, a of all its joints."""
    mechanism = ident.load(write_mechanism(tmp_path, tree_urdf(joints, seed)))
    rng = np.random.default_rng(seed)
    t = np.arange(600) / 100
    columns = {}
    for joint in mechanism.joints:
        w, phase, size = rng.uniform(2, 7, 3), rng.uniform(0, 6, 3), rng.uniform(0.2, 0.6, 3)
        angle = np.outer(t, w) + phase
        columns[f"q.{joint.name}"] = np.sin(angle) @ size
        columns[f"v.{joint.name}"] = np.cos(angle) @ (size * w)
        columns[f"a.{joint.name}"] = -np.sin(angle) @ (size * w**2)
    return mechanism, Log.from_arrays("log.csv", t, columns)


TREES = {
    "three in series": [J("a", axis="1 0 0"), J("b", axis="0 1 0", parent="a"), J("c", parent="b")],
    "slide": [J("a", "prismatic", "0 0 1"), J("b", axis="0 1 0", parent="a")],
    "branches": [J("t"), J("l", axis="1 0 0", parent="t"), J("r", axis="0 1 1", parent="t")],
    "parallel axes": [J("a", axis="0 1 0"), J("b", axis="0 1 0", parent="a")],
    "fixed links": [J("a"), J("f", "fixed", None, "a"), J("b", axis="1 0 0", parent="f")],
}


@pytest.mark.parametrize("name", TREES)
def test_base_parameters_are_identities(name, tmp_path):
    """Γ_D = Γ_I K at states that the fit never saw: the expressions hold for every motion."""
    mechanism, log = tree(tmp_path, TREES[name], seed=len(name))
    fit = plant(mechanism, log).fit()
    base = fit.estimate.base
    assert base.rank < len(fit.columns)
    rng = np.random.default_rng(99)
    n, nv = 40, mechanism.model.nv
    gamma = regressor(mechanism.model, *(rng.normal(size=(n, nv)) * s for s in (2.0, 3.0, 5.0)))
    gamma = gamma[:, :, fit.columns.rigid].reshape(n * nv, -1)
    left = gamma[:, base.dependent] - gamma[:, base.independent] @ base.K
    assert np.abs(left).max() < 1e-6 * np.abs(gamma).max()


def test_the_arm_has_its_known_number_of_base_parameters():
    fit = plant(robot("arm"), motion_log("arm", 100.0)).fit()
    assert fit.rank == 22
    assert fit.estimate.base.rank == len(fit.base_parameters)


@pytest.mark.parametrize(("name", "rank"), [("four_bar", 8), ("five_bar", 7)])
def test_loops_have_their_known_number_of_base_parameters(name, rank):
    assert plant(robot(name), motion_log(name, 100.0)).fit().rank == rank


def test_a_base_parameter_is_its_expression():
    """The value stands for the sum that its name says, at the parameters that the fit reports."""
    fit = plant(robot("arm"), motion_log("arm", 100.0), noise=[Noise("tau", 0.01, True)]).fit()
    values = dict(zip(fit.mechanism.bodies.names, fit.dynamic_parameters, strict=True))
    for base in fit.base_parameters:
        words = base.name.split()
        total, sign, factor = values[words[0]], 1.0, 1.0
        for word in words[1:]:
            if word in "+-":
                sign, factor = (1.0 if word == "+" else -1.0), 1.0
            elif word in values:
                total += sign * factor * values[word]
            else:
                factor = float(word)
        assert base.value == pytest.approx(total, rel=1e-5, abs=1e-7)


def test_what_is_not_identified_stays_at_its_prior():
    fit = plant(robot("arm"), motion_log("arm", 100.0)).fit()
    x, prior, base = fit.estimate.solution.x, fit.columns.prior, fit.estimate.base
    np.testing.assert_array_equal(x[base.dependent], prior[base.dependent])
    by_name = {v.name: v for v in fit.parameters}
    for name in ("turret.m", "turret.Lxx", "forearm.m"):
        value = by_name[name]
        assert not value.identifiable
        assert value.stderr is None
        assert value.value == value.prior
    assert not by_name["upper_arm.mx"].identifiable  # it carries a base parameter with others
    assert by_name["hand.my"].identifiable


def test_parameters_are_listed_once_in_the_order_of_the_regressor():
    mechanism = robot("arm")
    fit = plant(mechanism, motion_log("arm", 100.0)).fit()
    assert [v.name for v in fit.parameters] == list(mechanism.bodies.names)
    some = replace(mechanism, unknown=tuple(n for n in mechanism.unknown if n.startswith("hand")))
    fit = plant(some, motion_log("arm", 100.0)).fit()
    assert [v.name.split(".")[0] for v in fit.parameters] == ["hand"] * 10


# --- about the centre of mass, or about the joint ----------------------------------------------


WORDS = ("m", "mx", "my", "mz", "Lxx", "Lxy", "Lyy", "Lxz", "Lyz", "Lzz")


def hand_only(known=()):
    """The arm of which only the hand is unknown, without `known`."""
    arm = robot("arm")
    unknown = tuple(f"hand.{w}" for w in WORDS if w not in known)
    return replace(arm, unknown=unknown)


def centroidal(pi):
    m, c = pi[0], pi[1:4] / pi[0]
    xx, xy, yy, xz, yz, zz = pi[4:]
    L = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return L - m * (c @ c * np.eye(3) - np.outer(c, c))


def test_centroidal_names_where_mass_and_centre_are_known():
    case = plant(hand_only(known=("m", "mx", "my", "mz")), motion_log("arm", 100.0))
    fit = case.fit()
    inertia = centroidal(np.array([case.values[f"hand.{w}"] for w in WORDS]))
    before = centroidal(case.mechanism.prior[30:40])
    found = {v.name: v for v in fit.parameters}
    assert list(found) == [f"hand.I{w}" for w in ("xx", "xy", "yy", "xz", "yz", "zz")]
    for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)):
        value = found["hand.I" + "xyz"[i] + "xyz"[j]]
        assert value.identifiable
        assert value.value == pytest.approx(inertia[i, j], abs=1e-9)
        assert value.prior == pytest.approx(before[i, j], abs=1e-12)


def test_centroidal_names_where_mass_and_centre_are_identified():
    case = plant(hand_only(), motion_log("arm", 100.0), noise=[Noise("tau", 0.01, True)])
    fit = case.fit()
    found = {v.name: v for v in fit.parameters}
    assert found["hand.m"].identifiable
    assert "hand.Ixx" in found
    assert "hand.Lxx" not in found
    pi = fit.dynamic_parameters[30:40]
    inertia = centroidal(pi)
    assert found["hand.Iyy"].value == pytest.approx(inertia[1, 1], abs=1e-12)
    assert found["hand.Ixy"].value == pytest.approx(inertia[0, 1], abs=1e-12)
    # the delta method against draws of the parameters themselves
    order = [fit.columns.names.index(f"hand.{w}") for w in WORDS]
    assert list(fit.estimate.base.independent) == sorted(order)
    draws = np.random.default_rng(0).multivariate_normal(
        fit.estimate.solution.beta, 1e-4 * fit.covariance, 20000
    )  # small, since the delta method is of first order
    place = {own: i for i, own in enumerate(fit.estimate.base.independent)}
    pis = draws[:, [place[i] for i in order]]
    Is = np.array([centroidal(pi) for pi in pis])
    for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)):
        value = found["hand.I" + "xyz"[i] + "xyz"[j]]
        assert value.stderr == pytest.approx(100 * Is[:, i, j].std(), rel=0.03)


def test_moments_about_the_joint_where_the_centre_is_not_identified():
    fit = plant(robot("arm"), motion_log("arm", 100.0)).fit()
    assert not any(".I" in v.name for v in fit.parameters)


# --- errors ------------------------------------------------------------------------------------


def test_tables_have_the_values_of_the_fit():
    mechanism = ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb")
    motion = ident.complete(mechanism, ROBOTS / "arm" / "run.csv")
    fit = ident.identify(mechanism, motion, validate=motion)
    errors = fit.error_table
    assert errors["error"].unique(maintain_order=True).to_list() == list(fit.errors)
    elbow = (pl.col("joint") == "elbow") & (pl.col("error") == "held out")
    row = errors.row(by_predicate=elbow, named=True)
    assert row["rms"] == fit.held_out["elbow"].rms
    assert row["noise"] == fit.noise["elbow"]
    values = {row["name"]: row for row in fit.parameter_table.to_dicts()}
    assert len(values) == len(fit.columns)
    assert values["coulomb.elbow.Fc"]["stderr"] == fit["coulomb.elbow.Fc"].stderr


def test_errors_scale_with_the_torque():
    """All torques threefold: all values and standard errors too."""
    mechanism = robot("five_bar").with_effect("viscous")
    case = plant(mechanism, motion_log("five_bar", 100.0), noise=[Noise("tau", 0.02, True)])
    large = {n: x * (3.0 if n.startswith("tau.") else 1.0) for n, x in case.log.columns.items()}
    one, other = case.fit(), replace(case, log=Log.from_arrays("log", case.log.t, large)).fit()
    for a, b in zip(one.base_parameters, other.base_parameters, strict=True):
        assert b.value == pytest.approx(3 * a.value, rel=1e-6)
        assert b.stderr == pytest.approx(3 * a.stderr, rel=1e-6)


def test_twice_the_noise_is_twice_the_standard_error():
    mechanism = robot("five_bar").with_effect("viscous")
    motion = motion_log("five_bar", 100.0)
    errors = [
        np.sqrt(np.diag(plant(mechanism, motion, noise=[Noise("tau", s)], seed=1).fit().covariance))
        for s in (0.02, 0.04)
    ]
    np.testing.assert_allclose(errors[1], 2 * errors[0], rtol=0.05)


def test_more_log_is_less_standard_error():
    mechanism = robot("five_bar").with_effect("viscous")
    short, long = (
        plant(mechanism, motion_log("five_bar", 100.0, s), noise=[Noise("tau", 0.02, True)]).fit()
        for s in (8.0, 32.0)
    )
    ratio = np.sqrt(np.diag(short.covariance) / np.diag(long.covariance))
    assert 1.4 < np.median(ratio) < 2.9  # 2, and a little more since few blocks are surer of less


def test_what_a_single_stretch_of_time_tells_has_a_standard_error():
    """A joint that moves in one block only: no block is left to disagree, but white noise is."""
    mechanism = robot("arm").with_effect("viscous")
    log = motion_log("arm", 100.0, 8.0)
    t = log.t
    u = np.clip((t - 3.0) / 0.4, 0, 1)  # the wrist turns once, from 3.0 s to 3.4 s
    bump = {
        "q": 1.5 * (u**3 * (10 - 15 * u + 6 * u**2)),
        "v": 1.5 / 0.4 * (30 * u**2 * (1 - u) ** 2),
        "a": 1.5 / 0.16 * (60 * u * (1 - u) * (1 - 2 * u)),
    }
    columns = dict(log.columns) | {f"{c}.wrist": x for c, x in bump.items()}
    case = plant(
        mechanism, Log.from_arrays("log", t, columns), noise=[Noise("tau.wrist", 0.01)], seed=2
    )
    fit = case.fit()
    value = next(v for e in fit.effects for v in e.parameters if v.name == "viscous.wrist.Fv")
    speed = np.linalg.norm(columns["v.wrist"])
    assert value.stderr > 0.3 * 0.01 / speed
    assert abs(value.value - case.values[value.name]) < 5 * value.stderr


def test_the_covariance_is_symmetric_and_positive():
    fit = plant(
        robot("arm").with_effect("coulomb"),
        motion_log("arm", 100.0),
        noise=[Noise("tau", 0.01, True)],
    ).fit()
    cov = covariance(fit.information, fit.estimate)
    np.testing.assert_allclose(cov, cov.T, rtol=1e-9)
    scale = np.sqrt(np.diag(cov))
    assert np.linalg.eigvalsh(cov / np.outer(scale, scale)).min() > -1e-9


@pytest.mark.parametrize("name", ["arm", "four_bar", "slider_crank"])
def test_nothing_unknown_is_the_model_as_it_is(name, tmp_path):
    mechanism = replace(robot(name), unknown=())
    motion = ident.complete(mechanism, plant(robot(name), motion_log(name, 100.0)).log)
    fit = ident.identify(mechanism, motion, validate=motion)
    assert fit.rank == len(fit.columns) == 0
    assert any("nothing is unknown" in note for note in fit.warnings)
    (prediction,) = fit.predict()
    for u, joint in enumerate(motion.independent):
        left = prediction.residual[prediction.usable & prediction.moving[:, u], u]
        assert fit.unfiltered[joint].rms == pytest.approx(np.sqrt(np.mean(left**2)))
        assert fit.train[joint].rms > 1e-4
        for errors in (fit.held_out, *fit.validation.values()):
            assert errors[joint].rms == pytest.approx(fit.train[joint].rms, rel=1e-12)
    fit.write(tmp_path)
    saved = ident.read_fit(tmp_path, mechanism)
    assert ident.compare(fit, saved).errors["fit 1"][joint].rms == pytest.approx(
        fit.train[joint].rms, rel=1e-6
    )


def test_nothing_unknown_with_a_time_basis():
    mechanism = replace(robot("four_bar"), unknown=(), multipliers=ident.Multipliers("cubic", 0.05))
    motion = ident.complete(mechanism, plant(robot("four_bar"), motion_log("four_bar")).log)
    fit = ident.identify(mechanism, motion)
    assert fit.rank == 0
    assert all(np.isfinite(error.rms) for error in fit.held_out.values())


def test_effects_alone_can_be_identified():
    mechanism = replace(robot("arm").with_effect("viscous").with_effect("coulomb"), unknown=())
    case = plant(mechanism, motion_log("arm", 100.0))
    fit = case.fit()
    assert fit.parameters == ()
    assert close(fit.estimate.solution.beta, case.base(fit), 1e-9)


def test_shapes_that_leave_their_bounds_one_after_the_other_are_all_held(monkeypatch):
    """A shape that is held may send another one out of its bounds."""
    mechanism = robot("arm").with_effect("stribeck:elbow").with_effect("stribeck:wrist")
    case = plant(mechanism, motion_log("arm", 100.0, 6.0), seed=1)
    fit = case.fit()
    first, second = (fit.columns.index[f"stribeck.{joint}.vs"] for joint in ("elbow", "wrist"))

    def beyond(problem, found):
        outside = np.zeros(len(problem.columns), dtype=bool)
        outside[first], outside[second] = True, found.fixed[first]
        return outside

    monkeypatch.setattr(sys.modules["ident.fit.identify"], "beyond_bounds", beyond)
    assert estimate_of(fit.problem).fixed[[first, second]].all()
