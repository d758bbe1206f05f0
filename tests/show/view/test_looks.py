"""Meshes where they are, a note where they are not, and names that try to be markup."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ident

CUBE = """solid cube
facet normal 0 0 1
 outer loop
  vertex 0 0 0
  vertex 2 0 0
  vertex 0 2 0
 endloop
endfacet
facet normal 0 1 0
 outer loop
  vertex 0 0 0
  vertex 0 0 2
  vertex 2 0 0
 endloop
endfacet
endsolid cube
"""
ROBOT = """<robot name="r">
  <material name="brass"><color rgba="0.8 0.6 0.2 1"/></material>
  <link name="base"/>
  <link name="arm"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0"
    izz="1"/></inertial>VISUAL</link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="0 0 1"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>"""


def arm(folder: Path, visual: str) -> ident.Mechanism:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "r.urdf").write_text(ROBOT.replace("VISUAL", visual))
    return ident.load(folder / "r.urdf")


def mesh(name: str, scale: str = "1 1 1") -> str:
    return (
        '<visual><origin xyz="0 0 0.5" rpy="0 0 1.5707963267948966"/><geometry>'
        f'<mesh filename="{name}" scale="{scale}"/></geometry><material name="brass"/></visual>'
    )


def bodies(view) -> list:
    return [x for x in view.shapes if x.kind == "body"]


@pytest.mark.parametrize(
    "name",
    [
        "meshes/part.stl",
        "package://robot_description/meshes/part.stl",
        "file://HERE",
        "file://localhostHERE",
    ],
)
def test_meshes_are_found_scaled_placed_and_coloured(tmp_path, name):
    package = tmp_path / "robot_description"
    (package / "urdf" / "meshes").mkdir(parents=True)
    (package / "meshes").mkdir()
    for place in (package / "urdf" / "meshes", package / "meshes"):
        (place / "part.stl").write_text(CUBE)
    name = name.replace("HERE", str(package / "meshes" / "part.stl"))
    view = arm(package / "urdf", mesh(name, "0.1 0.2 0.3")).view()
    assert view.notes == ()
    (shape,) = bodies(view)
    assert shape.colour == (204, 153, 51)
    # (x, y, z) of the file is scaled, turned by 90° about z and lifted
    vertices = shape.corners
    np.testing.assert_allclose(vertices.min(axis=0), [-0.4, 0, 0.5], atol=1e-12)
    np.testing.assert_allclose(vertices.max(axis=0), [0, 0.2, 1.1], atol=1e-12)


@pytest.mark.parametrize(
    ("visual", "word"),
    [
        (mesh("gone.stl"), "gone.stl"),
        (mesh("package://nowhere/gone.dae"), "gone.dae"),
        (mesh("https://example.org/part.stl"), "no mesh"),
        (mesh("file:///etc/hostname"), "valid: .stl"),
        (mesh("x" * 5000 + ".stl"), "no mesh"),
        (mesh("r.urdf"), "valid: .stl"),
        (mesh("http://[.stl"), "no mesh"),
        ("<visual><geometry><torus/></geometry></visual>", "no box"),
        ("<visual/>", "no box"),
        ('<visual><geometry><box size="1 1"/></geometry></visual>', "3 finite numbers"),
        ('<visual><geometry><sphere radius="-1"/></geometry></visual>', "above 0"),
    ],
)
def test_what_cannot_be_shown_is_a_note(tmp_path, visual, word):
    view = arm(tmp_path, visual).view()
    (note,) = view.notes
    assert "link 'arm'" in note
    assert word in note
    assert bodies(view)  # its inertia stands in


def test_several_missing_meshes_are_one_note(tmp_path):
    (note,) = arm(tmp_path, mesh("package://p/a.stl") + mesh("b.stl")).view().notes
    assert "2 shapes are left out" in note
    assert "--mesh-path" in note


@pytest.mark.parametrize(("inside", "count"), [("a/b", 0), ("a/b/c", 1)])
def test_a_renamed_package_is_at_most_three_folders_above(tmp_path, inside, count):
    (tmp_path / "part.stl").write_text(CUBE)
    assert len(arm(tmp_path / inside, mesh("package://p/part.stl")).view().notes) == count


def test_packages_are_found_where_the_environment_says(tmp_path, monkeypatch):
    (tmp_path / "elsewhere" / "p").mkdir(parents=True)
    (tmp_path / "elsewhere" / "p" / "part.stl").write_text(CUBE)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "elsewhere"))
    assert arm(tmp_path / "own", mesh("package://p/part.stl")).view().notes == ()


def test_a_mesh_that_is_none_is_a_note(tmp_path):
    (tmp_path / "part.stl").write_bytes(b"\x00" * 10)
    (note,) = arm(tmp_path, mesh("part.stl")).view().notes
    assert "part.stl" in note


def test_names_are_never_markup(robots, tmp_path):
    evil = '"><img src=x onerror="alert(1)">'
    text = (robots / "four_bar" / "four_bar.urdf").read_text()
    escaped = evil.replace('"', "&quot;").replace("<", "&lt;").replace(">", "&gt;")
    (tmp_path / "four_bar.urdf").write_text(text.replace("rocker_link", f"../{escaped}"))
    toml = (robots / "four_bar" / "mechanism.toml").read_text()
    toml = toml.replace('"rocker_link"', f"'../{evil}'")
    (tmp_path / "mechanism.toml").write_text(toml)
    view = ident.load(tmp_path).view()
    assert evil in view.mechanism.closures[0].b.link
    assert "onerror=" in view.html
    assert "<img" not in view.html.split("</head>")[-1]
    assert "&lt;img" in view.html
