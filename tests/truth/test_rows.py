"""The reduced rows: consistent with Pinocchio's dynamics and with the multipliers projected out."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from streaming import raw_rows

from helpers import Truth, series
from ident.effects import create
from ident.equations.filter import CHUNK, Decimator
from ident.equations.rows import Scene, row_supports, rows
from ident.equations.table import Table
from ident.equations.terms import Samples
from ident.equations.unknowns import Columns, Point
from ident.log import Log
from ident.mechanism import load
from ident.mechanism.load import absolute
from ident.mechanism.parameters import regressor
from ident.motion import complete
from ident.motion.state import Store

NAMES = ["slider_crank", "four_bar", "five_bar", "arm"]


def logged(name, robots, rate=100.0):
    """A log whose torques are those of the URDF's own bodies, by Pinocchio."""
    truth, mechanism = Truth(name), load(robots / name)
    t, *driven = series(name, rate=rate)
    q, v, a = truth.complete(t, *driven)
    n = len(t)
    tau = np.zeros((n, truth.model.nv))
    active = [truth.index[joint] for joint in mechanism.driven]
    rest = [i for i in range(truth.model.nv) if i not in active]
    for k in range(n):
        state = [np.array([x[j][k] for j in truth.index]) for x in (q, v, a)]
        need = pin.rnea(truth.model, truth.data, *state)
        _, J, _ = truth.rows(state[0], state[1])
        # passive rows: need = Jᵀλ there, by the least norm where closures are redundant
        lam = np.linalg.lstsq(J[:, rest].T, need[rest], rcond=1e-9)[0] if rest else np.zeros(len(J))
        tau[k] = need - J.T @ lam
        assert np.abs(tau[k, rest]).max(initial=0) < 1e-9
    columns = {f"{p}.{j}": x[j] for p, x in zip("qva", (q, v, a), strict=True) for j in driven[0]}
    columns |= {f"tau.{j}": tau[:, truth.index[j]] for j in mechanism.driven}
    return mechanism, Log.from_arrays("run.csv", t, columns)


@pytest.mark.parametrize("form", [lambda m: m, absolute], ids=["joint", "absolute"])
@pytest.mark.parametrize("name", NAMES)
def test_rows_hold_for_the_true_parameters(name, form, robots):
    mechanism, log = logged(name, robots)
    mechanism = form(mechanism)
    motion = complete(mechanism, log)
    columns = Columns.of(mechanism)
    (e,) = motion.experiments
    found = raw_rows(Scene.of(mechanism, columns, e), slice(0, len(e)))
    scale = np.abs(found.tau).max(axis=0)
    off = np.einsum("ndk,k->nd", found.A, columns.prior) - found.b
    assert np.abs(off / scale).max() < 1e-8
    for u, columns_of_row in enumerate(row_supports(mechanism, columns, e)):
        outside = np.setdiff1d(np.arange(len(columns)), columns_of_row)
        assert np.all(found.A[:, u, outside] == 0)


