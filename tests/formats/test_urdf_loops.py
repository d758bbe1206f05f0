"""Dialects of URDF with loops: each states one four-bar, and closes as a drawn one does."""

import numpy as np
import pinocchio
import pytest

import ident
from ident.errors import MechanismError
from ident.mechanism.load import source_of
from ident.mechanism.write import understood_files

A, B, C, D = 0.10, 0.40, 0.25, 0.38  # m: crank, coupler, rocker, ground


def link(name, mass=1.0):
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/><origin xyz="0.05 0 0.01"/>'
        '<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.002"/></inertial></link>'
    )


def joint(name, parent, child, x, kind="continuous", more="", limits=""):
    return (
        f'<joint name="{name}" type="{kind}" {more}><parent link="{parent}"/>'
        f'<child link="{child}"/>'
        f'<origin xyz="{x} 0 0"/><axis xyz="0 -1 0"/>{limits}</joint>'
    )


def four_bar(loop="", frames=False, more="", kind="continuous", limits="", coupler="coupler"):
    parts = [
        '<link name="base"/>', *map(link, ("crank_link", "coupler_link", "rocker_link")),
        joint("crank", "base", "crank_link", 0, kind, more and 'independent="true"', limits),
        joint(coupler, "crank_link", "coupler_link", A, kind, more, limits),
        joint("rocker", "base", "rocker_link", D, kind, more, limits),
    ]  # fmt: skip
    if frames:
        parts += [
            '<link name="end_a"/><link name="end_b"/>',
            joint("pin_a", "coupler_link", "end_a", B, "fixed"),
            joint("pin_b", "rocker_link", "end_b", C, "fixed"),
        ]
    return f'<robot name="four_bar">{"".join(parts)}{loop}</robot>'


CONSTRAINT = (
    '<constraint name="pin" type="revolute"><parent link="coupler_link"/>'
    f'<parent_origin xyz="{B} 0 0"/><parent_axis xyz="0 -1 0"/><child link="rocker_link"/>'
    f'<child_origin xyz="{C} 0 0"/><child_axis xyz="0 -1 0"/></constraint>'
)
PLUS = (
    f'<loop name="pin" type="revolute"><predecessor link="coupler_link"><origin xyz="{B} 0 0"/>'
    f'</predecessor><successor link="rocker_link"><origin xyz="{C} 0 0"/></successor>'
    '<axis xyz="0 -1 0"/></loop>'
)
YAML = "closed_loop: [['pin_a', 'pin_b']]\ntype: ['3D']\nname_mot: ['crank']\n"


def rocker_angle(crank):
    """The rocker's angle by the triangle of the diagonal (the open branch)."""
    x, z = A * np.cos(crank) - D, A * np.sin(crank)
    e = np.hypot(x, z)
    return np.arctan2(z, x) - np.arccos((C**2 + e**2 - B**2) / (2 * C * e))


@pytest.fixture
def write(tmp_path):
    def at(urdf, yaml=""):
        (tmp_path / "robot.urdf").write_text(urdf)
        if yaml:
            (tmp_path / "robot.yaml").write_text(yaml)
        return tmp_path / "robot.urdf"

    return at


LIMITS = '<limit lower="0" upper="0" effort="0" velocity="0"/>'
CASES = {
    "Extended URDF": (four_bar(frames=True, kind="revolute", limits=LIMITS), YAML, "point"),
    "URDF with constraints": (four_bar(CONSTRAINT), "", "revolute"),
    "URDF+": (four_bar(PLUS, more='independent="false"'), "", "revolute"),
}


