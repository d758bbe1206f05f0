"""A mechanism's file: a URDF, and what a URDF cannot state, as closures, passive joints, gravity.

MuJoCo models and formats of other packages are rewritten as a URDF (`urdf.UrdfWriter`). Its text is
parsed safely, each fault named by its line, joints are locked, and Pinocchio makes its model. XML
from strangers may carry entity bombs and references to other files, so a document type is refused
before anything is expanded.

Pinocchio stores a continuous joint as (cos, sin). Here every coordinate is an angle or a length, as
logs and tables have them: a continuous joint becomes a revolute one without limits. Mimicking
joints stay joints; the mechanism gets a `linear` closure for each.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.errors import MechanismError, one_of
from ident.files import BUILT_IN, HUGE, dialects, reader_of, regular
from ident.mechanism.body_units import BodyVerdict, verdict_of
from ident.text import shortlist

LARGEST = 50_000_000  # work: bytes of a file
FORMATS = {"mujoco": ".mjcf", "mujocoinclude": ".mjcf"}  # by root element
MOST_JOINTS = 500  # work: joints, those that are fixed among them
MOST_ATTRIBUTES = 1000  # work: of an element; listing them takes the square of their number
TYPES = ("fixed", "revolute", "continuous", "prismatic", "planar", "floating", "ball")
SEVERAL = ("floating", "planar", "ball")  # joints of several coordinates
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
NAMED = 4  # shown: links that are named of those with one fault
LONGEST = 100.0  # range: m, of a travel that a URDF states; what is longer is no limit
UNLIMITED = 1e9  # range: what a URDF states where there is no limit


@dataclass(frozen=True)
class Description:
    """Content of a mechanism file, as a URDF and the tables of a mechanism.toml."""

    urdf: bytes  # the URDF's text; the file's own, where it is one
    format: str = "urdf"  # or the name of the file's format
    closures: tuple[Mapping[str, Any], ...] = ()  # tables as in [[closure]]
    passive: tuple[str, ...] = ()  # joints of [joints] passive
    start: Mapping[str, float] = field(default_factory=dict)  # [joints] start
    gravity: tuple[float, float, float] | None = None  # [m/s²], where the file gives it
    auxiliary: tuple[str, ...] = ()  # massless links, which the file does not name
    motors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # as in [motors]
    notes: tuple[str, ...] = ()  # what was understood otherwise than it is written, in words


@dataclass(frozen=True)
class Extension:
    """What a dialect of URDF adds to the tree."""

    dialect: str  # its name; empty where it adds notes alone
    closures: tuple[Mapping[str, Any], ...] = ()  # the rest as in `Description`
    passive: tuple[str, ...] = ()
    auxiliary: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def read_description(path: Path, *, sidecars: bool = True) -> Description:
    """Read a URDF, a MuJoCo model or a format of another package.

    `sidecars`: whether files that state loops are read beside a URDF.
    """
    try:
        if (size := regular(path).stat().st_size) > LARGEST:
            raise MechanismError(f"{path}: {size} bytes; a URDF has at most {LARGEST}")
        data = path.read_bytes()
    except OSError as error:
        raise MechanismError(f"{path}: cannot be read: {error.strerror}") from None
    return description_of(data, path, sidecars=sidecars)


def description_of(data: bytes, path: Path, *, sidecars: bool = True) -> Description:
    """Read as `read_description` does, given the file's content, or a URDF in its place."""
    suffix = path.suffix.lower()
    if suffix == ".urdf":
        return _with_dialects(data, path, sidecars)
    foreign = None if f"mechanism{suffix}" in BUILT_IN else reader_of("mechanism", suffix)
    if foreign is not None and b"<robot" not in data:
        content = foreign(path)
        if isinstance(content, str):
            content = content.encode()
        return Description(content, suffix[1:]) if isinstance(content, bytes) else content
    reader = reader_of("mechanism", FORMATS.get(str(parse_xml(data, str(path)).tag), ""))
    return _with_dialects(data, path, sidecars) if reader is None else reader(path, data)


