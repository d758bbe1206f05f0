"""Joints of several coordinates as chains of scalar joints with massless links between them.

    floating   J.x J.y J.z, then a ball      planar   J.x J.y J.rz, in the plane across its axis
    ball       J.rz J.ry J.rx (or another order): R = R_z R_y R_x, yaw, pitch and roll of the child
    universal  two turns about given axes
    tumbling   a fourth turn J.gimbal before the three of a ball, prescribed so that they stay apart

Any three turns about x, y and z that follow each other at one point and are named `J.rx`, `J.ry`
and `J.rz` are a ball, whether a reader made them or a file has them so. A log may have its
orientation as a unit quaternion (`motion.poses`), and the middle one of the three angles must stay
away from ±90°.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.errors import MechanismError, one_of
from ident.mechanism.description import UNLIMITED, align_z, attribute, refuse, words

AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
ORDERS = tuple("".join(order) for order in permutations("xyz"))
FOUR_TURNS = tuple(f"{axis}{order}" for order in ORDERS for axis in "xyz" if axis != order[0])
ORDER = "zyx"  # range: yaw, pitch, roll
BASE = "base"  # the joint of a floating base
GIMBAL = "gimbal"  # the prescribed turn of a body that tumbles


@dataclass(frozen=True)
class Chain:
    """A ball or floating joint by its scalar joints."""

    name: str
    order: str  # of the three turns, from the parent to the child
    floating: bool  # whether three slides J.x, J.y, J.z are before them
    gimbal: str = ""  # axis of a turn before the three, of a body that tumbles

    @property
    def turns(self) -> tuple[str, str, str]:
        """Names of the joints that turn, from the parent to the child."""
        first, middle, last = (f"{self.name}.r{axis}" for axis in self.order)
        return first, middle, last

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all its joints."""
        gimbal = (f"{self.name}.{GIMBAL}",) if self.gimbal else ()
        return (*self.slides, *gimbal, *self.turns)

    @property
    def slides(self) -> tuple[str, ...]:
        """Names of the joints that slide."""
        return tuple(f"{self.name}.{axis}" for axis in "xyz") if self.floating else ()


def may_float(robot: etree._Element) -> str:
    """Return a note where the root of a `<robot>` looks like a body that moves: it has a mass, two
    moving joints or more lead from it, and no joint leads to it from the ground; else "".
    """
    joints = robot.findall("joint")
    parent = {j.find("child").get("link"): j for j in joints}
    roots = [name for x in robot.findall("link") if (name := x.get("name")) not in parent]
    grounded = "world" in roots or any(j.find("parent").get("link") == "world" for j in joints)
    if grounded or not roots:
        return ""
    branches = 0
    for joint in joints:
        at = joint.find("parent").get("link")
        while at in parent and parent[at].get("type") == "fixed":
            at = parent[at].find("parent").get("link")
        branches += joint.get("type") != "fixed" and at in roots
    root = next(x for x in robot.findall("link") if x.get("name") == roots[0])
    mass = root.find("inertial/mass")
    if branches < 2 or mass is None or not float(mass.get("value", 0)):
        return ""
    return (
        f"link '{roots[0]}' ({float(mass.get('value')):.3g} kg, {branches} branches) is taken as "
        'the ground; if it moves, write in mechanism.toml: base = { kind = "floating" }, and log '
        "its pose as base.x base.y base.z base.qx base.qy base.qz base.qw"
    )


def floating_base(robot: etree._Element, where: str) -> None:
    """Put a floating joint `base` between the ground and the root of a `<robot>`."""
    children = {joint.find("child").get("link") for joint in robot.findall("joint")}
    links = [link.get("name") for link in robot.findall("link")]
    roots = [name for name in links if name not in children]
    parents = {joint.find("parent").get("link") for joint in robot.findall("joint")}
    grounded = [j for j in robot.findall("joint") if j.find("parent").get("link") == "world"]
    if len(grounded) == 1 and grounded[0].get("type") == "fixed":  # as readers write it
        grounded[0].attrib.update({"name": BASE, "type": "floating"})
        etree.strip_elements(grounded[0], "origin", with_tail=False)
        return
    if "world" in {*links, *parents}:
        raise MechanismError(
            f"{where}: [base] kind = 'floating', and the file has a link 'world' already: take the "
            "joint that leads from it out, or make its type floating and leave [base] out"
        )
    if BASE in (joint.get("name") for joint in robot.findall("joint")):
        raise MechanismError(f"{where}: a joint is named '{BASE}' already; rename it")
    robot.insert(0, etree.Element("link", name="world"))
    joint = etree.SubElement(robot, "joint", name=BASE, type="floating")
    etree.SubElement(joint, "parent", link="world")
    etree.SubElement(joint, "child", link=roots[0])