@pytest.mark.parametrize("dialect", CASES)
def test_a_dialect_closes_the_loop(dialect, write):
    urdf, yaml, kind = CASES[dialect]
    mechanism = ident.load(write(urdf, yaml))
    assert source_of(mechanism).format == dialect
    assert [closure.kind for closure in mechanism.closures] == [kind]
    assert mechanism.degrees_of_freedom == 1
    q = mechanism.assembled
    at = {joint.name: q[joint.index] for joint in mechanism.joints if joint.in_tree}
    angles = np.array([at["rocker"] - rocker_angle(at["crank"]), at["rocker"]])
    other = 2 * np.arctan2(A * np.sin(at["crank"]), A * np.cos(at["crank"]) - D) - at["rocker"]
    mirrored = other - rocker_angle(at["crank"])
    assert min(abs(np.sin(angles[0] / 2)), abs(np.sin(mirrored / 2))) < 1e-8
    if dialect != "URDF with constraints":  # which does not say what is driven
        assert mechanism.driven == ("crank",)
    else:
        assert any("passive" in note for note in mechanism.notes)
    assert np.isinf([joint.upper for joint in mechanism.joints]).all()


@pytest.mark.parametrize("dialect", CASES)
def test_what_was_understood_is_a_mechanism(dialect, write, tmp_path):
    mechanism = ident.load(write(*CASES[dialect][:2]))
    folder = tmp_path / "understood"
    folder.mkdir()
    for name, content in understood_files(mechanism).items():
        (folder / name).write_bytes(content)
    again = ident.load(folder)
    assert not again.found_start
    assert [j.name for j in again.joints] == [j.name for j in mechanism.joints]
    assert (again.driven, again.unknown) == (mechanism.driven, mechanism.unknown)
    np.testing.assert_allclose(again.assembled, mechanism.assembled, atol=2e-6)
    np.testing.assert_allclose(again.prior, mechanism.prior)


@pytest.mark.usefixtures("short_search")
def test_types_of_joints(write):
    yaml = YAML + "joint_name: ['coupler', 'rocker']\njoint_type: ['SPHERICAL', 'UJOINT_YZ']\n"
    mechanism = ident.load(write(four_bar(frames=True), yaml))
    names = ["crank", "coupler.rx", "coupler.ry", "coupler.rz", "rocker_Y", "rocker_Z"]
    assert len(mechanism.idle) == 1  # the coupler's turn about itself
    names = [name for name in names if name not in mechanism.idle]
    assert [joint.name for joint in mechanism.joints] == names
    assert mechanism.passive == tuple(names[1:])
    assert not any(".rx_link" in name for name in mechanism.unknown)
    yaml = YAML + "joint_name: ['rocker']\njoint_type: ['FIXED']\n"
    mechanism = ident.load(write(four_bar(frames=True), yaml))
    assert [joint.name for joint in mechanism.joints] == ["crank", "coupler"]


def test_names_say_what_a_file_without_types_leaves_out(write):
    """The generator of robot.yaml makes balls of joints that are called so."""
    urdf = four_bar(frames=True, coupler="spherical_coupler")
    mechanism = ident.load(write(urdf, YAML))
    names = ["crank", *(f"spherical_coupler.r{axis}" for axis in "xyz"), "rocker"]
    assert len(mechanism.idle) == 1
    assert [joint.name for joint in mechanism.joints] == [
        name for name in names if name not in mechanism.idle
    ]
    assert any("write joint_name: []" in note for note in mechanism.notes)
    hinges = ident.load(write(urdf, YAML + "joint_name: []\njoint_type: []\n"))
    assert [joint.name for joint in hinges.joints] == ["crank", "spherical_coupler", "rocker"]


def test_a_coupling_is_a_ratio(write):
    coupling = (
        '<coupling name="gear"><predecessor link="crank_link"/><successor link="rocker_link"/>'
        '<ratio value="6.0"/></coupling>'
    )
    mechanism = ident.load(write(four_bar(coupling)))
    (gear,) = mechanism.closures
    assert (gear.joints, gear.ratios) == (("rocker", "crank"), (1.0, -6.0))
    assert mechanism.passive == ("rocker",)


