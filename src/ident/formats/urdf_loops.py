"""Loops, motors and ball joints that URDFs state in one of three dialects.

* Extended URDF (V. Lutz et al., arXiv 2504.04767): `robot.yaml` beside the URDF, with `closed_loop`
  (pairs of frames, by the names of joints or links), `type` (3d or 6d), `name_mot`, and
  `joint_name`, `joint_type` of joints that are no revolute ones: SPHERICAL, UJOINT_XY …, FIXED;
* `<constraint>` of urdfdom: parent, child, and an origin and an axis of each;
* URDF+ (M. Chignoli et al., arXiv 2411.19753): `<loop>` and `<coupling>` between a predecessor and
  a successor link, `independent="true"` of joints.

Each reader changes a `<robot>` in place and returns an `Extension`, None where there is nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.errors import MechanismError, one_of
from ident.files import regular
from ident.lazy import lazy
from ident.mechanism.chains import AXES, replace_joint
from ident.mechanism.description import UNLIMITED, Extension, align_z, attribute, refuse
from ident.mechanism.urdf import place_table

if TYPE_CHECKING:
    import yaml
else:
    yaml = lazy("yaml")

LARGEST = 1_000_000  # work: bytes of a robot.yaml
BALL = "spherical"  # in names of joints, by the convention of the format's own generator
HINGES = ("revolute", "continuous")
MASSLESS = 1e-4  # range: [kg] that exporters give to frames
LOOP_TYPES = {"3d": "point", "6d": "fixed"}
KEYS = ("closed_loop", "type", "name_mot", "joint_name", "joint_type")
KINDS = {  # types of joints that close a loop, and the kind of closure
    "revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed",
    "ball": "point", "spherical": "point", "point": "point", "universal": "universal",
    "planar": "planar", "cylindrical": "cylindrical",
}  # fmt: skip


def _moving(robot: etree._Element) -> list[str]:
    return [joint.get("name") for joint in robot.findall("joint") if joint.get("type") != "fixed"]


def _actuated(robot: etree._Element) -> set[str]:
    """Return the joints with a transmission or a command interface, as ROS has them."""
    names = {joint.get("name") for joint in robot.iterfind("transmission/joint")}
    controlled = robot.iterfind("ros2_control/joint[command_interface]")
    return {*names, *(joint.get("name") for joint in controlled)} & {*_moving(robot)}


def _massless(robot: etree._Element) -> list[str]:
    """Return links that move and have, with all that is fixed to them, no mass: frames."""
    fixed: dict[str, list[str]] = {}
    for joint in robot.findall("joint[@type='fixed']"):
        ends = [joint.find(end).get("link") for end in ("parent", "child")]
        fixed.setdefault(ends[0], []).append(ends[1])
    masses = {
        link.get("name"): float(link.find("inertial/mass").get("value"))
        for link in robot.findall("link")
        if link.find("inertial/mass") is not None
    }

    def mass(link: str) -> float:
        return masses.get(link, 0.0) + sum(map(mass, fixed.get(link, [])))

    links = (
        j.find("child").get("link") for j in robot.findall("joint") if j.get("type") != "fixed"
    )
    return [link for link in links if mass(link) <= MASSLESS]


def _passive(driven: Sequence[str], robot: etree._Element) -> tuple[tuple[str, ...], list[str]]:
    """Return joints without a motor, where something says which have one; else a note."""
    if driven:
        return tuple(name for name in _moving(robot) if name not in driven), []
    return (), [
        "no motors are stated, so every joint counts as driven: name the others in "
        "[joints] passive of a mechanism.toml"
    ]


# --- Extended URDF --------------------------------------------------------------------------------


class _Yaml:
    """A robot.yaml: lists of words with their lines."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if regular(path).stat().st_size > LARGEST:
                raise MechanismError(f"{path}: has more than {LARGEST} bytes")
            node = yaml.compose(path.read_text("utf-8"), Loader=yaml.SafeLoader)
        except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
            what = " ".join(str(error).split())[:200]
            raise MechanismError(f"{path}: is no valid YAML: {what}; correct it") from None
        pairs = node.value if isinstance(node, yaml.MappingNode) else []
        self.nodes = {str(key.value): value for key, value in pairs}

    def refuse(self, node: yaml.Node, message: str) -> NoReturn:
        """Raise MechanismError with the line of a node."""
        raise MechanismError(f"{self.path}:{node.start_mark.line + 1}: {message}")

    def items(self, key: str) -> list[yaml.Node]:
        """Return the items of a list; none where the key is not there."""
        node = self.nodes.get(key)
        if node is None:
            return []
        if not isinstance(node, yaml.SequenceNode):
            self.refuse(node, f"{key} is no list; write {key}: [...]")
        return list(node.value)

    def word(self, node: yaml.Node) -> str:
        """Return a text."""
        if not isinstance(node, yaml.ScalarNode):
            self.refuse(node, "a name is expected here")
        return str(node.value)


