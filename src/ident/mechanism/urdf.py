"""A URDF's text parsed safely, checked with each fault named by its line, and given new inertias.

XML from strangers may carry entity bombs and references to other files, so a document type is
refused before anything is expanded.
"""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Mapping, Sequence
from typing import NoReturn

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.errors import MechanismError, one_of
from ident.files import HUGE
from ident.mechanism.parameters import about_origin, split

MOST = 500  # work: joints, those that are fixed among them
TYPES = ("fixed", "revolute", "continuous", "prismatic", "planar", "floating")
SEVERAL = {  # joints of several coordinates, and what they are a chain of; free and ball of MuJoCo
    "floating": "three prismatic and three revolute", "planar": "two prismatic and one revolute",
}  # fmt: skip
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)  # as C++ reads it, too
TERMS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
NUMBERS = {  # attributes that are numbers, by element, with their defaults
    "origin": {"xyz": "0 0 0", "rpy": "0 0 0"},
    "axis": {"xyz": "1 0 0"},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), "0"),
    "mimic": {"multiplier": "1", "offset": "0"},
    "mass": {"value": ""},
    "inertia": {key: "" if key[1] == key[2] else "0" for key in TERMS},
}
UPPER = np.triu_indices(3)


def parse_xml(data: bytes, where: str) -> etree._Element:
    """Return the root element of an XML text; nothing in it is expanded or fetched."""
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, strip_cdata=False
    )
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise MechanismError(
            f"{where}: has a document type or entities, which are refused; remove <!DOCTYPE …>"
        )
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        text = str(error).replace("\n", " ").partition(" (<string>")[0] or "empty file"
        raise MechanismError(
            f"{where}: is no well-formed XML: {text}; correct it or export it again"
        ) from None
    if root.getroottree().docinfo.internalDTD is not None:
        raise MechanismError(f"{where}: has a document type, which is refused; remove it")
    return root


def parse_urdf(data: bytes, where: str) -> etree._Element:
    """Return the checked `<robot>` element of a URDF's text, comments included."""
    robot = parse_xml(data, where)
    if robot.tag != "robot":
        valid = "a URDF's is <robot> (a MuJoCo model is named .xml)"
        given = str(robot.tag)
        valid += '; take xmlns="…" out' if given.endswith("}robot") else ""
        refuse(robot, where, f"the root element is <{given}>; {valid}")
    if not robot.get("name"):
        robot.set("name", "robot")
    _check_names(robot, where)
    if (count := len(robot.findall("joint"))) > MOST:
        raise MechanismError(f"{where}: {count} joints; a mechanism has at most {MOST}")
    _check_tree(robot, where)
    for joint in robot.findall("joint"):
        _check_joint(joint, where)
    for link in robot.findall("link"):
        _check_inertial(link, where)
    return robot


def numbers(element: etree._Element, key: str, default: str, count: int, where: str) -> list[float]:
    """Return the `count` finite numbers of an attribute; a MechanismError shows its text."""
    text = element.get(key, default)
    values = [float(word) for word in text.split() if NUMBER.fullmatch(word)]
    most = HUGE if element.tag != "limit" else math.inf  # a limit may be as large
    good = len(values) == len(text.split()) and all(abs(value) < most for value in values)
    if len(values) != count or not good:
        need = "a finite number" if count == 1 else f"{count} finite numbers"
        refuse(element, where, f'<{element.tag} {key}="{text}">: {need} expected')
    return values


def refuse(element: etree._Element, where: str, message: str) -> NoReturn:
    """Raise MechanismError with the line of an element."""
    raise MechanismError(f"{where}:{element.sourceline}: {message}")


def _check_names(robot: etree._Element, where: str) -> None:
    for tag in ("link", "joint"):
        first: dict[str, int] = {}
        for element in robot.findall(tag):
            name = element.get("name")
            if not name:
                refuse(element, where, f'a <{tag}> has no name; write name="…"')
            if name in first:
                at = f"the first is in line {first[name]}; names must differ"
                refuse(element, where, f"a second {tag} is named '{name}', {at}")
            first[name] = element.sourceline
    if robot.find("link") is None:
        raise MechanismError(f"{where}: has no <link>; a mechanism needs at least two and a joint")