def _with_dialects(data: bytes, path: Path, sidecars: bool) -> Description:
    """Return a URDF with the loops, motors and ball joints that are stated in or beside it."""
    robot = parse_urdf(data, str(path))
    readings = (reader(robot, path, sidecars) for reader in dialects())
    extensions: list[Extension] = [extension for extension in readings if extension is not None]
    notes = tuple(note for extension in extensions for note in extension.notes)
    names = [extension.dialect for extension in extensions if extension.dialect]
    if not names:
        return Description(data, notes=notes)
    return Description(
        urdf=etree.tostring(robot, xml_declaration=True, encoding="utf-8"),
        format=" and ".join(names),
        closures=tuple(closure for extension in extensions for closure in extension.closures),
        passive=tuple(dict.fromkeys(x for extension in extensions for x in extension.passive)),
        auxiliary=tuple(link for extension in extensions for link in extension.auxiliary),
        notes=notes,
    )


def read_urdf(path: Path) -> etree._Element:
    """Return the checked `<robot>` element of a mechanism's file, comments included."""
    return parse_urdf(read_description(path).urdf, str(path))


# --- a text read and checked ----------------------------------------------------------------------


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
    for element in root.iter(etree.Element):
        if (count := len(element.attrib)) > MOST_ATTRIBUTES:
            refuse(element, where, f"<{element.tag}> has {count:,} attributes; export it again")
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
    if (count := len(robot.findall("joint"))) > MOST_JOINTS:
        raise MechanismError(f"{where}: {count} joints; a mechanism has at most {MOST_JOINTS}")
    _check_tree(robot, where)
    _check_values(robot, where)
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


def attribute(parent: etree._Element, tag: str, key: str, where: str) -> list[float]:
    """Return the numbers of an attribute of a child element, or those that it has by default."""
    child, default = parent.find(tag), NUMBERS[tag][key]
    child = etree.Element(tag) if child is None else child
    return numbers(child, key, default, len(default.split()) or 1, where)


def refuse(element: etree._Element, where: str, message: str) -> NoReturn:
    """Raise MechanismError with the line of an element."""
    raise MechanismError(f"{where}:{element.sourceline}: {message}")


def _check_tree(robot: etree._Element, where: str) -> None:
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
    links = [link.get("name") for link in robot.findall("link")]
    parent_of: dict[str, str] = {}
    for joint in robot.findall("joint"):
        name, ends = joint.get("name"), {}
        for end in ("parent", "child"):
            link = next((end_element.get("link") for end_element in joint.findall(end)), None)
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


def _check_values(robot: etree._Element, where: str) -> None:
    for element in (*robot.iterfind("joint/*"), *robot.iterfind("link/inertial/*")):
        for key, default in NUMBERS.get(element.tag, {}).items():
            numbers(element, key, default, len(default.split()) or 1, where)
    for joint in robot.findall("joint"):
        name, kind = joint.get("name"), joint.get("type") or ""
        if kind not in TYPES:
            refuse(joint, where, f"joint '{name}' is of type '{kind}'; {one_of(kind, TYPES)}")
        # of fixed joints exporters write an axis of zeros
        if kind != "fixed" and math.hypot(*attribute(joint, "axis", "xyz", where)) < 1e-9:
            what = f"joint '{name}' has the axis 0 0 0; give a direction"
            refuse(joint.find("axis"), where, what)
        (lower,), (upper,) = (attribute(joint, "limit", key, where) for key in ("lower", "upper"))
        if lower > upper:
            why = f"lower {lower:g} above upper {upper:g}; swap them"
            refuse(joint.find("limit"), where, f"joint '{name}' has {why}")
    for inertial in robot.iterfind("link/inertial"):
        name = inertial.getparent().get("name")
        for tag in ("mass", "inertia"):
            if inertial.find(tag) is None:
                refuse(inertial, where, f"the <inertial> of link '{name}' has no <{tag}>")
        (mass,) = attribute(inertial, "mass", "value", where)
        if mass < 0:
            what = f"link '{name}' has the mass {mass:g} kg; it must be ≥ 0"
            refuse(inertial.find("mass"), where, what)


