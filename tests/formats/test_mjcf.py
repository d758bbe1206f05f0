"""MuJoCo models: their torques, places and loops against MuJoCo itself."""

from __future__ import annotations

import sys
import tomllib
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial import ConvexHull

import ident
from formats import MJCF
from helpers import ROBOTS
from ident.errors import MechanismError
from ident.mechanism import load
from ident.mechanism.description import read_urdf
from ident.mechanism.parameters import regressor
from ident.mechanism.write import add_effects, folder_files

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco model="odd">
  <compiler angle="degree" autolimits="true" eulerseq="XYZ"/>
  <option gravity="1 -2 -9"/>
  <default>
    <joint damping="0.3" armature="0.02"/>
    <default class="big"><geom density="2700" type="capsule" size="0.03"/>
      <joint axis="0 1 0" range="-90 90"/></default>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="base" pos="0 0 0.2" euler="10 20 30"><geom type="box" size=".1 .1 .05"/>
      <body name="upper" pos="0.1 0 0.1" quat="0.9 0.1 0.3 0" childclass="big">
        <joint name="shoulder" pos="0.02 0 0.01"/>
        <joint name="twist" axis="1 0 0" pos="0 0.03 0" frictionloss="0.1"/>
        <joint name="reach" type="slide" axis="1 1 0" range="-0.1 0.3" ref="0.1"/>
        <geom fromto="0 0 0 0.3 0 0.1"/>
        <geom type="box" size="0.02 0.03 0.04" pos="0.1 0 0" axisangle="0 0 1 30"/>
        <frame pos="0 0.1 0" euler="0 0 20">
          <body name="fore" pos="0.3 0 0.1" xyaxes="0 1 0 -1 0 0.2">
            <joint name="elbow" ref="15" pos="0 0 0.05" stiffness="2"/>
            <inertial pos="0.1 0.02 0" mass="1.2" diaginertia="0.01 0.02 0.025" euler="0 30 0"/>
            <body pos="0.2 0 0" zaxis="1 0 1">
              <joint type="slide" axis="0 0 1"/>
              <geom type="sphere" size="0.05" mass="0.4"/>
              <site name="tip" pos="0.1 0.2 0.3"/>
              <body name="tool" pos="0 0 0.1"><geom type="cylinder" size="0.02 0.05"/></body>
              <body name="tool2" pos="0 0.1 0.1"><geom type="ellipsoid" size="0.02 0.05 0.03"/></body>
            </body>
          </body>
        </frame>
      </body>
    </body>
  </worldbody>
</mujoco>
"""  # noqa: E501
BODY = '<mujoco><worldbody><body name="a">{}<geom size="0.1"/></body></worldbody>{}</mujoco>'


@pytest.fixture
def make(tmp_path):
    """`make(text)`: the path of a model file."""

    def write(text: str, name: str = "robot.xml") -> Path:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return write


def bodies_alone(path: Path):
    """MuJoCo's model without what is no rigid body, and where each of our joints stands in it."""
    model = mujoco.MjModel.from_xml_path(str(path))
    for values in (model.dof_damping, model.dof_armature, model.dof_frictionloss):
        values[:] = 0
    model.jnt_stiffness[:] = 0
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_EQUALITY
    names = [model.joint(j).name for j in range(model.njnt)]
    ours = [j.name for j in load(path).joints if j.in_tree]
    return model, [names.index(name if name in names else "") for name in ours]


def states(n: int, count: int = 20):
    return np.random.default_rng(0).normal(size=(3, count, n))


@pytest.mark.parametrize("text", [ARM, MJCF], ids=["odd", "four-bar"])
def test_torques_are_those_of_mujoco(make, text):
    """Γ π of the prior, in MuJoCo's own coordinates, at random states."""
    mechanism = load(make(text))
    model, at = bodies_alone(make(text))
    data = mujoco.MjData(model)
    q, v, a = states(model.nv)
    found = regressor(mechanism.model, q, v, a) @ mechanism.prior
    for k in range(len(q)):
        data.qpos[at], data.qvel[at], data.qacc[at] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(found[k], data.qfrc_inverse[at], atol=1e-12)