def _check_tree(robot: etree._Element, where: str) -> None:
    links = [link.get("name") for link in robot.findall("link")]
    parent_of: dict[str, str] = {}
    for joint in robot.findall("joint"):
        name, ends = joint.get("name"), {}
        for end in ("parent", "child"):
            element = joint.find(end)
            link = None if element is None else element.get("link")
            if not link:
                refuse(joint, where, f"joint '{name}' has no <{end} link=…>")
            if link not in links and not (end == "parent" and link == "world"):
                what = f"joint '{name}' has the {end} '{link}', which is no link"
                refuse(joint, where, f"{what}; {one_of(link, links)}")
            ends[end] = link
        if ends["child"] in parent_of:
            how = "a URDF is a tree: close the loop by a [[closure]] in mechanism.toml"
            refuse(joint, where, f"link '{ends['child']}' is the child of two joints; {how}")
        parent_of[ends["child"]] = ends["parent"]

    def root_of(link: str) -> str:
        path = [link]
        while path[-1] in parent_of:
            path.append(parent_of[path[-1]])
            if path[-1] in path[:-1]:
                ring = ", ".join(path[path.index(path[-1]) + 1 :])
                raise MechanismError(
                    f"{where}: the links {ring} form a ring; one link must be the ground, and the "
                    "loop closed by a [[closure]]"
                )
        return path[-1]

    root = root_of(next(iter(parent_of.values()), links[0]))
    if separate := [name for name in links if root_of(name) != root]:
        raise MechanismError(
            f"{where}: no joint leads from the root '{root}' to link '{separate[0]}'"
            + (f" and {len(separate) - 1} more" if len(separate) > 1 else "")
            + "; connect it by a joint (type fixed, if it does not move) or remove it"
        )


def _check_joint(joint: etree._Element, where: str) -> None:
    name, kind = joint.get("name"), joint.get("type") or ""
    if kind not in TYPES:
        refuse(joint, where, f"joint '{name}' is of type '{kind}'; {one_of(kind, TYPES)}")
    for element in joint:
        _check_numbers(element, where)
    # of fixed joints exporters write an axis of zeros
    axis, limit = None if kind == "fixed" else joint.find("axis"), joint.find("limit")
    if axis is not None and math.hypot(*numbers(axis, "xyz", "1 0 0", 3, where)) < 1e-9:
        refuse(axis, where, f"joint '{name}' has the axis 0 0 0; give a direction")
    if limit is not None:
        lower, upper = (numbers(limit, key, "0", 1, where)[0] for key in ("lower", "upper"))
        if lower > upper:
            why = f"lower {lower:g} above upper {upper:g}; swap them"
            refuse(limit, where, f"joint '{name}' has {why}")


def _check_numbers(element: etree._Element, where: str) -> None:
    for key, default in NUMBERS.get(element.tag, {}).items():
        numbers(element, key, default, len(default.split()) or 1, where)


def _check_inertial(link: etree._Element, where: str) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    for tag in ("mass", "inertia"):
        if inertial.find(tag) is None:
            refuse(inertial, where, f"the <inertial> of link '{link.get('name')}' has no <{tag}>")
    for element in inertial:
        _check_numbers(element, where)
    mass = inertial.find("mass")
    if (value := numbers(mass, "value", "", 1, where)[0]) < 0:
        refuse(mass, where, f"link '{link.get('name')}' has the mass {value:g} kg; it must be ≥ 0")


