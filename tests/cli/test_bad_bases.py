"""Bases, balls and loops that are not what a file or a log says: refused, with what is missing."""

import numpy as np
import pytest

LINK = (
    '<link name="{0}"><inertial><mass value="{1}"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" '
    'ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><origin xyz="0 0 .1"/>'
    '<axis xyz="0 1 0"/>{4}</joint>'
)
LIMIT = '<limit lower="-1" upper="1" velocity="9" effort="9"/>'
FLOATING = 'base = { kind = "floating" }\n'


def robot(*parts):
    return f'<robot name="r">{"".join(parts)}</robot>'


BALL = robot(
    '<link name="world"/>', LINK.format("a", 1), JOINT.format("j", "ball", "world", "a", LIMIT)
)
LEGS = robot(
    LINK.format("trunk", 5),
    *(LINK.format(f"leg{i}", 1) for i in range(4)),
    *(JOINT.format(f"hip{i}", "revolute", "trunk", f"leg{i}", LIMIT) for i in range(4)),
)
DRONE = robot(LINK.format("body", 1.3))
TIP = (
    '<link name="tip"/><joint name="fix" type="fixed"><parent link="leg0"/><child link="tip"/>'
    "</joint></robot>"
)
CLOSURE = '[[closure]]\nname = "c"\nkind = "point"\na = {{ link = "{}" }}\nb = {{ link = "{}" }}\n'


@pytest.fixture
def machine(tmp_path):
    """`machine(urdf, toml)`: the folder of a mechanism."""

    def write(urdf, toml=""):
        (tmp_path / "r.urdf").write_text(urdf)
        (tmp_path / "mechanism.toml").write_text(f'urdf = "r.urdf"\n{toml}')
        return tmp_path

    return write


def log(folder, legs=0, moving=True):
    """Write the log of a base that moves, or almost stands, and of its legs."""
    t = np.arange(0, 10, 0.01)
    size = 0.2 if moving else 0.02
    columns = {f"base.{x}": size * np.sin((1.1 + 0.3 * i) * t) for i, x in enumerate("xyz")}
    columns |= {f"base.q{x}": np.zeros(len(t)) for x in "xyz"} | {"base.qw": np.ones(len(t))}
    for i in range(legs):
        columns[f"q.hip{i}"] = 0.3 * np.sin((1 + 0.2 * i) * t)
        columns[f"tau.hip{i}"] = np.sin((1.3 + 0.2 * i) * t)
    rows = np.column_stack([t, *columns.values()])
    header = ",".join(["t", *columns])
    np.savetxt(folder / "run.csv", rows, delimiter=",", header=header, comments="")
    return folder / "run.csv"


def test_a_ball_with_limits(machine, refused):
    words = ("r.urdf:1", "ball joint 'j'", "lower = -1", "revolute joints")
    refused(words, "check", machine(BALL))


@pytest.mark.parametrize(
    ("ends", "words"),
    [(("leg0", "leg0"), "of link 'leg0'"), (("leg0", "tip"), "'leg0' and 'tip' are one body")],
)
def test_a_loop_within_one_body(ends, words, machine, refused):
    folder = machine(LEGS.replace("</robot>", TIP), CLOSURE.format(*ends))
    refused(("mechanism.toml", "closure 1 ('c')", words), "check", folder)


def test_a_base_that_moves_and_is_not_declared(machine, refused):
    folder = machine(LEGS)
    words = ("run.csv", "base.x", 'base = { kind = "floating" }')
    refused(words, "identify", folder, log(folder, legs=4))


def test_a_drone_without_thrust(machine, refused):
    folder = machine(DRONE, FLOATING)
    refused(("run.csv", "no force", "wrench.body.fx"), "identify", folder, log(folder))


@pytest.mark.parametrize("moving", [True, False])
def test_a_quadruped_on_feet_without_force_sensors(moving, machine, refused):
    folder = machine(LEGS, FLOATING)
    words = ("run.csv", "no force", "wrench.trunk.fx", "forces of feet")
    refused(words, "identify", folder, log(folder, legs=4, moving=moving))


def test_a_rolling_base(machine, refused):
    """Wheels drive a chassis on the floor, and nothing says that they do not slip."""
    wheel = '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>{4}</joint>'
    wheels = "".join(
        wheel.format(f"hip{i}", "continuous", "trunk", f"leg{i}", '<axis xyz="0 1 0"/>')
        for i in range(2)
    )
    plane = wheel.format("floor", "planar", "world", "trunk", '<axis xyz="0 0 1"/>')
    links = (LINK.format(name, 1) for name in ("trunk", "leg0", "leg1"))
    folder = machine(robot('<link name="world"/>', *links, plane, wheels))
    t = np.arange(0, 10, 0.01)
    columns = {"t": t, "q.floor.x": np.sin(t), "q.floor.y": np.cos(0.7 * t)}
    columns["q.floor.rz"] = np.sin(0.4 * t)
    for i in range(2):
        columns[f"q.hip{i}"] = 9 * np.sin((1 + 0.2 * i) * t)
        columns[f"tau.hip{i}"] = np.sin((1.3 + 0.2 * i) * t)
    rows = np.column_stack([*columns.values()])
    np.savetxt(folder / "run.csv", rows, delimiter=",", header=",".join(columns), comments="")
    words = ("run.csv", "floor.x, floor.y", "no force", "[[closure]]")
    refused(words, "identify", folder, folder / "run.csv")