WALKER = """<mujoco><option gravity="0 1 -9"/><worldbody>
  <body name="trunk" pos="0 0 1" euler="10 20 30"><freejoint/><geom size="0.1"/>
    <body name="leg" pos="0.1 0 -0.1"><joint name="hip" axis="0 1 0" pos="0 0 .02"/>
      <geom type="capsule" size="0.03" fromto="0 0 0 0.1 0 -0.3"/>
      <body name="foot" pos="0.1 0 -0.3"><joint name="ankle" type="ball"/><geom size="0.05"/></body>
    </body>
    <body name="arm" pos="0 0.1 0"><joint name="lift" type="slide"/><geom size="0.04"/></body>
  </body></worldbody><actuator><motor joint="hip"/><motor joint="lift"/></actuator></mujoco>"""


def test_a_locked_free_joint_is_welded(make):
    """Torques are MuJoCo's with its base, and a ball joint, at rest where the file has them."""
    path = make(WALKER)
    mechanism = load(path, locked={"trunk_joint": None, "ankle": None})
    assert (mechanism.driven, mechanism.passive) == (("hip", "lift"), ())
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    places = [[model.joint(n).qposadr[0] for n in ("hip", "lift")]]
    places += [[model.joint(n).dofadr[0] for n in ("hip", "lift")]]
    q, v, a = states(2)
    found = regressor(mechanism.model, q, v, a) @ mechanism.prior
    for k in range(len(q)):
        data.qpos[places[0]], data.qvel[places[1]], data.qacc[places[1]] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(found[k], data.qfrc_inverse[places[1]], atol=1e-12)
    with pytest.raises(MechanismError, match="only --lock trunk_joint, where the file has it"):
        load(path, locked={"trunk_joint": 0.3, "ankle": None})


