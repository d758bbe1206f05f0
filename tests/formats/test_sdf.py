"""SDF models: against the URDF of the same machine, MuJoCo, and poses worked out by hand."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import ident
from formats import COUPLER, ROCKER, SDF
from helpers import ROBOTS
from ident.errors import MechanismError
from ident.mechanism import load
from ident.mechanism.parameters import regressor
from ident.mechanism.write import folder_files

PASSIVE = 'urdf = "robot.sdf"\n[joints]\npassive = ["coupler", "rocker"]\n'


PACKAGE = Path(__file__).parents[2] / "packages" / "ident_sdf"


@pytest.fixture(autouse=True)
def installed(install):
    """The package of the format, as its pyproject.toml states it."""
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    text = (PACKAGE / "ident_sdf.py").read_text("utf-8")
    install("ident_sdf", text, project["entry-points"]["ident.formats"])


@pytest.fixture
def make(tmp_path):
    """`make(text, toml)`: the mechanism of a model file, alone or with a mechanism.toml."""

    def write(text: str, toml: str = "", name: str = "robot.sdf"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        if not toml:
            return load(tmp_path / name)
        (tmp_path / "mechanism.toml").write_text(toml)
        return load(tmp_path)

    return write


def test_torques_are_those_of_the_urdf(make):
    """The four-bar's: an SDF's coordinates are zero where it is drawn."""
    sdf, urdf = make(SDF), load(ROBOTS / "four_bar")
    assert list(sdf.model.names) == list(urdf.model.names)
    zero = {"crank": 0.0, "coupler": COUPLER, "rocker": ROCKER}
    ref = np.array([zero[joint.name] for joint in sdf.joints if joint.in_tree])
    q, v, a = np.random.default_rng(0).normal(size=(3, 20, 3))
    np.testing.assert_allclose(
        regressor(sdf.model, q - ref, v, a) @ sdf.prior,
        regressor(urdf.model, q, v, a) @ urdf.prior,
        atol=1e-12,
    )


def test_the_joint_that_closes_a_loop_is_a_closure(make):
    mechanism = make(SDF, PASSIVE)
    assert [(c.name, c.kind) for c in mechanism.closures] == [("pin", "revolute")]
    assert mechanism.degrees_of_freedom == 1
    assert "joint 'pin' closes a loop" in mechanism.notes
    assert "closure.pin" in mechanism.joint_index
    np.testing.assert_allclose(
        mechanism.kinematics.closure_rows(np.zeros((1, 3))).value, 0, atol=1e-9
    )
    assert set(make(SDF).driven) == {"crank", "coupler", "rocker"}


@pytest.mark.parametrize("kind", ["ball", "universal"])
def test_a_ball_and_a_cross_joint_in_the_tree(make, kind):
    """The coupler hangs on the crank by one; the loop, a hinge, holds what it has more."""
    text = SDF.replace('name="coupler" type="revolute"', f'name="coupler" type="{kind}"')
    axis = '<axis2><xyz expressed_in="__model__">1 0 0</xyz></axis2></joint>'
    start = text.index(f'name="coupler" type="{kind}"')
    at = text.index("</joint>", start)
    mechanism = make(text[:at] + axis + text[at + len("</joint>") :], PASSIVE)
    suffixes = {"ball": (".rz", ".ry", ".rx"), "universal": (".1", ".2")}[kind]
    names = tuple(f"coupler{suffix}" for suffix in suffixes)
    assert [j.name for j in mechanism.joints if j.in_tree] == ["crank", *names, "rocker"]
    assert mechanism.driven == ("crank",)
    assert mechanism.degrees_of_freedom == 1
    assert not any("cross" in name for name in mechanism.unknown)


def test_identified_as_from_its_urdf(make):
    log = ident.read_log(ROBOTS / "four_bar" / "run.csv")
    fits = []
    for mechanism in (load(ROBOTS / "four_bar"), make(SDF, PASSIVE)):
        model = mechanism.with_effect("viscous").with_effect("coulomb")
        fits.append(ident.identify(model, ident.complete(model, log)))
    urdf, sdf = fits
    assert sdf.rank == urdf.rank
    assert sdf.train["crank"].rms == pytest.approx(urdf.train["crank"].rms, rel=1e-6)
    assert sdf["coulomb.crank.Fc"].value == pytest.approx(urdf["coulomb.crank.Fc"].value, rel=1e-5)


def test_a_ball_carries_nothing(make):
    """Written before the joint that carries the same link, it closes the loop all the same."""
    ends = "<parent>coupler_link</parent><child>rocker_link</child>"
    ball = f'<joint name="knob" type="ball">{ends}</joint>'
    text = SDF.replace('<joint name="crank"', f'{ball}<joint name="crank"')
    mechanism = make(text)
    assert [(c.name, c.kind) for c in mechanism.closures] == [
        ("knob", "point"),
        ("pin", "revolute"),
    ]
    assert [j.name for j in mechanism.joints if j.in_tree] == ["crank", "coupler", "rocker"]


def test_a_ring_of_joints(make):
    """All links are some joint's child: the first one is the ground, and its joint the loop's."""
    ring = SDF.replace(
        "<parent>world</parent><child>rocker_link", "<parent>rocker_link</parent><child>base"
    )
    ring = ring.replace("<parent>world", "<parent>base").replace(
        '<link name="crank_link">', '<link name="base"/><link name="crank_link">'
    )
    ring = ring.replace(
        '<joint name="rocker" type="revolute">',
        '<joint name="rocker" type="revolute"><pose relative_to="rocker_link"/>',
    )
    mechanism = make(ring, PASSIVE.replace('"rocker"', '"pin"'))
    assert "link 'base' is taken as the ground, where it stands at first" in mechanism.notes
    assert [(c.name, c.kind) for c in mechanism.closures] == [("rocker", "revolute")]
    log = ident.read_log(ROBOTS / "four_bar" / "run.csv")
    errors = []
    for model in (mechanism, make(SDF, PASSIVE)):
        fit = ident.identify(model, ident.complete(model, log))
        errors.append(fit.train["crank"].rms)
    assert errors[0] == pytest.approx(errors[1], rel=1e-6)


def test_commands_from_model_to_identified_folder(make, tmp_path, spoken):
    make(SDF, PASSIVE)
    log = ROBOTS / "four_bar" / "run.csv"
    status, _, err = spoken("identify", tmp_path, log, "--out", tmp_path / "out")
    assert status == 0, err
    known = load(tmp_path / "out" / "identified")
    assert known.urdf.name == "robot.urdf"
    assert [c.name for c in known.closures] == ["pin"]
    assert known.passive == ("coupler", "rocker")
    pin.buildModelFromUrdf(str(tmp_path / "out" / "identified.urdf"))


def test_a_grown_folder_is_the_same_machine(make, tmp_path):
    mechanism = make(SDF, PASSIVE)
    files = folder_files(mechanism, mechanism.urdf.read_bytes(), [], unknown=None, estimates={})
    (tmp_path / "grown").mkdir()
    for name, content in files.items():
        (tmp_path / "grown" / name).write_bytes(content)
    again = load(tmp_path / "grown")
    assert again.unknown == mechanism.unknown
    q = np.random.default_rng(0).normal(size=(5, 3))
    rows = [m.kinematics.closure_rows(q).value for m in (mechanism, again)]
    np.testing.assert_array_equal(*rows)


# --- poses --------------------------------------------------------------------------------------

POSES = """<sdf version="1.10"><model name="m"><pose>1 2 3 0 0 0.5</pose>
<link name="base"><pose>0.1 0 0 0.2 0 0</pose></link>
<frame name="mark" attached_to="base"><pose degrees="true">0 0 0.1 0 90 0</pose></frame>
<link name="arm"><pose relative_to="hinge">0.2 0 0 0 0 0.3</pose>
  <inertial><pose relative_to="mark">0 0.1 0 0.4 0 0</pose><mass>2</mass>
    <inertia><ixx>0.1</ixx><iyy>0.2</iyy><izz>0.25</izz><ixy>0.01</ixy></inertia></inertial>
  <visual name="v"><pose>0 0 0.5 0 0 0</pose>
    <geometry><box><size>1 2 3</size></box></geometry></visual>