def pose_start(name: str, pose: pin.SE3, order: str = ORDER) -> dict[str, float]:
    """Return the coordinates of a floating joint's chain at a pose of its child."""
    angles = angles_of(pose.rotation[None], order)[0]
    slides = {f"{name}.{axis}": float(x) for axis, x in zip("xyz", pose.translation, strict=True)}
    return slides | {f"{name}.r{axis}": float(x) for axis, x in zip(order, angles, strict=True)}


def angles_of(R: np.ndarray, order: str) -> np.ndarray:
    """Return the angles (n, 3) of the turns of R (n, 3, 3), one after the other, |middle| ≤ π/2.

    With R = R_i(α) R_j(β) R_k(γ) and s = ±1 the sign of the permutation ijk:
    R_ik = s sin β,  R_jk = −s sin α cos β,  R_kk = cos α cos β,  R_ij = −s sin γ cos β.
    """
    i, j, k = ("xyz".index(axis) for axis in order)
    s = 1.0 if (j - i) % 3 == 1 else -1.0
    first = np.arctan2(-s * R[:, j, k], R[:, k, k])
    middle = np.arcsin(np.clip(s * R[:, i, k], -1.0, 1.0))
    last = np.arctan2(-s * R[:, i, j], R[:, i, i])
    return np.stack([first, middle, last], axis=1)


def _fix(joint: etree._Element, start: Mapping[str, float], where: str) -> None:
    """Place a locked floating joint where the mechanism starts, as its coordinates say."""
    name = joint.get("name")
    slides, turns = ([start.get(f"{name}.{k}{x}", 0.0) for x in "xyz"] for k in ("", "r"))
    if any(slides) or any(turns):
        xyz, rpy = (np.array(attribute(joint, "origin", key, where)) for key in ("xyz", "rpy"))
        place = pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
        place = place * pin.SE3(pin.rpy.rpyToMatrix(*turns), np.array(slides))
        etree.strip_elements(joint, "origin", with_tail=False)
        turn = words(pin.rpy.matrixToRpy(place.rotation))
        etree.SubElement(joint, "origin", xyz=words(place.translation), rpy=turn)


def _check_limits(joint: etree._Element, where: str) -> None:
    """Refuse limits of a ball joint, whose three angles have no common one."""
    limit = joint.find("limit")
    if limit is None:
        return
    given = [key for key in ("lower", "upper") if any(attribute(joint, "limit", key, where))]
    if given:
        values = ", ".join(f"{key} = {limit.get(key)}" for key in given)
        refuse(
            joint,
            where,
            f"ball joint '{joint.get('name')}' has limits ({values}), and one angle cannot limit "
            "three; take them out, or write it as three revolute joints with limits of their own",
        )


def expand(
    robot: etree._Element,
    where: str,
    fixed: Collection[str],
    orders: Mapping[str, str],
    start: Mapping[str, float],
) -> list[str]:
    """Replace joints of several coordinates in a `<robot>` by chains; return their massless links.

    Args:
        robot: changed in place.
        where: its file, for messages.
        fixed: joints that are locked whole and stay as they are.
        orders: of the turns of ball and floating joints, by name, where it is not yaw, pitch, roll.
        start: coordinates at which those stay that are locked [rad | m], by scalar joint.
    """
    auxiliary: list[str] = []
    names = [j.get("name") for j in robot.findall("joint") if j.get("type") in ("floating", "ball")]
    for name in orders:
        if name not in names and orders[name] != ORDER:
            raise MechanismError(
                f"{where}: no ball or floating joint '{name}'; {one_of(name, names)}"
            )
    for joint in robot.findall("joint"):
        name, kind = joint.get("name"), joint.get("type")
        if name in fixed:
            if kind in ("ball", "floating"):
                _fix(joint, start, where)
            continue
        order = orders.get(name, ORDER)
        turns = [(f"r{axis}", "revolute", AXES[axis]) for axis in order[-3:]]
        if len(order) > 3:
            turns.insert(0, (GIMBAL, "revolute", AXES[order[0]]))
        if kind == "floating":
            slides = [(axis, "prismatic", AXES[axis]) for axis in "xyz"]
            auxiliary += replace_joint(robot, joint, [*slides, *turns])
        elif kind == "ball":
            _check_limits(joint, where)
            auxiliary += replace_joint(robot, joint, turns)
        elif kind == "planar":
            R = align_z(np.array(attribute(joint, "axis", "xyz", where)))
            axes = [words(R[:, i]) for i in range(3)]
            steps = [("x", "prismatic", axes[0]), ("y", "prismatic", axes[1])]
            auxiliary += replace_joint(robot, joint, [*steps, ("rz", "revolute", axes[2])])
    return auxiliary