def test_a_free_joint_and_a_ball_have_mujocos_dynamics(make):
    """Generalised forces of poses in the world; angles of yaw, pitch and roll against MuJoCo's."""
    path = make(WALKER)
    mechanism = load(path)
    chains = {chain.name: chain for chain in mechanism.chains}
    assert chains.keys() == {"trunk_joint", "ankle"}
    assert (chains["trunk_joint"].floating, chains["ankle"].floating) == (True, False)
    assert mechanism.driven == ("hip", "lift")
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data, ours = mujoco.MjData(model), mechanism.model.createData()
    place = {joint.name: joint.index for joint in mechanism.joints}

    def set_position(q):
        """qpos of scalar coordinates."""
        data.qpos[model.joint("hip").qposadr[0]] = q[place["hip"]]
        data.qpos[model.joint("lift").qposadr[0]] = q[place["lift"]]
        free, ball = (model.jnt_qposadr[i] for i in (0, 2))
        data.qpos[free : free + 3] = [q[place[f"trunk_joint.{x}"]] for x in "xyz"]
        for name, at in (("trunk_joint", free + 3), ("ankle", ball)):
            turn = pin.rpy.rpyToMatrix(*(q[place[f"{name}.r{x}"]] for x in "xyz"))
            x, y, z, w = pin.Quaternion(turn).coeffs()
            data.qpos[at : at + 4] = w, x, y, z

    set_position(mechanism.start)
    np.testing.assert_allclose(data.qpos, model.qpos0, atol=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q = rng.uniform(-1, 1, mechanism.model.nq)
        set_position(q)
        mujoco.mj_forward(model, data)
        pin.computeAllTerms(mechanism.model, ours, q, np.zeros(mechanism.model.nv))
        potential = pin.computePotentialEnergy(mechanism.model, ours, q)
        pin.framesForwardKinematics(mechanism.model, ours, q)
        foot = ours.oMf[mechanism.model.getFrameId("foot", pin.FrameType.BODY)]
        body = data.body("foot")
        np.testing.assert_allclose(foot.translation, body.xpos, atol=1e-12)
        np.testing.assert_allclose(foot.rotation, body.xmat.reshape(3, 3), atol=1e-12)
        mujoco.mj_energyPos(model, data)
        assert potential == pytest.approx(data.energy[0], abs=1e-10)


def test_places_are_those_of_mujoco(make):
    """Of every body, and of a site: by the closure frame that would be written for it."""
    path = make(ARM)
    mechanism = load(path)
    model, at = bodies_alone(path)
    data = mujoco.MjData(model)
    tree = mechanism.model
    own = tree.createData()
    for q in states(model.nv)[0]:
        data.qpos[at] = q
        mujoco.mj_kinematics(model, data)
        pin.framesForwardKinematics(tree, own, q)
        for i in range(1, model.nbody):
            link = model.body(i).name or "body_4"
            frame = own.oMf[tree.getFrameId(link, pin.FrameType.BODY)]
            np.testing.assert_allclose(frame.rotation, data.xmat[i].reshape(3, 3), atol=1e-12)
            anchor = model.jnt_pos[model.body_jntadr[i] + model.body_jntnum[i] - 1]
            if model.body_jntnum[i] == 0:
                anchor = np.zeros(3)
            origin = data.xpos[i] + data.xmat[i].reshape(3, 3) @ anchor
            np.testing.assert_allclose(frame.translation, origin, atol=1e-12)


def test_missing_meshes_are_one_note(make):
    """Kinematics and stated inertias need no shapes; nor do textures."""
    model = (
        '<mujoco><asset><mesh file="gone/b.stl"/><mesh name="c" file="c.obj"/>'
        '<texture name="t" type="2d" file="t.png"/><material name="m" texture="t"/></asset>'
        '<worldbody><body name="a"><joint axis="0 1 0"/><inertial pos="0 0 .1" mass="2" '
        'diaginertia=".1 .2 .3"/><geom type="mesh" mesh="b" material="m"/></body>'
        '<body name="d"><joint axis="1 0 0"/><geom type="mesh" mesh="c"/></body>'
        "</worldbody></mujoco>"
    )
    mechanism = load(make(model))
    (note,) = [each for each in mechanism.notes if "are missing" in each]
    assert note.startswith("3 files")
    assert "the first gone/b.stl" in note
    assert mechanism.model.inertias[1].mass == 2
    assert mechanism.model.inertias[2].mass < 1e-4


def box(size, at) -> bytes:
    """A binary STL: 80 bytes, the number of triangles, and of each its normal and corners."""
    corners = np.array(list(product(*[(-x / 2, x / 2) for x in size]))) + at
    triangles = b""
    for face in ConvexHull(corners).simplices:
        a, b, c = corners[face]
        if np.cross(b - a, c - a) @ (a - at) < 0:  # outside is where corners run anticlockwise
            b, c = c, b
        triangles += np.array([[0, 0, 0], a, b, c], "<f4").tobytes() + b"\0\0"
    return bytes(80) + np.uint32(12).tobytes() + triangles


def test_meshes_stand_where_their_file_has_them(make, tmp_path):
    """MuJoCo moves a mesh into its principal axes and says so; the URDF has the file's own."""
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "b.stl").write_bytes(box((0.1, 0.2, 0.3), (0.5, 0.1, 0.0)))
    path = make(
        '<mujoco><compiler meshdir="assets"/>'
        '<asset><mesh name="b" file="b.stl" scale="1 1 2"/></asset><worldbody>'
        '<body name="a"><joint axis="0 1 0"/>'
        '<geom type="mesh" mesh="b" pos="0 0 0.1" euler="0 0 90" density="1000"/></body>'
        "</worldbody></mujoco>"
    )
    mechanism = load(path)
    visual = read_urdf(path).find("link[@name='a']/visual")
    assert visual.find("geometry/mesh").get("filename") == "assets/b.stl"
    assert visual.find("geometry/mesh").get("scale") == "1.0 1.0 2.0"
    at = [float(x) for key in ("xyz", "rpy") for x in visual.find("origin").get(key).split()]
    np.testing.assert_allclose(at, [0, 0, 0.1, 0, 0, np.pi / 2], atol=1e-6)
    body = mechanism.model.inertias[1]
    np.testing.assert_allclose(body.mass, 12, rtol=1e-5)
    np.testing.assert_allclose(body.lever, [-0.1, 0.5, 0.1], atol=1e-6)
    Ixx, Iyy = 12 * (0.1**2 + 0.6**2) / 12, 12 * (0.2**2 + 0.6**2) / 12
    np.testing.assert_allclose(np.diag(body.inertia)[:2], [Ixx, Iyy], rtol=1e-5)