def words(values: Sequence[float] | np.ndarray) -> str:
    """Return numbers as XML has them, none of them rounded."""
    return " ".join(repr(float(x) + 0.0) for x in values)


def lock(
    robot: etree._Element, values: Mapping[str, float], where: str
) -> tuple[dict[str, float], list[str]]:
    """Fix joints of a `<robot>` at coordinates [rad | m], and joints that mimic them; return all,
    and notes on those that are outside of their limits.

    A joint of several coordinates can be fixed at its origin, and must be.
    """
    joints = {j.get("name"): j for j in robot.findall("joint") if j.get("type") != "fixed"}
    locked, notes = dict(values), []
    for name in locked:
        if name not in joints:
            what = f"there is no joint '{name}' to be locked"
            raise MechanismError(f"{where}: {what}; {one_of(name, joints)}")
    for name, joint in joints.items():
        if joint.get("type") in SEVERAL and locked.get(name, 0) != 0:
            what = f"joint '{name}' has several coordinates, so {locked[name]:g} is no place of it"
            raise MechanismError(f"{where}: {what}; only --lock {name}, where the file has it")
    pending = {name: joint for name, joint in joints.items() if joint.find("mimic") is not None}
    for _ in pending:  # one may mimic another that mimics
        for name, joint in pending.items():
            if name not in locked and (other := joint.find("mimic").get("joint")) in locked:
                factor, offset = _mimic_numbers(joint, where)
                locked[name] = factor * locked[other] + offset
    for name, value in locked.items():
        joint, kind = joints[name], joints[name].get("type")
        axis, xyz, rpy = (
            np.array(attribute(joint, tag, key, where))
            for tag, key in (("axis", "xyz"), ("origin", "xyz"), ("origin", "rpy"))
        )
        (low,), (high,) = (attribute(joint, "limit", key, where) for key in ("lower", "upper"))
        limited = name in values and kind in ("revolute", "prismatic") and low < high
        if limited and not low <= value <= high:
            limits = f"{low:.4g} to {high:.4g}"
            notes.append(f"{name} is locked at {value:.4g}, outside its limits {limits}")
        step = value * axis / np.linalg.norm(axis)
        motion = pin.SE3(np.eye(3), step)
        if kind != "prismatic":
            motion = pin.SE3(pin.exp3(step), np.zeros(3))
        place = pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz) * motion
        etree.strip_elements(joint, "origin", "axis", "limit", "mimic", with_tail=False)
        turn = words(pin.rpy.matrixToRpy(place.rotation))
        etree.SubElement(joint, "origin", xyz=words(place.translation), rpy=turn)
        joint.set("type", "fixed")
    return locked, notes


# --- Pinocchio's model ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Tree:
    """Pinocchio's model of a URDF with the names that it does not keep."""

    model: pin.Model  # one scalar coordinate a joint, `model.nq == model.nv`
    links: tuple[str, ...]  # that each joint moves, by Pinocchio's index from 1 on
    mimics: tuple[dict[str, Any], ...]  # joints that follow another, as tables [[closure]]
    notes: tuple[str, ...]  # interpretations that differ from the text of the URDF
    # (10 · bodies,) dynamic parameters in which numbers that cannot be are zero, if there are any
    plausible: np.ndarray | None = None