</link>
<joint name="hinge" type="revolute"><pose relative_to="mark" rotation_format="quat_xyzw">
  0 0 0.3   0 0 0.6 0.8</pose><parent>mark</parent><child>arm</child>
  <axis><xyz expressed_in="base">0 3 0</xyz><limit><lower>-1</lower><upper>inf</upper>
    <effort>-1</effort><velocity>2</velocity></limit>
    <dynamics><damping>0.4</damping></dynamics></axis></joint>
<link name="finger"><pose relative_to="arm">0 0 0.4 0 0 0</pose></link>
<joint name="slide" type="prismatic"><parent>arm</parent><child>finger</child>
  <axis><xyz>1 0 0</xyz><mimic joint="hinge"><multiplier>0.5</multiplier><offset>0.2</offset>
    <reference>0.1</reference></mimic></axis></joint>
</model></sdf>
"""


def test_poses_by_hand(make):
    mechanism = make(POSES)
    R = pin.rpy.rpyToMatrix
    model = pin.SE3(R(0, 0, 0.5), np.array([1.0, 2, 3]))
    base = pin.SE3(R(0.2, 0, 0), np.array([0.1, 0, 0]))
    mark = base * pin.SE3(R(0, np.pi / 2, 0), np.array([0, 0, 0.1]))
    turn = pin.SE3(pin.Quaternion(0.8, 0.0, 0.0, 0.6).matrix(), np.array([0, 0, 0.3]))
    hinge = mark * turn
    arm = hinge * pin.SE3(R(0, 0, 0.3), np.array([0.2, 0, 0]))
    body = mark * pin.SE3(R(0.4, 0, 0), np.array([0, 0.1, 0]))
    tree, data = mechanism.model, mechanism.model.createData()
    pin.framesForwardKinematics(tree, data, np.zeros(2))

    def at(link):
        return data.oMf[tree.getFrameId(link, pin.FrameType.BODY)]

    assert at("base").isApprox(model * base, 1e-12)
    assert at("arm").isApprox(model * hinge, 1e-12)
    assert at("finger").isApprox(model * arm * pin.SE3(np.eye(3), np.array([0, 0, 0.4])), 1e-12)
    inertia = pin.Inertia(
        2.0, np.zeros(3), np.array([[0.1, 0.01, 0], [0.01, 0.2, 0], [0, 0, 0.25]])
    )
    truth = (hinge.inverse() * body).act(inertia)
    assert tree.inertias[tree.getJointId("hinge")].isApprox(truth, 1e-12)
    J = pin.computeFrameJacobian(
        tree, data, np.zeros(2), tree.getFrameId("arm", pin.FrameType.BODY), pin.WORLD
    )
    np.testing.assert_allclose(J[3:, 0], (model * base).rotation @ [0, 1, 0], atol=1e-12)

    joint = mechanism.joint("hinge")
    assert (joint.lower, joint.upper, joint.velocity, joint.effort) == (-1, np.inf, 2, np.inf)
    assert mechanism.passive == ("slide",)
    found = mechanism.kinematics.closure_rows(np.array([[0.7, 0.5 * (0.7 - 0.1) + 0.2]])).value
    np.testing.assert_allclose(found, 0, atol=1e-15)
    said = "\n".join(mechanism.notes)
    assert "link 'base' is taken as the ground" in said
    assert "damping of hinge is not taken over; to identify it: --with viscous:hinge" in said
    assert "arm: the link's origin is at its joint" in said
    assert "finger: no mass or inertia written, so SDF's 1 kg or 1 kg m² holds" in said
    finger = tree.inertias[tree.getJointId("slide")]
    assert finger.isApprox(pin.Inertia(1.0, np.zeros(3), np.eye(3)), 1e-12)


@pytest.mark.parametrize(
    ("version", "axis", "in_model"),
    [
        ("1.4", "<xyz>0 0 1</xyz>", True),
        ("1.6", "<xyz>0 0 1</xyz>", False),
        ("1.6", "<xyz>0 0 1</xyz><use_parent_model_frame>1</use_parent_model_frame>", True),
        ("1.7", "<xyz>0 0 1</xyz>", False),
        ("1.7", '<xyz expressed_in="__model__">0 0 1</xyz>', True),
    ],
)
def test_in_whose_axes_an_axis_is(make, version, axis, in_model):
    text = (
        f'<sdf version="{version}"><model name="m"><link name="a"><pose>0 0 0 1 0 0</pose></link>'
        f'<joint name="j" type="revolute"><parent>world</parent><child>a</child><axis>{axis}</axis>'
        "</joint></model></sdf>"
    )
    mechanism = make(text)
    model = mechanism.model
    J = pin.computeJointJacobians(model, model.createData(), np.zeros(1)).reshape(6, 1)
    turned = pin.rpy.rpyToMatrix(1, 0, 0) @ [0, 0, 1]
    np.testing.assert_allclose(J[3:, 0], [0, 0, 1] if in_model else turned, atol=1e-12)


KINDS = {"revolute": 5, "continuous": 5, "prismatic": 5, "fixed": 6, "ball": 3, "universal": 4}
LOOP = """<sdf version="1.9"><model name="m">
<link name="a"/><joint name="ja" type="revolute"><parent>world</parent><child>a</child>
  <axis><xyz>0 0 1</xyz></axis></joint>