@pytest.mark.parametrize(
    ("yaml", "line", "words"),
    [
        (YAML.replace("crank'", "krank'"), 3, ("krank", "crank")),
        (YAML.replace("pin_b", "pin_c"), 1, ("pin_c", "pin_b")),
        (YAML.replace("3D", "4D"), 2, ("4d", "3d")),
        (YAML + "joint_name: ['roker']\njoint_type: ['FIXED']\n", 4, ("roker", "rocker")),
        (YAML + "joint_name: ['rocker']\njoint_type: ['BALL']\n", 5, ("BALL", "SPHERICAL")),
        (YAML.replace("pin_b", "pin_a"), 1, ("both frames",)),
        (YAML.replace("['3D']", "['3d', '3d']"), None, ("1 closed_loop and 2 type",)),
        ("closed_loop: [[", None, ("no valid YAML",)),
    ],
)
def test_what_is_not_there_is_an_error_with_its_line(yaml, line, words, write):
    with pytest.raises(MechanismError) as error:
        ident.load(write(four_bar(frames=True), yaml))
    assert all(word in str(error.value) for word in words), str(error.value)
    assert "\n" not in str(error.value)
    assert line is None or f"robot.yaml:{line}:" in str(error.value)


@pytest.mark.parametrize(
    ("urdf", "words"),
    [
        (
            four_bar(CONSTRAINT.replace('"rocker_link"', '"roker_link"')),
            ("roker_link", "rocker_link"),
        ),
        (four_bar(CONSTRAINT.replace('"rocker_link"', '"coupler_link"')), ("itself",)),
        (four_bar(PLUS.replace('type="revolute"', 'type="screw"')), ("screw",)),
    ],
)
def test_a_loop_between_what_is_not_there(urdf, words, write):
    with pytest.raises(MechanismError) as error:
        ident.load(write(urdf))
    assert all(word in str(error.value) for word in words), str(error.value)


def test_closures_of_mechanism_toml_come_before_a_file_beside(write, tmp_path):
    write(four_bar(frames=True), YAML)
    (tmp_path / "mechanism.toml").write_text(
        'urdf = "robot.urdf"\njoints = { passive = ["coupler", "rocker"] }\n'
        '[[closure]]\nname = "own"\nkind = "point"\n'
        'a = { link = "end_a" }\nb = { link = "end_b" }\n'
    )
    mechanism = ident.load(tmp_path)
    assert [closure.name for closure in mechanism.closures] == ["own"]
    assert any("robot.yaml" in note for note in mechanism.notes)


def test_a_start_is_searched_and_can_be_kept(write, tmp_path):
    """A hinge whose axes point apart has no gap in its equations; it is none that closes."""
    yaml = "joint_name: ['coupler']\njoint_type: ['SPHERICAL']\nname_mot: ['crank']\n"
    write(four_bar(frames=True), yaml)
    folder = tmp_path / "ball"
    folder.mkdir()
    for name, content in understood_files(ident.load(tmp_path / "robot.urdf")).items():
        (folder / name).write_bytes(content)
    toml = (
        (folder / "mechanism.toml")
        .read_text()
        .replace("[joints]", "[joints]\nstart = { crank = 1.0, 'coupler.rx' = 3.141592653589793 }")
    )
    turned = "rpy = [1.5707963267948966, 0, 0]"
    (folder / "mechanism.toml").write_text(
        toml + '[[closure]]\nname = "pin"\nkind = "revolute"\n'
        f'a = {{ link = "end_a", {turned} }}\nb = {{ link = "end_b", {turned} }}\n'
    )
    mechanism = ident.load(folder)
    (pin,), q = mechanism.closures, mechanism.assembled
    tree = {joint.name for joint in mechanism.joints if joint.in_tree}
    assert mechanism.found_start.keys() == tree
    data = mechanism.model.createData()
    pinocchio.forwardKinematics(mechanism.model, data, q)
    z_a, z_b = ((data.oMi[f.joint] * f.placement).rotation[:, 2] for f in pin.frames)
    assert z_a @ z_b == pytest.approx(1.0)