def build_tree(robot: etree._Element, gravity: Sequence[float], where: str) -> Tree:
    """Return Pinocchio's model of a checked `<robot>`."""
    robot = copy.deepcopy(robot)
    notes: list[str] = []
    names = {link.get("name") for link in robot.findall("link")}
    used = {joint.find("parent").get("link") for joint in robot.findall("joint")}
    if "world" in used - names:
        robot.insert(0, etree.Element("link", name="world"))
        notes.append("the URDF does not declare the link 'world'; it is taken as the ground")
    # nothing here uses these, and urdfdom stumbles over some of them
    unused = ("dynamics", "safety_controller", "calibration", "visual", "collision")
    etree.strip_elements(robot, *unused, with_tail=False)
    for element in robot.iter("limit", "mass", "inertia"):
        for key, value in element.items():  # urdfdom stumbles over blanks around a number
            element.set(key, value.strip())
    for inertia in robot.iterfind("link/inertial/inertia"):  # urdfdom requires them
        for key in ("ixy", "ixz", "iyz"):
            inertia.set(key, inertia.get(key, "0"))
    verdicts = _verdicts(robot, where)
    notes += _said_together(verdicts)
    _remove(robot, {link: verdict for link, verdict in verdicts.items() if verdict.dummy})
    moving = [joint for joint in robot.findall("joint") if joint.get("type") != "fixed"]
    mimics = tuple(_take_mimics(moving, where))
    for joint in robot.findall("joint[@type='fixed'][mimic]"):
        notes.append(f"joint '{joint.get('name')}' is fixed, so its <mimic> is ignored")
    etree.strip_elements(robot, "mimic", with_tail=False)
    for joint in moving:
        limit = joint.find("limit")
        if joint.get("type") == "continuous" or limit is None:
            limit = etree.SubElement(joint, "limit") if limit is None else limit
            limit.attrib.update({"lower": f"-{UNLIMITED}", "upper": f"{UNLIMITED}"})
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
        for key in ("effort", "velocity"):
            limit.set(key, limit.get(key, f"{UNLIMITED}"))
    model = _pinocchio_model(robot, where)
    if model.nv == 0:
        raise MechanismError(
            f"{where}: has no joint that moves; every joint is fixed (a body that flies or "
            'drives: base = { kind = "floating" } in a mechanism.toml)'
        )
    model.gravity.linear = np.array(gravity)
    child = {j.get("name"): j.find("child").get("link") for j in robot.findall("joint")}
    links = tuple(child[name] for name in list(model.names)[1:])
    plausible = None
    if any(not verdict.dummy for verdict in verdicts.values()):
        _remove(robot, verdicts)
        bodies = _pinocchio_model(robot, where).inertias[1:]
        plausible = np.concatenate([body.toDynamicParameters() for body in bodies])
    return Tree(model, links, mimics, tuple(notes), plausible)


def _pinocchio_model(robot: etree._Element, where: str) -> pin.Model:
    try:
        return pin.buildModelFromXML(etree.tostring(robot).decode())
    except (RuntimeError, ValueError) as error:
        raise MechanismError(
            f"{where}: Pinocchio refuses it: {' '.join(str(error).split())}"
        ) from None


def _verdicts(robot: etree._Element, where: str) -> dict[str, BodyVerdict]:
    """Return why the numbers of links cannot be, by link: other units, and inertias that only
    satisfy a simulator, such as 1 kg m² at a milligram.
    """
    length, verdicts = _length(robot, where), dict[str, BodyVerdict]()
    for link in robot.iterfind("link[inertial]"):
        inertial = link.find("inertial")
        (m,) = attribute(inertial, "mass", "value", where)
        trace = sum(attribute(inertial, "inertia", key, where)[0] for key in ("ixx", "iyy", "izz"))
        centre = np.array(attribute(inertial, "origin", "xyz", where))
        if (verdict := verdict_of(m, centre, trace, length)) is not None:
            verdicts[str(link.get("name"))] = verdict
    return verdicts


def _said_together(verdicts: Mapping[str, BodyVerdict]) -> Iterator[str]:
    """Yield a note for each cause, with the numbers of its first link."""
    by_cause: dict[str, list[str]] = {}
    for link, verdict in verdicts.items():
        by_cause.setdefault(verdict.cause, []).append(f"'{link}'")
    for first, *others in by_cause.values():
        alike = f"; the same of {shortlist(others, NAMED)}" if others else ""
        yield f"link {first}: {verdicts[first[1:-1]].text}{alike}"