def test_rows_of_gears_have_the_columns_of_what_moves_with_them(robots, tmp_path):
    # a mirror of the last joint, on the base: it has nothing to do with the joints before
    names = ("shoulder", "upper", "elbow")
    bodies = '<robot name="geared"><link name="base"/>'
    inertial = (
        '<inertial><origin xyz="0.1 0.02 0"/><mass value="1"/>'
        '<inertia ixx="0.01" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    sits_on = {"shoulder": "base", "upper": "shoulder_link", "elbow": "upper_link"}
    sits_on["mirror"] = "base"
    for name, on in sits_on.items():
        xyz = "0 0 1" if name == "shoulder" else "0 1 0"
        bodies += (
            f'<link name="{name}_link">{inertial}</link><joint name="{name}" type="revolute">'
            f'<parent link="{on}"/><child link="{name}_link"/><origin xyz="0.3 0 0"/>'
            f'<axis xyz="{xyz}"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
        )
    (tmp_path / "geared.urdf").write_text(f"{bodies}</robot>")
    (tmp_path / "mechanism.toml").write_text(
        'urdf = "geared.urdf"\n[joints]\npassive = ["mirror"]\n[[closure]]\nname = "gear"\n'
        'kind = "linear"\njoints = ["mirror", "elbow"]\nratios = [1, 2]\n'
    )
    mechanism = load(tmp_path) + create("viscous", "mirror") + create("viscous", "upper")
    t = np.linspace(0, 4, 801)
    columns = {f"q.{name}": np.sin((1 + 0.3 * i) * t + i) for i, name in enumerate(names)}
    columns |= {f"tau.{name}": np.cos(t) for name in names}
    motion = complete(mechanism, Log.from_arrays("run.csv", t, columns))
    unknowns = Columns.of(mechanism)
    (e,) = motion.experiments
    A = raw_rows(Scene.of(mechanism, unknowns, e), slice(0, len(e))).A
    supports = row_supports(mechanism, unknowns, e)
    for u, name in enumerate(motion.independent):
        present = {unknowns.names[i] for i in supports[u]}
        assert not A[:, u, np.setdiff1d(np.arange(len(unknowns)), supports[u])].any()
        assert ("mirror_link.Lyy" in present) == (name == "elbow")
        assert ("viscous.mirror.Fv" in present) == (name == "elbow")
        assert ("viscous.upper.Fv" in present) == (name == "upper")
        assert "elbow_link.Lyy" in present
    # levers of gears are the same at all samples: torques are filtered by joint, Γ has no row more
    table, bare = (
        Table.of(model, Columns.of(model), motion, Point.prior(model))
        for model in (mechanism, load(tmp_path))
    )
    for effect, places in unknowns.effects:
        C, felt = bare.effect_columns(effect, [{}])
        dense = np.zeros((*bare.b.shape, C.shape[2]))
        dense[:, felt] = C
        np.testing.assert_allclose(dense, table.A[:, :, places], atol=1e-12)
    Z, q, v, a = e.pinv[0][:, -3:], *(np.tile(x, (2, 1)) for x in (e.q, e.v, e.a))
    for n in (len(e), len(q)):  # fewer than pay for passes over all samples, and more
        gamma = regressor(mechanism.model, q[:n], v[:n], a[:n])
        reduced = regressor(mechanism.model, q[:n], v[:n], a[:n], Z)
        np.testing.assert_allclose(reduced, Z.T @ gamma, atol=1e-12)
    shifted = e.q + 0.1
    off = mechanism.kinematics.closure_values(shifted)[:, 0]
    mirror, elbow = (mechanism.joint(name).index for name in ("mirror", "elbow"))
    np.testing.assert_allclose(off, shifted[:, mirror] + 2 * shifted[:, elbow], atol=1e-12)


@pytest.mark.parametrize("joint", ["crank", "coupler", "closure.pin"])
def test_an_effects_torque_works_through_its_leverage(joint, robots):
    # power of a viscous torque at any joint of the loop: Σ τ_u ẏ_u = Fv ẏ_joint²
    mechanism, log = logged("four_bar", robots)
    mechanism = mechanism + create("viscous", joint)
    motion = complete(mechanism, log)
    assert motion.independent == ("crank",)
    columns = Columns.of(mechanism)
    (e,) = motion.experiments
    found = raw_rows(Scene.of(mechanism, columns, e), slice(0, len(e)))
    rate = e.yd[:, mechanism.joint_index[joint]]
    crank = e.yd[:, mechanism.joint_index["crank"]]
    column = found.A[:, 0, columns.index[f"viscous.{joint}.Fv"]]
    np.testing.assert_allclose(column * crank, rate**2, atol=1e-9)


def test_known_values_move_to_the_right(robots):
    mechanism, log = logged("four_bar", robots)
    motion = complete(mechanism, log)
    (e,) = motion.experiments
    part = slice(0, len(e))
    free = mechanism + create("spring", "rocker")
    known = mechanism + create("spring", "rocker", {"k": 3.0, "b": -0.5})
    left = raw_rows(Scene.of(free, Columns.of(free), e), part)
    right = raw_rows(Scene.of(known, Columns.of(known), e), part)
    np.testing.assert_allclose(
        left.b - left.A[:, :, -2:] @ np.array([3.0, -0.5]), right.b, atol=1e-12
    )


def test_filtered_rows_are_the_raw_rows_filtered(robots):
    mechanism, log = logged("five_bar", robots)
    columns = Columns.of(mechanism)
    plain = complete(mechanism, log, cutoff=None)
    cut = complete(mechanism, log, cutoff=8.0)
    (raw,) = rows(Scene.of(mechanism, columns, plain.experiments[0]), None)
    (found,) = rows(Scene.of(mechanism, columns, cut.experiments[0]), 8.0)
    from ident.equations.filter import Decimator

    decimator = Decimator.of(8.0, cut.experiments[0].rate)
    smooth = np.apply_along_axis(np.convolve, 0, raw.A, decimator.taps, "valid")
    np.testing.assert_allclose(found.A, smooth[found.sample - decimator.half], atol=1e-10)
    np.testing.assert_array_equal(found.t, raw.t[found.sample])


def test_standstill_does_not_inform_dry_friction(robots):
    mechanism = load(robots / "arm") + create("coulomb", "elbow")
    t, q, v, a = series("arm", rate=100.0)
    stop = (t > 1) & (t < 2)
    for x in (q, v, a):  # the elbow is held for a second
        x["elbow"] = np.where(stop, 0.5 if x is q else 0.0, x["elbow"])
    columns = {f"{p}.{j}": x[j] for p, x in zip("qva", (q, v, a), strict=True) for j in q}
    log = Log.from_arrays("run.csv", t, columns | {f"tau.{j}": t for j in q})
    motion = complete(mechanism, log, cutoff=None)
    (found,) = rows(Scene.of(mechanism, Columns.of(mechanism), motion.experiments[0]), None)
    elbow = [j.name for j in mechanism.joints].index("elbow")
    assert not found.informed[stop, elbow].any()
    assert found.informed[~stop, elbow].mean() > 0.9


@pytest.mark.parametrize("form", [lambda m: m, absolute], ids=["joint", "absolute"])
@pytest.mark.parametrize("name", ["arm", "four_bar"])
def test_reduced_terms_are_the_projected_generalised_terms(name, form, robots):
    """Leverages on one side, W of the joints and Zᵀ on the other."""
    mechanism, log = logged(name, robots)
    for joint in mechanism.joints:
        mechanism = mechanism + create("viscous", joint.name)
    mechanism = form(mechanism + create("spring", mechanism.driven[0], {"k": 3.0}))
    (e,) = complete(mechanism, log).experiments
    scene, part = Scene.of(mechanism, Columns.of(mechanism), e), slice(10, 60)
    whole, left = scene.terms(part, full=True), scene.terms(part)
    u = scene.samples.reduced(part)
    for one, other in ((whole.A, left.A), (whole.b, left.b), (whole.tau, left.tau)):
        np.testing.assert_allclose(u.reduce(one), other, atol=1e-9 * np.abs(other).max())


@pytest.mark.parametrize("cutoff", [None, 6.0])
@pytest.mark.parametrize("name", ["arm", "slider_crank"])
def test_rows_are_the_same_in_pieces_of_any_size(name, cutoff, robots, monkeypatch):
    mechanism, log = logged(name, robots)
    mechanism = mechanism.with_effect("coulomb")
    (e,) = complete(mechanism, log, cutoff=cutoff).experiments
    columns = Columns.of(mechanism)

    def whole(e):
        pieces = list(rows(Scene.of(mechanism, columns, e, cutoff=cutoff), cutoff))
        return {n: np.concatenate([getattr(p, n) for p in pieces]) for n in vars(pieces[0])}

    monkeypatch.setattr("ident.equations.filter.CHUNK", 10**6)
    expected = whole(e)
    for size in (1, 7, 100):
        monkeypatch.setattr("ident.equations.filter.CHUNK", size)
        for state in (replace(e), e):  # columns of Γ made anew, or kept with the state
            for key, value in whole(state).items():
                np.testing.assert_allclose(value, expected[key], rtol=1e-12, atol=1e-12)


def test_kept_columns_are_bounded_and_freed(robots, monkeypatch):
    mechanism, log = logged("arm", robots)
    scene = Scene.of(mechanism, Columns.of(mechanism), complete(mechanism, log).experiments[0])
    before = Store._used
    monkeypatch.setattr(Store, "LIMIT", 0)
    list(rows(scene, None))
    assert Store._used == before
    monkeypatch.setattr(Store, "LIMIT", before + 10**8)
    list(rows(scene, None))
    assert Store._used > before
    del scene
    assert Store._used == before


def test_a_piece_shorter_than_the_step_from_row_to_row_gives_none(robots):
    mechanism, decimator = load(robots / "arm"), Decimator.of(1.6, 1000.0)
    n = 2 * CHUNK + 3  # the last piece has 3 samples
    assert n > 2 * decimator.half
    t = np.arange(n) / 1000.0
    columns = {f"q.{name}": np.sin((i + 1) * t) for i, name in enumerate(mechanism.driven)}
    zeros = {f"tau.{name}": np.zeros(len(t)) for name in mechanism.driven}
    motion = complete(mechanism, Log.from_arrays("x", t, columns | zeros), cutoff=None)
    scene = Scene.of(mechanism, Columns.of(mechanism), motion.experiments[0], None, 1.6)
    found = list(rows(scene, 1.6))
    assert found
    assert all(len(piece.sample) for piece in found)


def test_what_is_kept_of_a_motion_is_what_it_gives(robots):
    """Columns of effects, of the second problem on, and the row of Γ that gives a load asked for
    often, with values of the parameters that change.
    """
    mechanism, log = logged("arm", robots)
    for label in ("viscous", "coulomb", "payload:hand", "load_friction:shoulder"):
        mechanism = mechanism.with_effect(label)
    motion = complete(mechanism, log)
    (e,) = motion.experiments
    columns, random = Columns.of(mechanism), np.random.default_rng(0)
    for _ in range(4):
        values = {name: random.normal() for effect in mechanism.effects for name in effect.names}
        point = Point(mechanism.prior * random.uniform(0.5, 2.0), values)
        kept, anew = (
            [*rows(Scene.of(mechanism, columns, state, point), motion.band.cutoff)]
            for state in (e, replace(e))
        )
        for one, other in zip(kept, anew, strict=True):
            np.testing.assert_allclose(one.A, other.A, atol=1e-9 * np.abs(other.A).max())
        loads = (
            Samples(mechanism, state, slice(None), point).predicted(("shoulder", "elbow"))[1]
            for state in (e, replace(e))
        )
        np.testing.assert_allclose(*loads, rtol=1e-9)
