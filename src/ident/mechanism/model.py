"""From a checked URDF to Pinocchio's model in which every joint has one scalar coordinate.

Pinocchio stores a continuous joint as (cos, sin) and a planar one as (x, y, cos, sin). Here every
coordinate is an angle or a length, as logs and tables have them: a continuous joint becomes a
revolute one without limits, a planar joint the chain x, y, rz with massless links between.
Mimicking joints stay joints; the mechanism gets a `linear` closure for each.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.description.axes import perpendicular
from ident.description.urdf import numbers
from ident.errors import MechanismError, one_of

UNLIMITED = ("-1e9", "1e9")


@dataclass(frozen=True)
class Mimic:
    """q_joint = multiplier · q_of + offset."""

    joint: str
    of: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Tree:
    """Pinocchio's model of a URDF with the names that it does not keep.

    Attributes:
        model: one scalar coordinate a joint, `model.nq == model.nv`.
        links: the URDF link that each joint moves, by Pinocchio's joint index from 1 on.
        mimics: joints that follow another.
        auxiliary: links between the steps of a planar joint, massless and in no URDF.
        notes: what was understood otherwise than it is written, in words.
    """

    model: pin.Model
    links: tuple[str, ...]
    mimics: tuple[Mimic, ...]
    auxiliary: tuple[str, ...]
    notes: tuple[str, ...]


def build_tree(robot: etree._Element, gravity: tuple[float, float, float], where: str) -> Tree:
    """Pinocchio's model of a checked `<robot>`.

    Raises:
        MechanismError: if a joint mimics one that is not there, or nothing moves.
    """
    robot = copy.deepcopy(robot)
    notes: list[str] = []
    names = {link.get("name") for link in robot.findall("link")}
    used = {joint.find("parent").get("link") for joint in robot.findall("joint")}
    if "world" in used - names:
        robot.insert(0, etree.Element("link", name="world"))
        notes.append("the URDF does not declare the link 'world'; it is taken as the ground")
    for joint in robot.findall("joint"):
        for tag in ("dynamics", "safety_controller", "calibration"):  # nothing here uses them
            for element in joint.findall(tag):
                joint.remove(element)
    for element in robot.iter("limit", "mass", "inertia"):
        for key, value in element.items():  # urdfdom stumbles over blanks around a number
            element.set(key, value.strip())
    for link in robot.findall("link"):
        for tag in ("visual", "collision"):
            for element in link.findall(tag):
                link.remove(element)
        for inertia in link.iterfind("inertial/inertia"):  # urdfdom wants them written
            for key in ("ixy", "ixz", "iyz"):
                inertia.set(key, inertia.get(key, "0"))
    mimics = tuple(_take_mimics(robot, where))
    for joint in robot.findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            if (limit := joint.find("limit")) is not None:
                limit.set("lower", UNLIMITED[0])
                limit.set("upper", UNLIMITED[1])
        if joint.get("type") == "planar":
            _split_planar(robot, joint, where)
    for joint in robot.findall("joint"):
        if joint.get("type") != "fixed":
            _complete_limit(joint)
    try:
        model = pin.buildModelFromXML(etree.tostring(robot).decode())
    except (RuntimeError, ValueError) as error:
        raise MechanismError(
            f"{where}: Pinocchio refuses it: {' '.join(str(error).split())}"
        ) from None
    if model.nv == 0:
        raise MechanismError(f"{where}: has no joint that moves; every joint is fixed")
    model.gravity.linear = np.array(gravity)
    child = {j.get("name"): j.find("child").get("link") for j in robot.findall("joint")}
    links = tuple(child[name] for name in list(model.names)[1:])
    auxiliary = tuple(link for link in links if link not in names)
    return Tree(model, links, mimics, auxiliary, tuple(notes))


def _complete_limit(joint: etree._Element) -> None:
    limit = joint.find("limit")
    if limit is None:
        limit = etree.SubElement(joint, "limit", lower=UNLIMITED[0], upper=UNLIMITED[1])
    for key in ("effort", "velocity"):
        if limit.get(key) is None:
            limit.set(key, UNLIMITED[1])


def _take_mimics(robot: etree._Element, where: str) -> list[Mimic]:
    scalar = [j for j in robot.findall("joint") if j.get("type") not in ("fixed", "planar")]
    moving = [joint.get("name") for joint in scalar]
    found = []
    for joint in robot.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        of = mimic.get("joint") or ""
        if of not in moving or of == joint.get("name"):
            others = [name for name in moving if name != joint.get("name")]
            raise MechanismError(
                f"{where}:{mimic.sourceline}: joint '{joint.get('name')}' mimics '{of}', which is "
                f"no other joint of one coordinate; {one_of(of, others)}"
            )
        multiplier = numbers(mimic, "multiplier", "1", 1, where)[0]
        offset = numbers(mimic, "offset", "0", 1, where)[0]
        found.append(Mimic(joint.get("name"), of, multiplier, offset))
        joint.remove(mimic)
    return found


def _split_planar(robot: etree._Element, joint: etree._Element, where: str) -> None:
    name, child = joint.get("name"), joint.find("child").get("link")
    element = joint.find("axis")
    axis = np.array([1.0, 0, 0] if element is None else numbers(element, "xyz", "1 0 0", 3, where))
    x, y = perpendicular(axis)
    parent, origin = joint.find("parent").get("link"), joint.find("origin")
    steps = (("x", "prismatic", x), ("y", "prismatic", y), ("rz", "revolute", axis))
    place = robot.index(joint)
    robot.remove(joint)
    for suffix, kind, direction in steps:
        to = child if suffix == "rz" else f"{name}.{suffix}.link"
        if to != child:
            robot.append(etree.Element("link", name=to))
        part = etree.Element("joint", name=f"{name}.{suffix}", type=kind)
        robot.insert(place, part)
        etree.SubElement(part, "parent", link=parent)
        etree.SubElement(part, "child", link=to)
        etree.SubElement(part, "axis", xyz=" ".join(repr(float(value)) for value in direction))
        if suffix == "x" and origin is not None:
            part.append(copy.deepcopy(origin))
        parent = to