def _remove(robot: etree._Element, verdicts: Mapping[str, BodyVerdict]) -> None:
    """Set the numbers of links to zero that cannot be."""
    for link in robot.iterfind("link[inertial]"):
        inertial, verdict = link.find("inertial"), verdicts.get(link.get("name"))
        if verdict is not None and verdict.inertia:
            inertial.find("inertia").attrib.update(dict.fromkeys(TERMS, "0"))
        if verdict is not None and verdict.centre:
            inertial.find("origin").set("xyz", "0 0 0")


def _length(robot: etree._Element, where: str) -> float:
    """Return how far [m] the farthest joint is from the base, along the links and what slides."""
    before = {}
    for joint in robot.findall("joint"):
        step = float(np.linalg.norm(attribute(joint, "origin", "xyz", where)))
        if joint.get("type") == "prismatic":
            ends = [abs(attribute(joint, "limit", key, where)[0]) for key in ("lower", "upper")]
            step += max(ends) if max(ends) < LONGEST else 0.0
        before[joint.find("child").get("link")] = joint.find("parent").get("link"), step
    lengths = {}
    for link in before:
        total, at = 0.0, link
        while at in before:
            at, step = before[at]
            total += step
        lengths[link] = total
    return max(lengths.values(), default=0.0)


def _take_mimics(moving: Sequence[etree._Element], where: str) -> list[dict[str, Any]]:
    names, mimics, wrong = [joint.get("name") for joint in moving], [], []
    for joint in moving:
        if (mimic := joint.find("mimic")) is None:
            continue
        name, other = joint.get("name"), mimic.get("joint") or ""
        if other not in names or other == name:
            wrong.append((name, other, mimic))
        else:
            mimics.append(mimic_table(name, other, *_mimic_numbers(joint, where)))
    if wrong:
        (name, other, first), *others = wrong
        what = f"joint '{name}' mimics '{other}', which is no other joint of one coordinate; "
        what += one_of(other, [known for known in names if known != name])
        more = ", ".join(f"'{a}' mimics '{b}' (line {at.sourceline})" for a, b, at in others)
        what += f"; in the same way {more}" if more else ""
        locks = " ".join(f"--lock {known}" for known, *_ in wrong)
        refuse(first, where, f"{what}; correct the file, or take them as fixed: {locks}")
    return mimics


def _mimic_numbers(joint: etree._Element, where: str) -> list[float]:
    return [attribute(joint, "mimic", key, where)[0] for key in NUMBERS["mimic"]]


def mimic_table(joint: str, other: str, multiplier: float, offset: float) -> dict[str, Any]:
    """Return the table [[closure]] of q_joint = multiplier · q_other + offset."""
    return {
        "name": f"mimic.{joint}",
        "kind": "linear",
        "joints": [joint, other],
        "ratios": [1.0, -multiplier],
        "offset": offset,
    }


def tidy(values: np.ndarray) -> np.ndarray:
    """Return numbers without rounding errors beside 0 and 1."""
    nearest = np.round(values)
    return np.where(np.abs(values - nearest) < 1e-12, nearest, values)


def joint_axis(model: pin.Model, index: int) -> np.ndarray:
    """Return the unit axis (3,) of a joint with one coordinate, in the joint's frame."""
    joint = model.joints[index]
    data = joint.createData()
    joint.calc(data, np.zeros(model.nq))
    return tidy(np.asarray(data.S).reshape(2, 3).sum(axis=0))


def align_z(axis: np.ndarray) -> np.ndarray:
    """Return a rotation (3, 3) whose z is `axis`; its x is nearest to the frame's own x or y."""
    z = axis / np.linalg.norm(axis)
    seed = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    x = seed - z * (z @ seed)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def is_rotational(model: pin.Model, index: int) -> bool:
    """Return whether the joint's coordinate is an angle."""
    return bool(model.joints[index].shortname().startswith("JointModelR"))
