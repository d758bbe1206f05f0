"""What is shown against Pinocchio's own kinematics, virtual work, and the paper's reactions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import ident
from helpers import J, tree_urdf, write_mechanism
from ident.show.mechanism import ShownMotion, loads_of, view_of
from ident.show.view3d import rotations
from ident.show.view3d.page import legend

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
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    R = np.array([[each.rotation for each in data.oMi]])
    p = np.array([[each.translation for each in data.oMi]])
    loads = loads_of(mechanism, (R, p), multipliers)
    assert loads.names == ("tie on u5_link", "tie on v5_link")
    work = np.zeros(model.nv)
    for k, joint in enumerate((mechanism.closures[0].a.joint, mechanism.closures[0].b.joint)):
        jacobian = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        arm = loads.at[0, k] - p[0, joint]
        wrench = np.concatenate(
            [loads.force[0, k], loads.moment[0, k] + np.cross(arm, loads.force[0, k])]
        )
        work += jacobian.T @ wrench
    np.testing.assert_allclose(work, -rows.rate[0].T @ multipliers[0], atol=1e-9)


def test_bodies_are_where_pinocchio_puts_them(slider):
    mechanism, motion = slider
    view = motion.view()
    (film,) = view.films
    raw = pin.buildModelFromUrdf(str(mechanism.urdf))
    data = raw.createData()
    for k in (0, 700, len(film) - 1):
        at = int(np.argmin(np.abs(motion.experiments[0].t - film.t[k])))
        pin.framesForwardKinematics(raw, data, motion.experiments[0].q[at])
        for i, body in enumerate(view.stage.bodies[1:], start=1):
            frame = data.oMf[raw.getFrameId(body.name)]
            np.testing.assert_allclose(film.position[k, i], frame.translation, atol=1e-12)
            np.testing.assert_allclose(rotations(film.wxyz[k, i]), frame.rotation, atol=1e-12)


def test_quaternions_are_those_of_scipy(slider):
    film = slider[1].view().films[0]
    xyzw = np.roll(film.wxyz[:50].reshape(-1, 4), -1, axis=1)
    expected = Rotation.from_quat(xyzw).as_matrix()
    np.testing.assert_allclose(rotations(film.wxyz[:50]).reshape(-1, 3, 3), expected, atol=1e-12)


def test_the_rod_rests_on_the_crank_with_half_its_weight(slider, robots):
    mechanism, motion = slider
    known = ident.read_log(robots / "slider_crank" / "reactions.csv")
    e = motion.experiments[0]
    names = mechanism.kinematics.multipliers
    forces = np.stack([np.interp(e.t, known.t, known.columns[name]) for name in names], axis=1)
    view = view_of(mechanism, [ShownMotion(e.name, e.t, e.q, forces)])
    film = view.films[0]
    on_crank, on_rod = film.loads.force[0, 0], film.loads.force[0, 1]
    assert film.loads.names == ("ball on crank", "ball on rod")
    np.testing.assert_allclose(on_rod, [0, 0, 0.5 * 9.81 / 2], atol=1e-9)
    np.testing.assert_allclose(on_crank, -on_rod)
    angle = e.q[0, mechanism.joint("theta").index]
    pin_ = [0.0, 0.1 - 0.08 * np.sin(angle), 0.12 + 0.08 * np.cos(angle)]
    np.testing.assert_allclose(film.loads.at[0], [pin_, pin_], atol=1e-9)
    np.testing.assert_allclose(film.ends[0, 0], [pin_, pin_], atol=1e-9)
    largest = np.linalg.norm(forces, axis=1).max()
    assert view.scales.force == pytest.approx(largest, rel=1e-2)


def test_a_fit_colours_joints_and_moves_no_body(robots):
    mechanism = ident.load(robots / "five_bar")
    motion = ident.complete(mechanism, robots / "five_bar" / "run.csv")
    fit = ident.identify(mechanism, motion)
    (e,), (p,) = motion.experiments, fit.predict()
    film = view_of(mechanism, [ShownMotion.of(e, p)]).films[0]
    at = {pivot.name: i for i, pivot in enumerate(view_of(mechanism).stage.pivots)}
    usable = np.flatnonzero(p.usable)
    k = len(film) // 2
    sample = int(np.argmin(np.abs(e.t - film.t[k])))
    near = usable[np.abs(e.t[usable] - e.t[sample]) <= 0.05 + 1e-9]
    for i, joint in enumerate(p.joints):
        share = np.sqrt(np.mean(p.residual[near, i] ** 2) / np.mean(p.measured[:, i] ** 2))
        assert film.misfit[k, at[joint]] == pytest.approx(share, rel=1e-6)
    assert np.isnan(film.misfit[:, at["left_elbow"]]).all()
    np.testing.assert_array_equal(film.position, motion.view().films[0].position)


def test_absolute_coordinates_show_the_same(slider, robots):
    mechanism, motion = slider
    free = ident.absolute(mechanism)
    other = ident.complete(free, robots / "slider_crank" / "run.csv").view()
    here = motion.view()
    assert {pivot.name for pivot in other.stage.pivots} == {
        pivot.name for pivot in here.stage.pivots
    }
    np.testing.assert_allclose(other.films[0].position, here.films[0].position, atol=1e-7)
    for a, b in zip(here.stage.bodies, other.stage.bodies, strict=True):
        assert [len(s.vertices) for s in a.shapes] == [len(s.vertices) for s in b.shapes]
    for pivot in here.stage.pivots:
        (same,) = [each for each in other.stage.pivots if each.name == pivot.name]
        axes = []
        for view, each in ((here, pivot), (other, same)):
            axes.append(rotations(view.films[0].wxyz[9, each.body]) @ each.R[:, 2])
        np.testing.assert_allclose(axes[0], axes[1], atol=1e-7)


def test_without_shapes_rods_join_the_joints(tmp_path):
    toml = (
        '[[closure]]\nname = "tie"\nkind = "point"\na = { link = "world" }\n'
        'b = { link = "b_link", xyz = [0.0, 0.7, 0.0] }\n'
    )
    joints = [J("a"), J("b", parent="a"), J("c", parent="b")]
    mechanism = ident.load(write_mechanism(tmp_path, tree_urdf(joints), toml))
    stage = view_of(mechanism).stage
    body = next(each for each in stage.bodies if each.name == "b_link")
    ends = np.concatenate([shape.vertices for shape in body.shapes])
    to_c = mechanism.model.jointPlacements[3].translation
    for place in (np.zeros(3), np.array([0.0, 0.7, 0.0]), to_c):
        assert np.linalg.norm(ends - place, axis=1).min() < 0.02 * stage.size
    assert len(body.shapes) == 3  # two rods and the inertia


def test_loops_that_do_not_close_are_shown_open(robots, tmp_path):
    text = (robots / "four_bar" / "mechanism.toml").read_text().replace("0.41,", "4.1,")
    (tmp_path / "mechanism.toml").write_text(text)
    (tmp_path / "four_bar.urdf").write_text((robots / "four_bar" / "four_bar.urdf").read_text())
    view = ident.load(tmp_path).view()
    assert "do not close" in view.notes[0]
    assert view.films[0].gap[0] > 1
    assert "open by up to" in legend(view)


def test_a_gear_has_no_arrow_and_says_so(robots, tmp_path):
    toml = (
        '[[closure]]\nname = "gear"\nkind = "linear"\njoints = ["a", "b"]\nratios = [1.0, -2.0]\n'
    )
    mechanism = ident.load(write_mechanism(tmp_path, tree_urdf([J("a"), J("b", parent="a")]), toml))
    view = view_of(mechanism, [ShownMotion("run", np.zeros(1), np.zeros((1, 2)), np.ones((1, 1)))])
    assert view.films[0].loads.names == ()
    assert "gear" in view.notes[0]


def test_a_motion_of_no_mechanism_cannot_be_shown(slider):
    with pytest.raises(ident.MotionError, match="complete"):
        replace(slider[1], mechanism=None).view()