def lock(
    robot: etree._Element, values: Mapping[str, float], where: str
) -> tuple[dict[str, float], list[str]]:
    """Fix joints of a `<robot>` at coordinates [rad | m], and joints that mimic them; return all,
    and notes on those that are outside of their limits.

    Raises:
        MechanismError: for a joint that is not there; one of several coordinates can be fixed at
            its origin, and must be.
    """
    joints = {j.get("name"): j for j in robot.findall("joint") if j.get("type") != "fixed"}
    locked, notes = dict(values), []
    for name in locked:
        if name not in joints:
            what = f"there is no joint '{name}' to be locked"
            raise MechanismError(f"{where}: {what}; {one_of(name, joints)}")
    for name, joint in joints.items():
        chain = SEVERAL.get(joint.get("type", ""))
        if chain and locked.get(name, 0) != 0:
            what = f"joint '{name}' has several coordinates, so {locked[name]:g} is no place of it"
            raise MechanismError(f"{where}: {what}; only --lock {name}, where the file has it")
        if chain and name not in locked:
            raise MechanismError(
                f"{where}: joint '{name}' is of type {joint.get('type')}, and a joint has one "
                f"column; if it does not move in the log, --lock {name} (or [joints] locked = "
                f"{{ {name} = 0 }}) fixes it where the file has it; else state it as {chain} "
                "joints with massless links between them"
            )
    followers = [(name, each.find("mimic")) for name, each in joints.items()]
    pending = [(name, mimic) for name, mimic in followers if mimic is not None]
    for _ in pending:  # one may mimic another that mimics
        for name, mimic in pending:
            if name not in locked and mimic.get("joint") in locked:
                (factor,), (offset,) = (
                    numbers(mimic, key, default, 1, where)
                    for key, default in NUMBERS["mimic"].items()
                )
                locked[name] = factor * locked[mimic.get("joint")] + offset
    for name, value in locked.items():
        joint, axis = joints[name], np.array([1.0, 0.0, 0.0])
        if joint.find("axis") is not None:
            axis = np.array(numbers(joint.find("axis"), "xyz", "1 0 0", 3, where))
        limit, kind = joint.find("limit"), joint.get("type")
        if name in values and limit is not None and kind in ("revolute", "prismatic"):
            (low,), (high,) = (numbers(limit, key, "0", 1, where) for key in ("lower", "upper"))
            if low < high and not low <= value <= high:
                limits = f"{low:.4g} to {high:.4g}"
                notes.append(f"{name} is locked at {value:.4g}, outside its limits {limits}")
        step = value * axis / np.linalg.norm(axis)
        motion = pin.SE3(np.eye(3), step)
        if kind != "prismatic":
            motion = pin.SE3(pin.exp3(step), np.zeros(3))
        origin = joint.find("origin")
        origin = etree.Element("origin") if origin is None else origin
        xyz, rpy = (numbers(origin, key, "0 0 0", 3, where) for key in ("xyz", "rpy"))
        place = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz)) * motion
        for tag in ("origin", "axis", "limit", "mimic"):
            for element in joint.findall(tag):
                joint.remove(element)
        turn = words(pin.rpy.matrixToRpy(place.rotation))
        etree.SubElement(joint, "origin", xyz=words(place.translation), rpy=turn)
        joint.set("type", "fixed")
    return locked, notes


# --- inertias -------------------------------------------------------------------------------------


def words(values: Sequence[float] | np.ndarray) -> str:
    """Return numbers as XML has them, none of them rounded."""
    return " ".join(repr(float(x) + 0.0) for x in values)


def with_inertials(data: bytes, where: str, inertials: Mapping[str, np.ndarray | None]) -> bytes:
    """Return a URDF's text with other `<inertial>` of some links; all else stays as it is, but for
    quotes and blanks within tags.

    Args:
        data: the text.
        where: begins the message of an error.
        inertials: by link, its ten dynamic parameters (10,) in its frame; None: no `<inertial>`.

    Raises:
        MechanismError: if it is no URDF.
    """
    robot = parse_urdf(data, where)
    for link in robot.findall("link"):
        name = link.get("name")
        pi, inertial = inertials.get(name), link.find("inertial")
        if name not in inertials:
            continue
        if inertial is None and pi is not None and np.any(pi):
            inertial = etree.Element("inertial")
            etree.SubElement(inertial, "mass", value="0")
            etree.SubElement(inertial, "inertia", dict.fromkeys(TERMS, "0"))
            link.insert(0, inertial)
            inertial.tail = link.text
        if pi is not None and inertial is not None:
            _change(inertial, pi)
        elif inertial is not None:
            etree.strip_elements(link, "inertial", with_tail=False)
    info, text = robot.getroottree().docinfo, data.lstrip(codecs.BOM_UTF8)
    new: bytes = etree.tostring(
        robot.getroottree(), encoding=info.encoding or "utf-8", standalone=info.standalone,
        xml_declaration=text.startswith(b"<?xml") or info.encoding not in (None, "UTF-8"),
    )  # fmt: skip
    new += b"\n" if new.startswith(b"<") else b""  # in UTF-16 a new line has two bytes
    return new.replace(b"\n", b"\r\n") if b"\r\n" in data else new


def _change(inertial: etree._Element, pi: np.ndarray) -> None:
    """Give an `<inertial>` other numbers; those that stay keep their text."""
    m, moments, L = split(pi)
    centre = moments / m if m else np.zeros(3)
    terms = (L - about_origin(m, moments))[UPPER]
    origin, mass, tensor = (inertial.find(tag) for tag in ("origin", "mass", "inertia"))
    if origin is None and np.any(centre):
        origin = etree.Element("origin")
        inertial.insert(0, origin)
    new = [(mass, "value", np.array([m]), "")]
    new += [(tensor, key, x, "0") for key, x in zip(TERMS, terms[:, None], strict=True)]
    if origin is not None:
        new += [(origin, "xyz", centre, "0 0 0"), (origin, "rpy", np.zeros(3), "0 0 0")]
    for element, key, values, default in new:
        if numbers(element, key, default, len(values), "") != values.tolist():
            element.set(key, words(values))
