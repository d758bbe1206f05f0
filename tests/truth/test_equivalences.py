"""Ways of writing the same equations that must give the same numbers."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import null_space

import ident
from helpers import J, tree_urdf, write_mechanism
from ident import Log, Noise
from ident.equations.rows import Scene, full_rows
from ident.equations.unknowns import Columns
from ident.information.estimate import rank_revealing, solve
from ident.information.linear import Triangle
from identification import close, motion_log, plant, robot

NAMES = ["arm", "four_bar", "five_bar", "slider_crank", "pendulum"]
CLOSED = ["four_bar", "five_bar", "slider_crank", "pendulum"]
FRICTION = ("viscous", "coulomb")


@cache
def planted(name, *, noise=0.0, effects=(), seed=0, seconds=2.0):
    mechanism = robot(name)
    for kind in effects:
        mechanism = mechanism.with_effect(kind)
    noisy = [Noise("tau", noise, relative=True)] if noise else []
    return plant(mechanism, motion_log(name, 100.0, seconds), noise=noisy, seed=seed)


def assert_same(one, other, tolerance=1e-9):
    assert [v.name for v in one.base_parameters] == [v.name for v in other.base_parameters]
    a, b = (np.array([v.value for v in fit.base_parameters]) for fit in (one, other))
    norm = one.estimate.triangle.column_norms()[one.estimate.base.independent]
    assert np.abs((a - b) * norm).max() <= tolerance * np.abs(a * norm).max()
    assert list(one.train) == list(other.train)


# --- six coordinates a body --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("noise", "effects"), [(0.0, FRICTION), (0.01, ())], ids=["clean friction", "noisy bodies"]
)
@pytest.mark.parametrize("name", NAMES)
def test_absolute_coordinates(name, noise, effects):
    case = planted(name, noise=noise, effects=effects)
    tree, bodies = case.fit(), case.fit(mechanism=ident.absolute(case.mechanism))
    assert_same(tree, bodies)
    for joint, error in tree.train.items():
        scale = error.rms / error.relative
        assert bodies.train[joint].rms == pytest.approx(error.rms, rel=1e-6, abs=1e-9 * scale)
    if not noise:
        assert close(bodies.estimate.solution.beta, case.base(bodies), 1e-8)
    else:
        np.testing.assert_allclose(
            [v.stderr for v in bodies.base_parameters],
            [v.stderr for v in tree.base_parameters],
            rtol=1e-5,
        )


def test_absolute_multipliers_of_the_loop_are_the_same():
    case = planted("slider_crank")
    ((_, tree),) = case.fit().multipliers
    bodies = case.fit(mechanism=ident.absolute(case.mechanism))
    names = bodies.mechanism.kinematics.multipliers
    ((_, all_),) = bodies.multipliers
    ball = all_[:, [names.index(f"ball.{axis}") for axis in "xyz"]]
    np.testing.assert_allclose(ball, tree, atol=1e-8 * np.abs(tree).max())


# --- multipliers eliminated or projected out ---------------------------------------------------


def stacked(case):
    """A (n, nv, k), b (n, nv) and J (n, m, nv) of all samples."""
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    (e,) = motion.experiments
    scene = Scene.of(case.mechanism, Columns.of(case.mechanism), e)
    A, b, informed = full_rows(scene, slice(0, len(e)))
    assert informed.all()
    return A, b, case.mechanism.kinematics.closure_rows(e.q).rate


@pytest.mark.parametrize("noise", [0.0, 0.01], ids=["clean", "noisy"])
@pytest.mark.parametrize("name", CLOSED)
def test_free_multipliers_are_the_null_space_projection(name, noise):
    """Also of noisy logs, where both minimise the same part of the residual, Zᵀr with ZᵀZ = 1."""
    case = planted(name, noise=noise, effects=("viscous",))
    A, b, jacobian = stacked(case)
    Z = [null_space(each, rcond=1e-9) for each in jacobian]
    assert {z.shape[1] for z in Z} == {A.shape[1] - case.mechanism.rank}
    rows = np.concatenate([z.T @ a for z, a in zip(Z, A, strict=True)])
    right = np.concatenate([z.T @ y for z, y in zip(Z, b, strict=True)])
    left = Triangle.of(rows, right)
    base = rank_revealing(left, 1e-8)
    eliminated = solve(left, base)
    beta = np.linalg.lstsq(rows[:, base.independent], right, rcond=None)[0]
    assert close(eliminated.beta, beta, 1e-9)
    regrouped = np.linalg.lstsq(rows[:, base.independent], rows[:, base.dependent], rcond=None)[0]
    np.testing.assert_allclose(base.K, regrouped, atol=1e-7 * np.abs(regrouped).max(initial=1.0))
    # the rows Z of `identify` have W_u Z = 1 instead of ZᵀZ = 1: other weights of noise, same truth
    if not noise:
        fit = case.fit()
        np.testing.assert_array_equal(fit.estimate.base.independent, base.independent)
        keep = solve(left, base, prior=fit.columns.prior)
        assert close(fit.estimate.solution.beta, keep.beta, 1e-9)


@pytest.mark.parametrize("name", CLOSED)
def test_a_knot_for_every_sample_is_free_multipliers(name):
    case = planted(name)
    dense = replace(case.mechanism, multipliers=ident.Multipliers("linear", 0.01))
    banded, free = case.fit(mechanism=dense), case.fit()
    assert_same(banded, free, 1e-8)


# --- logs --------------------------------------------------------------------------------------


def part(log, piece, name):
    return Log.from_arrays(name, log.t[piece], {k: x[piece] for k, x in log.columns.items()})


def fit_of(mechanism, logs):
    return ident.identify(mechanism, ident.complete(mechanism, logs, cutoff=None))


@pytest.mark.parametrize("name", NAMES)
def test_an_experiment_may_be_cut_in_two(name):
    """With noise: the same rows. Dry friction is left out: what stands still is judged by log."""
    case = planted(name, noise=0.01, effects=("viscous",))
    n = len(case.log.t)
    halves = [part(case.log, slice(0, n // 3), "a"), part(case.log, slice(n // 3, n), "b")]
    whole, cut = fit_of(case.mechanism, case.log), fit_of(case.mechanism, halves)
    assert cut.rows == whole.rows == n
    assert_same(whole, cut)
    for joint, error in whole.train.items():  # of all rows: top speeds say which are in motion
        rms = cut.train[joint].with_standstill.rms
        assert rms == pytest.approx(error.with_standstill.rms, rel=1e-9)


@pytest.mark.parametrize("name", ["arm", "five_bar"])
def test_a_cut_with_dry_friction_has_the_same_truth(name):
    """Two periods cut into one each, so that both have the top speed that standstill goes by."""
    case = planted(name, effects=FRICTION, seconds=8.0)
    n = len(case.log.t)
    halves = [part(case.log, slice(0, n // 2), "a"), part(case.log, slice(n // 2, n), "b")]
    cut = fit_of(case.mechanism, halves)
    assert close(cut.estimate.solution.beta, case.base(cut), 1e-8)


@pytest.mark.parametrize("name", ["arm", "five_bar"])
def test_the_order_of_logs_does_not_matter(name):
    case = planted(name, noise=0.01, effects=FRICTION)
    n = len(case.log.t)
    logs = [part(case.log, slice(i * n // 3, (i + 1) * n // 3), f"log {i}") for i in range(3)]
    one, other = fit_of(case.mechanism, logs), fit_of(case.mechanism, logs[::-1])
    assert_same(one, other)
    np.testing.assert_allclose(
        np.sqrt(np.diag(one.covariance)), np.sqrt(np.diag(other.covariance)), rtol=1e-6
    )


@pytest.mark.parametrize("name", ["arm", "five_bar", "four_bar"])
def test_the_same_log_twice_gives_the_same_values(name):
    case = planted(name, noise=0.01)
    assert_same(fit_of(case.mechanism, case.log), fit_of(case.mechanism, [case.log, case.log]))


# --- known or unknown --------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["arm", "five_bar", "four_bar"])
def test_a_known_parameter_on_the_right_hand_side(name):
    """Known at its true value or unknown: the others are the same. What stands alone moves over."""
    case = planted(name, effects=("viscous",))
    all_unknown = case.fit()
    alone = [v.name for v in all_unknown.parameters if v.identifiable and v.name in case.values]
    moved = alone[:2]
    assert moved
    known = replace(
        case.mechanism, unknown=tuple(n for n in case.mechanism.unknown if n not in moved)
    )
    prior = known.prior.copy()
    for name_ in moved:
        prior[known.bodies.names.index(name_)] = case.values[name_]
    known.__dict__["prior"] = prior  # the cached property: what the URDF would say
    fewer = case.fit(mechanism=known)
    assert fewer.rank == all_unknown.rank - len(moved)
    values = {v.name: v.value for v in all_unknown.base_parameters}
    found = {v.name: v.value for v in fewer.base_parameters}
    assert set(found) == set(values) - set(moved)
    scale = max(map(abs, values.values()))
    for name_, value in found.items():
        assert value == pytest.approx(values[name_], abs=1e-9 * scale)


@pytest.mark.parametrize("name", ["arm", "five_bar"])
def test_a_known_effect_on_the_right_hand_side(name):
    case = planted(name, effects=FRICTION)
    joint = case.mechanism.driven[0]
    known = robot(name)
    for effect in case.mechanism.effects:
        given = {}
        if effect.joints == (joint,):
            given = {
                u.name: case.values[n] for u, n in zip(effect.unknowns, effect.names, strict=True)
            }
        known = known + ident.effect(effect.kind, effect.joints, given)
    fit = case.fit(mechanism=known)
    assert close(fit.estimate.solution.beta, case.base(fit), 1e-8)
    for each in fit.effects:
        for value in each.parameters:
            assert value.value == pytest.approx(case.values[value.name], rel=1e-7)
            assert (value.stderr == 0.0) == (each.effect.joints == (joint,))


# --- names of joints and columns ---------------------------------------------------------------


def test_the_order_of_joints_does_not_matter(tmp_path):
    """A branching tree written in two orders: Pinocchio sorts its joints by name."""
    joints = [J("t"), J("left", axis="1 0 0", parent="t"), J("right", axis="0 1 0", parent="t")]
    urdf = tree_urdf(joints, seed=5)
    other = urdf.replace("left", "zulu")  # comes behind `right` instead of before it
    rng = np.random.default_rng(0)
    t = np.arange(400) / 100
    w, phase = rng.uniform(2, 6, (3, 2)), rng.uniform(0, 6, (3, 2))
    angle = w[..., None] * t + phase[..., None]
    w = w[..., None]
    q, v, a = np.sin(angle).sum(1), (w * np.cos(angle)).sum(1), -(w**2 * np.sin(angle)).sum(1)
    fits = []
    for text, names in ((urdf, ["t", "left", "right"]), (other, ["t", "zulu", "right"])):
        mechanism = ident.load(write_mechanism(tmp_path / names[1], text)).with_effect("viscous")
        columns = {
            f"{c}.{n}": x[i] for c, x in (("q", q), ("v", v), ("a", a)) for i, n in enumerate(names)
        }
        values = {f"viscous.{n}.Fv": 0.1 * (i + 1) for i, n in enumerate(names)}
        log, _ = ident.simulate(mechanism, Log.from_arrays("log", t, columns), values=values)
        fits.append(fit_of(mechanism, log))
    assert fits[0].motion.independent != tuple(
        n.replace("zulu", "left") for n in fits[1].motion.independent
    )
    assert fits[0].rank == fits[1].rank
    for each in fits[0].effects:
        name = each.parameters[0].name
        same = next(
            p
            for e in fits[1].effects
            for p in e.parameters
            if p.name.replace("zulu", "left") == name
        )
        assert same.value == pytest.approx(each.parameters[0].value, rel=1e-9)
    x, y = ({n.replace("zulu", "left"): v.value for v in f.parameters if v.identifiable
             for n in [v.name]} for f in fits)  # fmt: skip
    common = set(x) & set(y)
    assert len(common) > 5
    for name in common:
        assert x[name] == pytest.approx(y[name], rel=1e-7, abs=1e-9)


def test_the_order_of_columns_does_not_matter():
    case = planted("arm", noise=0.01, effects=FRICTION)
    shuffled = Log.from_arrays("log", case.log.t, dict(reversed(case.log.columns.items())))
    assert_same(fit_of(case.mechanism, case.log), fit_of(case.mechanism, shuffled))