def test_what_is_understood(make):
    mechanism = load(make(ARM))
    names = {"shoulder", "twist", "reach", "elbow", "body_4_joint"}
    assert {joint.name for joint in mechanism.joints} == names
    assert set(mechanism.driven) == names  # the file has no actuator
    assert mechanism.joint("reach").lower == pytest.approx(-0.1)
    assert mechanism.joint("shoulder").upper == pytest.approx(np.pi / 2)
    assert mechanism.joint("body_4_joint").upper == 90  # metres: the class has -90 90
    np.testing.assert_array_equal(mechanism.model.gravity.linear, [1, -2, -9])
    asked = {name.rsplit(".", 1)[0] for name in mechanism.unknown}
    assert asked == {"upper", "fore", "body_4"}  # not the massless links between its joints
    np.testing.assert_allclose(
        [mechanism.start[mechanism.joint(n).index] for n in ("reach", "elbow")], [0.1, np.pi / 12]
    )
    said = "\n".join(mechanism.notes)
    assert "damping of shoulder, twist, reach, elbow, body_4_joint is not taken over" in said
    assert "--with viscous" in said
    assert "frictionloss of twist is not taken over; to identify it: --with coulomb:twist" in said
    assert "stiffness of elbow is not taken over; to identify it: --with spring:elbow" in said
    assert "armature" in said
    assert "fore: the link's origin is at its joint" in said


# --- loops --------------------------------------------------------------------------------------


def test_a_loop_closes_where_mujoco_closes_it(make):
    """Completed from the crank alone, MuJoCo's own constraint is left at nothing."""
    path = make(MJCF)
    mechanism = load(path)
    assert mechanism.degrees_of_freedom == 1
    assert (mechanism.driven, mechanism.passive) == (("crank",), ("coupler", "rocker"))
    assert [(c.name, c.kind) for c in mechanism.closures] == [("pin", "point")]
    assert any("coupler, rocker: no actuator, so passive" in note for note in mechanism.notes)
    log = ident.read_log(ROBOTS / "four_bar" / "run.csv")
    (e,) = ident.complete(mechanism, log).experiments
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    at = [model.joint(joint.name).qposadr[0] for joint in mechanism.joints if joint.in_tree]
    for q in e.q[::100]:
        data.qpos[at] = q
        mujoco.mj_forward(model, data)
        assert data.ne == 3
        np.testing.assert_allclose(data.efc_pos[:3], 0, atol=1e-9)


def test_identified_as_from_its_urdf(make):
    """Same machine, same log: the four-bar's URDF closes by a full pin, MuJoCo's by a point."""
    log = ident.read_log(ROBOTS / "four_bar" / "run.csv")
    fits = []
    for mechanism in (load(ROBOTS / "four_bar"), load(make(MJCF))):
        model = mechanism.with_effect("viscous").with_effect("coulomb")
        fits.append(ident.identify(model, ident.complete(model, log)))
    urdf, mjcf = fits
    assert mjcf.rank == urdf.rank
    assert mjcf.train["crank"].rms == pytest.approx(urdf.train["crank"].rms, rel=1e-6)
    for name in ("viscous.crank.Fv", "coulomb.crank.Fc"):
        assert mjcf[name].value == pytest.approx(urdf[name].value, rel=1e-5)