def replace_joint(
    robot: etree._Element,
    joint: etree._Element,
    steps: Sequence[tuple[str, str, str]],
    separator: str = ".",
) -> list[str]:
    """Replace a joint by a chain of `steps`: suffix of the name, type and axis; return the massless
    links between them. The first has the origin of the joint.
    """
    name, child = joint.get("name"), joint.find("child").get("link")
    before, place = joint.find("parent").get("link"), robot.index(joint)
    robot.remove(joint)
    links = []
    for i, (suffix, kind, axis) in enumerate(steps):
        step = etree.Element("joint", name=f"{name}{separator}{suffix}", type=kind)
        after = child
        if i < len(steps) - 1:
            after = f"{name}{separator}{suffix}_link"
            links.append(after)
            robot.insert(place, etree.Element("link", name=after))
            place += 1
        etree.SubElement(step, "parent", link=before)
        etree.SubElement(step, "child", link=after)
        if i == 0 and joint.find("origin") is not None:
            step.append(joint.find("origin"))
        etree.SubElement(step, "axis", xyz=axis)
        limits = {
            "lower": -UNLIMITED,
            "upper": UNLIMITED,
            "effort": UNLIMITED,
            "velocity": UNLIMITED,
        }
        etree.SubElement(step, "limit", {key: f"{value}" for key, value in limits.items()})
        robot.insert(place, step)
        place += 1
        before = after
    return links


def chains_of(robot: etree._Element, where: str) -> tuple[Chain, ...]:
    """Return the ball and floating joints that a `<robot>` of scalar joints has as chains."""
    moving = {j.get("name"): j for j in robot.findall("joint") if j.get("type") != "fixed"}
    by_parent = {joint.find("parent").get("link"): name for name, joint in moving.items()}
    chains = []
    for first in moving:
        name, _, axis = first.rpartition(".r")
        if not name or axis not in AXES:
            continue
        order, joint = "", moving[first]
        while joint is not None and _turns_next(joint, name, order, where):
            order += joint.get("name")[-1]
            joint = moving.get(by_parent.get(joint.find("child").get("link"), ""))
        if len(order) == 3:
            gimbal = ""
            if (outer := moving.get(f"{name}.{GIMBAL}")) is not None:
                about = attribute(outer, "axis", "xyz", where)
                gimbal = next(x for x in AXES if about == [float(c) for c in AXES[x].split()])
            floating = all(f"{name}.{x}" in moving for x in "xyz")
            chains.append(Chain(name, order, floating, gimbal))
    return tuple(chains)


def _turns_next(joint: etree._Element, name: str, order: str, where: str) -> bool:
    """Return whether a joint is the next turn of a ball `name` that has the turns `order`."""
    before, _, axis = joint.get("name").rpartition(".r")
    if before != name or axis not in AXES or axis in order:
        return False
    along = [float(x) for x in AXES[axis].split()]
    apart = bool(order) and any(attribute(joint, "origin", "xyz", where))
    turns = joint.get("type") in ("revolute", "continuous")
    return turns and not apart and attribute(joint, "axis", "xyz", where) == along


def pose_names(chains: Sequence[Chain]) -> set[str]:
    """Return the names `<joint>.<x|…>` of a log's columns that poses have beside scalar joints."""
    words = ("x", "y", "z", "w", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "wx", "wy", "wz")
    return {f"{chain.name}.{word}" for chain in chains for word in words}