def read_extended(robot: etree._Element, path: Path, sidecars: bool) -> Extension | None:
    """Read the robot.yaml (or <name>.yaml) of Extended URDF that is beside a URDF."""
    for name in ("robot.yaml", f"{path.stem}.yaml"):
        file = path.parent / name
        if file.is_file():
            content = _Yaml(file)
            if {*content.nodes} & {"closed_loop", "name_mot", "joint_type"}:
                break
    else:
        return None
    if not sidecars:
        note = f"{file.name} beside it is not read, as mechanism.toml states its own closures"
        return Extension("", notes=(note,))
    return _ExtendedUrdf(robot, path, content).extension()


class _ExtendedUrdf:
    """A `<robot>` that becomes what a robot.yaml says of it."""

    def __init__(self, robot: etree._Element, path: Path, content: _Yaml) -> None:
        self.robot, self.path, self.content = robot, path, content
        self.joints = {joint.get("name"): joint for joint in robot.findall("joint")}
        self.links = [link.get("name") for link in robot.findall("link")]
        self.children = {x: joint.find("child").get("link") for x, joint in self.joints.items()}
        self.auxiliary: list[str] = []
        self.chained: list[str] = []

    def extension(self) -> Extension:
        """Return loops, motors and massless links."""
        if unread := [key for key in self.content.nodes if key not in KEYS]:
            note = f"{self.content.path.name}: not read: {', '.join(unread)}"
            notes = [note]
        else:
            notes = []
        notes += self._types()
        closures = self._loops()
        unlimited = [joint for joint in self.robot.findall("joint") if self._unlimited(joint)]
        for joint in unlimited:
            limit = joint.find("limit")
            limit = etree.SubElement(joint, "limit") if limit is None else limit
            for key in ("lower", "upper", "effort", "velocity"):
                if not float(limit.get(key, 0)):
                    limit.set(key, f"{-UNLIMITED if key == 'lower' else UNLIMITED}")
        if unlimited:
            notes.append(f"limits of 0 to 0 of {len(unlimited)} joints count as none")
        motors = self._motors()
        passive, more = _passive(motors, self.robot)
        massless = [link for link in _massless(self.robot) if link not in self.auxiliary]
        if closures:
            count = f"{len(closures)} loop{'s' * (len(closures) > 1)}"
            notes.insert(
                0, f"{self.content.path.name} beside it is read: {count}, {len(motors)} motors"
            )
        everything = (*self.auxiliary, *massless)
        return Extension("Extended URDF", tuple(closures), passive, everything, (*notes, *more))

    def _unlimited(self, joint: etree._Element) -> bool:
        """Return whether a joint has the limits 0 to 0, as exporters write where it has none."""
        if joint.get("type") not in ("revolute", "prismatic"):
            return False
        limits = (attribute(joint, "limit", key, str(self.path)) for key in ("lower", "upper"))
        return not any(value for (value,) in limits)

    def _types(self) -> list[str]:
        """Make the joints what they are said to be; return a note where only their names say it."""
        if not {"joint_name", "joint_type"} & {*self.content.nodes}:
            return self._balls_by_name()
        names, kinds = (self.content.items(key) for key in ("joint_name", "joint_type"))
        if len(names) != len(kinds):
            raise MechanismError(
                f"{self.content.path}: {len(names)} joint_name and {len(kinds)} joint_type; give "
                "one type for each name"
            )
        for name_node, kind_node in zip(names, kinds, strict=True):
            name, kind = self.content.word(name_node), self.content.word(kind_node).upper()
            if name not in self.joints:
                what = f"joint_name: the URDF has no joint '{name}'"
                self.content.refuse(name_node, f"{what}; {one_of(name, self.joints)}")
            joint = self.joints[name]
            if kind == "FIXED":
                joint.set("type", "fixed")
                etree.strip_elements(joint, "axis", "limit", "mimic", with_tail=False)
            elif kind == "SPHERICAL":
                self._make_ball(joint)
            elif kind.startswith("UJOINT_") and {*kind[7:].lower()} <= {*AXES} and len(kind) == 9:
                steps = [(axis, "revolute", AXES[axis.lower()]) for axis in kind[7:]]
                self.auxiliary += replace_joint(self.robot, joint, steps, "_")
                self.chained.append(name)
            else:
                valid = ("SPHERICAL", "FIXED", "UJOINT_XY", "UJOINT_YZ", "UJOINT_ZX")
                self.content.refuse(kind_node, f"joint_type '{kind}'; {one_of(kind, valid)}")

        return []

    def _make_ball(self, joint: etree._Element) -> None:
        steps = [(f"r{axis}", "revolute", AXES[axis]) for axis in "xyz"]
        self.auxiliary += replace_joint(self.robot, joint, steps)
        self.chained.append(joint.get("name"))

    def _balls_by_name(self) -> list[str]:
        """Make balls of hinges whose names say so, as the format's generator of robot.yaml does."""
        motors = {self.content.word(node) for node in self.content.items("name_mot")}
        balls = [
            joint
            for name, joint in self.joints.items()
            if BALL in name and name not in motors and joint.get("type") in HINGES
        ]
        for joint in balls:
            self._make_ball(joint)
        if not balls:
            return []
        return [
            f"{self.content.path.name} has no joint_name: {len(balls)} joints with '{BALL}' in "
            f"their names are balls (the first: {balls[0].get('name')}), as the format's generator "
            "writes them; write joint_name: [] and joint_type: [] there to keep hinges"
        ]

    def _loops(self) -> list[dict[str, Any]]:
        loops, types = (self.content.items(key) for key in ("closed_loop", "type"))
        if len(loops) != len(types):
            raise MechanismError(
                f"{self.content.path}: {len(loops)} closed_loop and {len(types)} type; give one "
                "type (3d or 6d) for each loop"
            )
        closures = []
        for i, (loop, type_node) in enumerate(zip(loops, types, strict=True), 1):
            if not isinstance(loop, yaml.SequenceNode) or len(loop.value) != 2:
                self.content.refuse(loop, "closed_loop: two frames are expected, [A, B]")
            kind = self.content.word(type_node).lower()
            if kind not in LOOP_TYPES:
                self.content.refuse(type_node, f"type '{kind}'; {one_of(kind, LOOP_TYPES)}")
            a, b = map(self._frame, loop.value)
            if a == b:
                self.content.refuse(loop, f"closed_loop: both frames are of link '{a}'")
            table = {"name": f"loop{i}", "kind": LOOP_TYPES[kind]}
            closures.append(table | {"a": {"link": a}, "b": {"link": b}})
        return closures

    def _frame(self, node: yaml.Node) -> str:
        """Return the link of a frame: of a joint, the link that it carries."""
        name = self.content.word(node)
        if name not in self.children and name not in self.links:
            what = f"closed_loop: the URDF has no joint or link '{name}'"
            self.content.refuse(node, f"{what}; {one_of(name, [*self.children, *self.links])}")
        return self.children.get(name, name)

    def _motors(self) -> list[str]:
        moving = _moving(self.robot)
        motors = []
        for node in self.content.items("name_mot"):
            name = self.content.word(node)
            if name not in moving:
                why = "is fixed" if name in self.joints else "is no joint of the URDF"
                why = "turns about several axes" if name in self.chained else why
                self.content.refuse(node, f"name_mot: '{name}' {why}; {one_of(name, moving)}")
            motors.append(name)
        return motors