WELD = """<mujoco><worldbody>
  <body name="a" pos="0.1 0.2 0.3" euler="10 20 30"><joint name="ja" axis="0 1 0"/>
    <geom size="0.1"/></body>
  <body name="b" pos="0.3 0.1 0" euler="0 40 0"><joint name="jb" axis="1 1 0" pos="0.1 0 0"/>
    <geom size="0.1"/><site name="sb" pos="0 0.1 0" euler="0 0 30"/></body>
  <body name="c" pos="0 0 1"><joint name="jc" axis="0 1 0" ref="20"/><geom size="0.1"/>
    <site name="sc" pos="0.1 0 0"/></body>
</worldbody><equality>{}</equality></mujoco>"""
LOOPS = {
    "connect": ('<connect body1="a" body2="b" anchor="0.1 0.2 0.3"/>', 3),
    "connect to the world": ('<connect body1="a" anchor="0.1 0.2 0.3"/>', 3),
    "connect of sites": ('<connect site1="sb" site2="sc"/>', 3),
    "weld": ('<weld body1="a" body2="b"/>', 6),
    "weld at a point": ('<weld body1="a" body2="b" anchor="0.1 0.2 0.3" torquescale="1"/>', 6),
    "weld elsewhere": ('<weld body1="a" body2="b" relpose="1 2 3 0.9 0.1 0.2 0.3"/>', 6),
    "weld of sites": ('<weld site1="sb" site2="sc"/>', 6),
    "joints": ('<joint joint1="jc" joint2="ja" polycoef="0.3 -2 0 0 0"/>', 1),
    "a curve": ('<joint joint1="jc" joint2="ja" polycoef="0.3 -2 0.4 0.2 -0.1"/>', 1),
    "a curve the other way": ('<joint joint1="ja" joint2="jc" polycoef="0.3 -2 0.4 0.2 -0.1"/>', 1),
    "a tendon": ('<tendon tendon1="s"/>', 1),
    "tendons": ('<tendon tendon1="s" tendon2="t" polycoef="0.2 1.5 0 0 0"/>', 1),
}
TENDONS = """<tendon>
  <fixed name="s"><joint joint="ja" coef="0.5"/><joint joint="jc" coef="-0.3"/></fixed>
  <fixed name="t"><joint joint="jb" coef="2"/><joint joint="jc" coef="0.1"/></fixed>
</tendon><equality>"""