<link name="b"><pose>0.3 0.1 0 0.1 0.2 0.3</pose></link>
<joint name="jb" type="revolute"><parent>a</parent><child>b</child><axis><xyz>0 1 0</xyz></axis></joint>
<joint name="close" type="{}"><pose>0.1 0.2 0.3 0.4 0.5 0.6</pose><parent>world</parent><child>b</child>
  <axis><xyz>1 2 0</xyz></axis><axis2><xyz>-2 1 0</xyz></axis2></joint></model></sdf>"""  # noqa: E501


@pytest.mark.parametrize(("kind", "rows"), KINDS.items())
def test_joints_that_close_loops(make, kind, rows):
    """Φ is zero as drawn; and its Jacobian is silent along what the joint allows."""
    mechanism = make(LOOP.format(kind))
    (closure,) = mechanism.closures
    found = mechanism.kinematics.closure_rows(np.zeros((1, 2)))
    assert found.value.shape == (1, rows)
    np.testing.assert_allclose(found.value, 0, atol=1e-12)
    assert closure.a.link == "world"
    axis = closure.a.placement.rotation[:, 0 if kind == "universal" else 2]
    joint = pin.rpy.rpyToMatrix(0.1, 0.2, 0.3) @ pin.rpy.rpyToMatrix(0.4, 0.5, 0.6)
    if kind in ("revolute", "continuous", "prismatic", "universal"):
        np.testing.assert_allclose(axis, joint @ np.array([1, 2, 0]) / np.sqrt(5), atol=1e-12)
    if kind == "universal":
        second = closure.b.placement.rotation[:, 1]
        np.testing.assert_allclose(
            second,
            pin.rpy.rpyToMatrix(0.4, 0.5, 0.6) @ np.array([-2, 1, 0]) / np.sqrt(5),
            atol=1e-12,
        )


# --- refused ------------------------------------------------------------------------------------

EDITS = {
    "truncated": ("</sdf>", "", "no well-formed XML"),
    "document type": ('<?xml version="1.0"?>', "<!DOCTYPE sdf>", "document type"),
    "no model": ('<model name="four_bar">', '<model name="x"><static>1</static>', "none"),
    "two models": ("<static>true</static>", "", "2 models that are not static"),
    "include": ('<model name="four_bar">', '<model name="m"><include/>', "<include> within"),
    "nested": ('<model name="four_bar">', '<model name="m"><model name="n"/>', "<model> within"),
    "two of one name": ('<link name="rocker_link">', '<link name="crank_link">', "as another is"),
    "no name": ('<link name="rocker_link">', "<link>", "has no name"),
    "no child": ("<child>crank_link</child>", "", "joint 'crank' has no <child>"),
    "unknown child": ("<child>rocker_link</child>", "<child>rod</child>", "'rod'"),
    "unknown parent": ("<parent>crank_link</parent>", "<parent>x</parent>", "'x'"),
    "scoped": ("<parent>crank_link</parent>", "<parent>a::b</parent>", "model within the model"),
    "unknown type": ('name="pin" type="revolute"', 'name="pin" type="revolut"', "did you mean"),
    "screw": ('name="crank" type="revolute"', 'name="crank" type="screw"', "of type 'screw'"),
    "pose of five": ("0.4 0 0 0 -1.2", "0.4 0 0 -1.2", "6 finite numbers expected"),
    "pose in words": ("0.4 0 0 0 -1.2", "here 0 0 0 -1.2", "6 finite numbers expected"),
    "infinite mass": ("<mass>0.708</mass>", "<mass>inf</mass>", "1 finite number expected"),
    "negative mass": ("<mass>0.708</mass>", "<mass>-1</mass>", "-1 kg; it must be"),
    "no axis": ('<axis><xyz expressed_in="__model__">0 -1 0</xyz></axis>', "", "has no <axis>"),
    "zero axis": ("0 -1 0</xyz>", "0 0 0</xyz>", "give a direction"),
    "unknown frame": ('relative_to="coupler_link"', 'relative_to="copler_link"', "did you mean"),
    "old frame": ('relative_to="coupler_link"', 'frame="coupler_link"', "before 1.7"),
    "a ring of poses": (
        '<link name="rocker_link"><pose>', '<link name="rocker_link"><pose relative_to="rocker">',
        "refer to each other in a ring",
    ),
    "a joint to itself": ("<parent>crank_link</parent>", "<parent>coupler_link</parent>", "leads"),
    "a joint to the world": (
        "<parent>world</parent><child>crank_link</child>",
        "<parent>crank_link</parent><child>world</child>", "its child must be another link",
    ),
    "an inertia to be worked out": (
        '"rocker_link"><pose>', '"rocker_link"><inertial auto="true"/><pose>', "worked out",
    ),
    "a body that hangs free": (
        "</model></world>", '<link name="loose"/></model></world>', "it would hang free",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "says"), EDITS.values(), ids=EDITS)
def test_models_with_one_fault(make, old, new, says):
    assert old in SDF
    with pytest.raises(MechanismError) as caught:
        make(SDF.replace(old, new, 1))
    message = str(caught.value)
    assert says in message
    assert "\n" not in message
    assert "robot.sdf" in message


def test_a_file_that_is_no_sdf(make, tmp_path):
    with pytest.raises(MechanismError, match="the root element is <gazebo>"):
        make("<gazebo/>")
    with pytest.raises(MechanismError, match="no such file"):
        load(Path(tmp_path / "none.sdf"))