# --- loops within the URDF ------------------------------------------------------------------------


def _closure(
    name: str, kind: str, ends: Sequence[tuple[str, pin.SE3, np.ndarray]]
) -> dict[str, Any]:
    """Return the table [[closure]] of a joint between two frames, each with its axis."""
    tables = []
    for i, (link, placement, axis) in enumerate(ends):
        R = np.eye(3)
        if kind in ("revolute", "prismatic", "cylindrical", "planar"):
            R = align_z(axis)
        elif kind == "universal":  # a's x and b's y stay at right angles
            z_first = align_z(axis)
            R = z_first[:, [2, 0, 1]] if i == 0 else z_first[:, [1, 2, 0]]
        tables.append(place_table(link, placement * pin.SE3(R, np.zeros(3))))
    return {"name": name, "kind": kind, "a": tables[0], "b": tables[1]}


def _origin(element: etree._Element | None, where: str) -> pin.SE3:
    if element is None:
        return pin.SE3.Identity()
    parent = etree.Element("frame")
    parent.append(etree.fromstring(etree.tostring(element)))
    parent[0].tag = "origin"
    xyz, rpy = (attribute(parent, "origin", key, where) for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


def _axis(element: etree._Element | None, where: str, default: np.ndarray | None) -> np.ndarray:
    if element is None and default is not None:
        return default
    parent = etree.Element("frame")
    if element is not None:
        parent.append(etree.fromstring(etree.tostring(element)))
        parent[0].tag = "axis"
    axis = np.array(attribute(parent, "axis", "xyz", where))
    if not np.linalg.norm(axis) > 1e-9:
        raise MechanismError(f"{where}: an axis 0 0 0; give a direction")
    return axis / np.linalg.norm(axis)


class _Loops:
    """Closures of elements within a `<robot>`."""

    def __init__(self, robot: etree._Element, path: Path) -> None:
        self.robot, self.where = robot, str(path)
        self.links = [link.get("name") for link in robot.findall("link")]
        self.carrying = {j.find("child").get("link"): j for j in robot.findall("joint")}

    def kind(self, element: etree._Element) -> str:
        """Return the kind of closure of a type of joint."""
        kind = (element.get("type") or "").lower()
        if kind not in KINDS:
            what = f"{element.tag} '{element.get('name')}' is of type '{kind}'"
            refuse(element, self.where, f"{what}; {one_of(kind, KINDS)}")
        return KINDS[kind]

    def link(self, element: etree._Element, tag: str) -> str:
        """Return the link that a child element names."""
        child = element.find(tag)
        link = "" if child is None else child.get("link") or ""
        if link not in self.links and link != "world":
            what = (
                f"{element.tag} '{element.get('name')}': <{tag}> names '{link}', which is no link"
            )
            refuse(element, self.where, f"{what}; {one_of(link, self.links)}")
        return link

    def differ(self, element: etree._Element, one: str, other: str) -> None:
        """Refuse a loop within one body."""
        if one == other:
            what = f"{element.tag} '{element.get('name')}' leads from link '{one}' to itself"
            refuse(element, self.where, f"{what}; name two links")

    def path(self, link: str) -> list[str]:
        """Return the joints from the root to a link."""
        names = []
        while (joint := self.carrying.get(link)) is not None:
            names.append(joint.get("name"))
            link = joint.find("parent").get("link")
        return names[::-1]


def read_constraints(robot: etree._Element, path: Path, sidecars: bool) -> Extension | None:
    """Read the <constraint> elements of urdfdom."""
    loops, closures = _Loops(robot, path), []
    for element in robot.findall("constraint"):
        parent, child = (loops.link(element, tag) for tag in ("parent", "child"))
        loops.differ(element, parent, child)
        axis_of_parent = _axis(element.find("parent_axis"), loops.where, None)
        other = _axis(element.find("child_axis"), loops.where, axis_of_parent)
        origins = (
            _origin(element.find(f"{tag}_origin"), loops.where) for tag in ("parent", "child")
        )
        ends = [*zip((parent, child), origins, (axis_of_parent, other), strict=True)]
        closures.append(_closure(str(element.get("name")), loops.kind(element), ends))
    if not closures:
        return None
    etree.strip_elements(robot, "constraint", with_tail=False)
    passive, notes = _passive(sorted(_actuated(robot)), robot)
    return Extension("URDF with constraints", tuple(closures), passive, notes=tuple(notes))


def read_urdf_plus(robot: etree._Element, path: Path, sidecars: bool) -> Extension | None:
    """Read the <loop> and <coupling> elements of URDF+."""
    loops, closures, following = _Loops(robot, path), [], set[str]()
    for element in robot.findall("loop"):
        ends = []
        axis = _axis(element.find("axis"), loops.where, None)
        for tag in ("predecessor", "successor"):
            link = loops.link(element, tag)
            ends.append((link, _origin(element.find(f"{tag}/origin"), loops.where), axis))
        loops.differ(element, ends[0][0], ends[1][0])
        closures.append(_closure(str(element.get("name")), loops.kind(element), ends))
    for element in robot.findall("coupling"):
        before, after = (loops.path(loops.link(element, x)) for x in ("predecessor", "successor"))
        while before and after and before[0] == after[0]:
            before, after = before[1:], after[1:]
        ratio = element.find("ratio")
        text = "" if ratio is None else ratio.get("value") or ""
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        moving = _moving(robot)
        before, after = ([name for name in side if name in moving] for side in (before, after))
        if not before or not after or not value or not np.isfinite(value):
            what = f"coupling '{element.get('name')}' has the ratio '{text}' between joints "
            what += f"{', '.join(before) or 'none'} and {', '.join(after) or 'none'}"
            refuse(element, loops.where, f"{what}; joints of two branches and a number are needed")
        following |= {*after}
        closures.append(  # of what the successor turns, the predecessor's times the ratio
            {
                "name": str(element.get("name")), "kind": "linear", "joints": [*after, *before],
                "ratios": [1.0] * len(after) + [-value] * len(before),
            }
        )  # fmt: skip
    if not closures:
        return None
    stated = {j.get("name"): j.get("independent") for j in robot.findall("joint")}
    dependent = {name for name, word in stated.items() if word == "false"} | following
    independent = [name for name in _moving(robot) if name not in dependent]
    for joint in robot.findall("joint"):
        joint.attrib.pop("independent", None)
    etree.strip_elements(robot, "loop", "coupling", with_tail=False)
    passive, notes = _passive(independent if dependent else [], robot)
    return Extension("URDF+", tuple(closures), passive, notes=tuple(notes))
