"""What is shown against Pinocchio's own kinematics, virtual work, and the paper's reactions."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from moving import view_of

import ident
from helpers import J, tree_urdf, write_mechanism
from ident.display import render
from ident.show.bodies import pivots_of
from ident.show.view import SHOWN, reactions

KINDS = ("point", "revolute", "prismatic", "cylindrical", "universal", "planar", "fixed")
SIX = [("prismatic", axis) for axis in ("1 0 0", "0 1 0", "0 0 1")]
SIX += [("revolute", axis) for axis in ("1 0 0", "0 1 0", "0 0 1")]


@pytest.fixture(scope="module")
def slider(robots):
    mechanism = ident.load(robots / "slider_crank")
    return mechanism, ident.complete(mechanism, robots / "slider_crank" / "run.csv")


def two_branches(folder: Path, closure: str, seed: int = 0) -> ident.Mechanism:
    """Two free bodies, six joints each, that a closure ties."""
    joints = []
    for branch in "uv":
        names = [""] + [f"{branch}{i}" for i in range(6)]
        joints += [J(names[i + 1], kind, axis, names[i]) for i, (kind, axis) in enumerate(SIX)]
    toml = f'[[closure]]\nname = "tie"\n{closure}'
    return ident.load(write_mechanism(folder, tree_urdf(joints, seed), toml))


ENDS = (
    'a = { link = "u5_link", xyz = [0.1, -0.2, 0.05], rpy = [0.3, 0.2, -0.4] }\n'
    'b = { link = "v5_link", xyz = [-0.1, 0.15, 0.2], rpy = [-0.5, 0.1, 0.7] }\n'
)


@pytest.mark.parametrize("kind", [*KINDS, "distance"])
def test_reactions_do_the_work_of_the_multipliers(tmp_path, kind):
    length = "length = 0.7\n" if kind == "distance" else ""
    mechanism = two_branches(tmp_path, f'kind = "{kind}"\n{ENDS}{length}')
    q, model = mechanism.general, mechanism.model
    rows = mechanism.kinematics.closure_rows(q[None])
    assert np.abs(rows.value).max() < 1e-9
    multipliers = np.random.default_rng(1).normal(size=(1, rows.rate.shape[1]))
    _, force = reactions(mechanism, q[None], multipliers)
    work = -rows.rate[0].T @ multipliers[0]
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    for k, end in enumerate(mechanism.closures[0].frames):
        jacobian = pin.getJointJacobian(model, data, end.joint, pin.LOCAL_WORLD_ALIGNED)
        first = [model.joints[model.getJointId(f"{'uv'[k]}{i}")].idx_v for i in range(3)]  # slides
        np.testing.assert_allclose(jacobian[:3, first].T @ force[0, k], work[first], atol=1e-9)


def poses(mechanism: ident.Mechanism, q: np.ndarray) -> list[pin.SE3]:
    """Return the poses of all joints at q, as they are drawn."""
    data = mechanism.model.createData()
    pin.forwardKinematics(mechanism.model, data, q)
    return [pin.SE3(each) for each in data.oMi]


def test_bodies_are_where_pinocchio_puts_them(slider):
    mechanism, motion = slider
    (film,) = motion.view().films
    raw = pin.buildModelFromUrdf(str(mechanism.urdf))
    data = raw.createData()
    for k in (0, 50, len(film) - 1):
        at = int(np.argmin(np.abs(motion.experiments[0].t - film.t[k])))
        pin.framesForwardKinematics(raw, data, motion.experiments[0].q[at])
        drawn = poses(mechanism, film.q[k])
        for i, link in enumerate(mechanism.bodies.links, start=1):
            frame = data.oMf[raw.getFrameId(link)]
            np.testing.assert_allclose(drawn[i].homogeneous, frame.homogeneous, atol=1e-12)


def test_the_rod_rests_on_the_crank_with_half_its_weight(slider, robots):
    mechanism, motion = slider
    known = ident.read_log(robots / "slider_crank" / "reactions.csv")
    e = motion.experiments[0]
    names = mechanism.kinematics.multipliers
    forces = np.stack([np.interp(e.t, known.t, known.columns[name]) for name in names], axis=1)
    view = view_of(mechanism, e.t, e.q, forces)
    film = view.films[0]
    on_crank, on_rod = film.force[0]
    np.testing.assert_allclose(on_rod, [0, 0, 0.5 * 9.81 / 2], atol=1e-9)
    np.testing.assert_allclose(on_crank, -on_rod)
    angle = e.q[0, mechanism.joint("theta").index]
    pin_ = [0.0, 0.1 - 0.08 * np.sin(angle), 0.12 + 0.08 * np.cos(angle)]
    np.testing.assert_allclose(film.at[0], [pin_, pin_], atol=1e-9)
    largest = np.linalg.norm(forces, axis=1).max()
    assert view.largest_force == pytest.approx(largest, rel=2e-2)


def test_a_fit_colours_joints_and_moves_no_body(robots):
    mechanism = ident.load(robots / "five_bar")
    motion = ident.complete(mechanism, robots / "five_bar" / "run.csv")
    fit = ident.identify(mechanism, motion)
    (e,), (p,) = motion.experiments, fit.predict()
    film = render(mechanism, "view", [e], [p]).films[0]
    usable = np.flatnonzero(p.usable)
    k = len(film) // 2
    sample = int(np.argmin(np.abs(e.t - film.t[k])))
    near = usable[np.abs(e.t[usable] - e.t[sample]) <= 0.05 + 1e-9]
    for i, joint in enumerate(p.joints):
        share = np.sqrt(np.mean(p.residual[near, i] ** 2) / np.mean(p.measured[:, i] ** 2))
        assert film.misfit[joint][k] == pytest.approx(share, rel=1e-6)
    assert "left_elbow" not in film.misfit
    np.testing.assert_array_equal(film.q, motion.view().films[0].q)


def test_absolute_coordinates_show_the_same(slider, robots):
    mechanism, motion = slider
    free = ident.absolute(mechanism)
    other = ident.complete(free, robots / "slider_crank" / "run.csv").view()
    view = motion.view()
    pivots = [{x.name for x in each.shapes if x.kind == "joint"} for each in (view, other)]
    assert pivots[0] == pivots[1]
    places = [
        (view, poses(mechanism, view.films[0].q[9])),
        (other, poses(free, other.films[0].q[9])),
    ]
    clouds, axes = [], []
    for each, drawn in places:
        cloud = [
            x.corners @ drawn[x.joint].rotation.T + drawn[x.joint].translation
            for x in each.shapes
            if x.kind == "body"
        ]
        clouds.append(np.concatenate(cloud))
        marks = pivots_of(each.mechanism)
        axes.append({n: drawn[i].rotation @ M.rotation[:, 2] for n, _, i, M in marks})
    np.testing.assert_allclose(clouds[0], clouds[1], atol=1e-7)
    for name, axis in axes[0].items():
        np.testing.assert_allclose(axis, axes[1][name], atol=1e-7)


@pytest.mark.usefixtures("short_search")
def test_without_shapes_rods_join_the_joints(tmp_path):
    toml = (
        '[[closure]]\nname = "tie"\nkind = "point"\na = { link = "world" }\n'
        'b = { link = "b_link", xyz = [0.0, 0.7, 0.0] }\n'
    )
    joints = [J("a"), J("b", parent="a"), J("c", parent="b")]
    mechanism = ident.load(write_mechanism(tmp_path, tree_urdf(joints), toml))
    own = [x for x in mechanism.view().shapes if x.name == "b_link"]
    assert len(own) == 4  # two rods, one to the centre of mass, and a ball there
    ends = []
    for rod in own[:2]:
        ends += [rod.corners[: len(rod.corners) // 2], rod.corners[len(rod.corners) // 2 :]]
    to_c = mechanism.model.jointPlacements[3].translation
    for place in (np.zeros(3), np.array([0.0, 0.7, 0.0]), to_c):
        middles = np.array([each.mean(axis=0) for each in ends])
        assert np.linalg.norm(middles - place, axis=1).min() < 1e-9


def test_the_ground_has_rods_between_its_joints(robots, tmp_path):
    text = (robots / "four_bar" / "four_bar.urdf").read_text()
    toml = (robots / "four_bar" / "mechanism.toml").read_text()
    (tmp_path / "mechanism.toml").write_text(toml)
    bare = re.sub(r"<visual>.*?</visual>", "", text, flags=re.DOTALL)
    for shapes in (text, bare):
        (tmp_path / "four_bar.urdf").write_text(shapes)
        view = ident.load(tmp_path).view()
        ground = [x for x in view.shapes if x.kind == "body" and x.joint == 0]
        assert len(ground) == 1


@pytest.mark.usefixtures("short_search")
def test_loops_that_do_not_close_are_shown_open(robots, tmp_path):
    text = (robots / "four_bar" / "mechanism.toml").read_text().replace("0.41,", "4.1,")
    (tmp_path / "mechanism.toml").write_text(text)
    (tmp_path / "four_bar.urdf").write_text((robots / "four_bar" / "four_bar.urdf").read_text())
    view = ident.load(tmp_path).view()
    assert "do not close" in view.notes[0]
    assert view.films[0].gap[0] > 1
    assert "open by up to" in view.legend


def test_a_gear_has_no_arrow_and_says_so(robots, tmp_path):
    toml = (
        '[[closure]]\nname = "gear"\nkind = "linear"\njoints = ["a", "b"]\nratios = [1.0, -2.0]\n'
    )
    mechanism = ident.load(write_mechanism(tmp_path, tree_urdf([J("a"), J("b", parent="a")]), toml))
    view = view_of(mechanism, np.zeros(1), np.zeros((1, 2)), np.ones((1, 1)))
    assert view.films[0].force.shape == (1, 0, 3)
    assert "gear" in view.notes[0]


def test_a_list_that_is_cut_in_the_legend_ends_with_an_ellipsis(slider):
    view = slider[1].view()
    notes = [f"note {n}" for n in range(SHOWN + 1)]
    assert "…</span></i>" not in replace(view, notes=tuple(notes[:-1])).legend
    cut = replace(view, notes=tuple(notes)).legend
    assert "…</span></i>" in cut
    assert notes[-1] not in cut


def test_a_motion_of_no_mechanism_cannot_be_shown(slider):
    with pytest.raises(ident.MotionError, match="complete"):
        replace(slider[1], mechanism=None).view()