@pytest.mark.parametrize(("equality", "rows"), LOOPS.values(), ids=LOOPS)
@pytest.mark.usefixtures("short_search")
def test_equalities_are_zero_together(make, equality, rows):
    """Φ = 0 where MuJoCo's residual is, and grows with it; positions to the number."""
    path = make(WELD.format(equality).replace("<equality>", TENDONS))
    mechanism = load(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    at = [model.joint(joint.name).qposadr[0] for joint in mechanism.joints if joint.in_tree]
    for q in (mechanism.start, *np.random.default_rng(0).normal(size=(5, 3))):
        data.qpos[at] = q
        mujoco.mj_forward(model, data)
        theirs = data.efc_pos[: data.ne]
        ours = mechanism.kinematics.closure_rows(q[None]).value[0]
        assert len(ours) == len(theirs) == rows
        count = min(rows, 3)
        sign = 1 if rows == 1 else -1
        np.testing.assert_allclose(ours[:count], sign * theirs[:count], atol=1e-9)
        if rows == 6:  # both count turns, each in its own way: zero together
            turned = np.linalg.norm(theirs[3:]) > 1e-7
            assert turned == (np.linalg.norm(ours[3:]) > 1e-7)


def test_inactive_equalities_and_tendons(make):
    path = make(WELD.format('<weld name="off" body1="a" body2="b" active="false"/>'))
    assert load(path).closures == ()
    assert "equality 'off' is inactive and left out" in load(path).notes


# --- written ------------------------------------------------------------------------------------


def test_commands_from_model_to_identified_folder(make, tmp_path, spoken):
    path = make(MJCF, "machine.xml")
    log = ROBOTS / "four_bar" / "run.csv"
    status, _, err = spoken("identify", path, log, "--with", "coulomb", "--out", tmp_path / "out")
    assert status == 0, err
    assert {p.name for p in (tmp_path / "out" / "identified").iterdir()} == {
        "covariance.csv", "machine.urdf", "mechanism.toml"
    }  # fmt: skip
    known = load(tmp_path / "out" / "identified")
    assert known.unknown == ()
    assert known.degrees_of_freedom == 1
    assert known.passive == ("coupler", "rocker")
    np.testing.assert_array_equal(known.model.gravity.linear, [0, 0, -9.81])
    np.testing.assert_allclose(known.assembled, load(path).assembled, atol=1e-9)
    bare = pin.buildModelFromUrdf(str(tmp_path / "out" / "identified.urdf"))
    assert set(bare.names[1:]) == {"crank", "coupler", "rocker"}
    status, _, _ = spoken("compare", path, log, "--fit", tmp_path / "out" / "fit.json")
    assert status == 0


def test_an_effect_is_added_beside_the_model(make, tmp_path):
    mechanism = load(make(MJCF))
    file = add_effects(mechanism, [ident.effect("viscous", "crank")])
    assert tomllib.loads(file.read_text())["urdf"] == "robot.xml"
    again = load(tmp_path)
    assert [c.name for c in again.closures] == ["pin"]
    assert again.passive == mechanism.passive
    assert [e.label for e in again.effects] == ["viscous:crank"]


def test_mechanism_toml_has_the_last_word(make, tmp_path):
    make(MJCF)
    (tmp_path / "mechanism.toml").write_text(
        'urdf = "robot.xml"\ngravity = [0, 0, -1.62]\n[joints]\npassive = ["coupler"]\n'
        'start = { crank = 0.5 }\n[[closure]]\nname = "brace"\nkind = "linear"\n'
        'joints = ["crank", "rocker"]\nratios = [1.0, -1.0]\n'
    )
    mechanism = load(tmp_path)
    assert [c.name for c in mechanism.closures] == ["pin", "brace"]
    assert mechanism.passive == ("coupler",)
    assert mechanism.start[mechanism.joint("crank").index] == 0.5
    assert mechanism.start[mechanism.joint("rocker").index] == pytest.approx(1.2187706)
    assert mechanism.model.gravity.linear[2] == -1.62
    (tmp_path / "mechanism.toml").write_text('urdf = "robot.xml"\n[joints]\npassive = []\n')
    assert set(load(tmp_path).driven) == {"crank", "coupler", "rocker"}


@pytest.mark.parametrize("text", [ARM, MJCF], ids=["odd", "four-bar"])
def test_a_grown_folder_is_the_same_machine(make, tmp_path, text):
    """From the model's own text, as it is there: what it says of loops is written out."""
    mechanism = load(make(text))
    files = folder_files(mechanism, mechanism.urdf.read_bytes(), [], unknown=None, estimates={})
    (tmp_path / "grown").mkdir()
    for name, content in files.items():
        (tmp_path / "grown" / name).write_bytes(content)
    again = load(tmp_path / "grown")
    assert again.unknown == mechanism.unknown
    assert (again.driven, again.passive) == (mechanism.driven, mechanism.passive)
    np.testing.assert_array_equal(again.prior, mechanism.prior)
    np.testing.assert_array_equal(again.start, mechanism.start)
    q = states(mechanism.model.nv)[0]
    rows = [m.kinematics.closure_rows(q).value for m in (mechanism, again)]
    np.testing.assert_array_equal(*rows)
    np.testing.assert_array_equal(again.model.gravity.linear, mechanism.model.gravity.linear)


# --- refused ------------------------------------------------------------------------------------

BAD = {
    "truncated": (MJCF[:500], "no well-formed XML"),
    "unknown element": (BODY.format("<spring/>", ""), "MuJoCo refuses it"),
    "unknown joint": (
        BODY.format("<joint/>", '<actuator><motor joint="x"/></actuator>'), "MuJoCo refuses it",
    ),
    "nothing moves": (BODY.format("", ""), "no joint that moves"),
    "no body": ("<mujoco/>", "no joint"),
    "document type": ('<!DOCTYPE mujoco [<!ENTITY a "b">]>' + MJCF, "document type"),
    "held": (WELD.format('<joint joint1="ja" polycoef="0 0 0 0 0"/>'), "holds joint 'ja'"),
    "tendon": (
        WELD.format('<tendon tendon1="t" polycoef="0 0 1 0 0"/>').replace(
            "<equality>",
            '<tendon><fixed name="t"><joint joint="ja" coef="1"/></fixed></tendon><equality>',
        ),
        "holds joint 'ja'",
    ),
    "flexible": (
        '<mujoco><worldbody><flexcomp name="f" type="grid" count="3 3 1" spacing=".1 .1 .1" '
        'dim="2"/></worldbody></mujoco>',
        "has flexible bodies",
    ),
    "a crowd": (
        BODY.format("<joint/>", "").replace('name="a"', "").replace(
            "<body >", '<replicate count="501" offset="1 0 0"><body>'
        ).replace("</body>", "</body></replicate>"),
        "501 joints",
    ),
    "include from elsewhere": ('<mujoco><include file="../x.xml"/></mujoco>', "outside"),
    "include of a secret": ('<mujoco><include file="/etc/passwd"/></mujoco>', "outside"),
    "include of nothing": ('<mujoco><include file="x.xml"/></mujoco>', "cannot be read"),
    "include of itself": ('<mujoco><include file="robot.xml"/></mujoco>', "includes itself"),
    "two of one name": (
        MJCF.replace('<connect name="pin"', '<connect name="pin" body1="crank_link"/><connect'),
        "MuJoCo refuses it",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "says"), BAD.values(), ids=BAD)
def test_models_that_are_refused(make, text, says):
    with pytest.raises(MechanismError) as caught:
        load(make(text))
    message = str(caught.value)
    assert says in message
    assert "\n" not in message
    assert "robot.xml" in message


def test_includes_beside_the_model(make, tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "joint.xml").write_text(
        '<mujocoinclude><joint name="hinge"/></mujocoinclude>'
    )
    path = make(BODY.format('<include file="parts/joint.xml"/>', ""))
    assert load(path).driven == ("hinge",)
    (tmp_path / "parts" / "joint.xml").write_text('<!DOCTYPE x [<!ENTITY a "b">]><joint/>')
    with pytest.raises(MechanismError, match="document type"):
        load(path)


def test_warnings_are_notes_and_no_file(make, tmp_path, monkeypatch):
    """Left alone, MuJoCo prints them and writes MUJOCO_LOG.TXT into the folder one is in."""
    monkeypatch.chdir(tmp_path)
    make(
        '<mujoco model="c"><visual><map zfar="3"/></visual>'
        '<worldbody><body name="b"/></worldbody></mujoco>',
        "child.xml",
    )
    path = make(
        '<mujoco><visual><map zfar="9"/></visual><asset><model name="c" file="child.xml"/></asset>'
        '<worldbody><body name="a"><joint/><geom size="0.1"/>'
        '<attach model="c" body="b" prefix="x"/></body></worldbody></mujoco>'
    )
    mechanism = load(path)
    assert any(note.startswith("MuJoCo: ") for note in mechanism.notes)
    assert {p.name for p in tmp_path.iterdir()} == {"child.xml", "robot.xml"}


def test_without_mujoco(make, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MechanismError, match=r'pip install "ident\[mjcf\]"'):
        load(make(MJCF))
    assert load(ROBOTS / "arm").driven
