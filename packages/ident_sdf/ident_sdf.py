"""An SDF model as a URDF with closures. Pinocchio's wheels are built without libsdformat.

Of two joints with the same child the first in the file that a URDF can have carries it, and the
other closes a loop. A URDF's link has its origin at its joint: here at that of the joint that
carries it.
"""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.errors import MechanismError, one_of
from ident.files import HUGE, regular
from ident.mechanism.description import Description, align_z, mimic_table, parse_xml, refuse
from ident.mechanism.urdf import RigidBody, UrdfWriter, Visual, effect_notes, place_table

TREE = ("revolute", "continuous", "prismatic", "fixed")  # joints that a URDF has, too
SEVERAL = ("ball", "universal")  # in the tree where no other joint carries the link
LOOP = {  # a joint that closes a loop, and the kind of closure
    "revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed",
    "ball": "point", "universal": "universal",
}  # fmt: skip
DYNAMICS = ("damping", "friction", "spring_stiffness")  # that are effects here
NO_LIMIT = 1e15  # SDF's own default is 1e16
MODEL = "__model__"
INERTIA = (("ixx", 0, 0), ("iyy", 1, 1), ("izz", 2, 2), ("ixy", 0, 1), ("ixz", 0, 2), ("iyz", 1, 2))
TRUE = ("true", "1")


def read_sdf(path: Path) -> Description:
    """Read the only model of an SDF file, or of its world, that is not static."""
    where = str(path)
    root = parse_xml(regular(path).read_bytes(), where)
    if root.tag != "sdf":
        refuse(root, where, f"the root element is <{root.tag}>, an SDF's is <sdf>")
    world = root.find("world")
    place = root if world is None else world
    moving = [m for m in place.findall("model") if _text(m, "static") not in TRUE]
    if len(moving) != 1:
        names = ", ".join(str(m.get("name")) for m in moving) or "none"
        raise MechanismError(
            f"{where}: {len(moving)} models that are not static ({names}); one is expected"
        )
    model = moving[0]
    for tag in ("include", "model"):
        for inner in model.findall(tag):
            refuse(
                inner,
                where,
                f"a <{tag}> within the model is not read; write one model (gz sdf -p prints one)",
            )
    includes = len(place.findall("include"))
    notes = [f"{includes} <include> beside the model left out"] if includes else []
    element = None if world is None else world.find("gravity")
    gravity = None
    if element is not None:
        x, y, z = _values(element, 3, where)
        gravity = (x, y, z)
    version = [int(part) for part in (root.get("version") or "1.11").split(".") if part.isdigit()]
    return _SdfModel(model, tuple(version), where).description(gravity, notes)


class _SdfModel:
    """One `<model>`: where its links, joints and frames are, and which joint carries which link."""

    def __init__(self, model: etree._Element, version: tuple[int, ...], where: str) -> None:
        self.model, self.version, self.where = model, version, where
        self.pose, base = _pose(model, where)
        if base not in ("", "world"):
            refuse(model, where, f"the model's pose is relative to '{base}'")
        self.links = {str(link.get("name")): link for link in model.findall("link")}
        self.named: dict[str, etree._Element] = {}
        for element in [e for tag in ("link", "joint", "frame") for e in model.findall(tag)]:
            name = element.get("name") or ""
            if not name or name == "world" or name in self.named:
                what = f"is named '{name}' as another is" if name else "has no name"
                refuse(element, where, f"a <{element.tag}> {what}")
            self.named[name] = element
        self.poses = {MODEL: pin.SE3.Identity()}

    def refuse(self, element: etree._Element, message: str) -> NoReturn:
        """Raise MechanismError with the line of an element."""
        refuse(element, self.where, message)

    def description(
        self, gravity: tuple[float, float, float] | None, notes: list[str]
    ) -> Description:
        """Return the model as a URDF with closures."""
        urdf = UrdfWriter(self.model.get("name") or "", "written from an SDF model")
        urdf.link("world")
        for name, link in self.links.items():
            offset = self.origin(name).inverse() * self.pose_of(name)
            urdf.link(name, self._body(link, offset), self._visuals(link, offset))
        for root in self.roots:
            placement = self.pose * self.origin(root)
            urdf.joint(f"{root}_to_world", "fixed", ("world", root), placement)
        for joint in self.carrying.values():
            self._add(urdf, joint)
        mimics = [m for j in self.carrying.values() if (m := self._mimic(j))]
        crosses = [j for j in self.carrying.values() if j.get("type") == "universal"]
        names = [str(joint.get("name")) for joint in crosses]
        return Description(
            urdf=urdf.text(),
            format="sdf",
            closures=(*(self._closure(joint) for joint in self.closing), *mimics),
            passive=(
                *(mimic["joints"][0] for mimic in mimics),
                *(f"{name}.{i}" for name in names for i in (1, 2)),
            ),
            auxiliary=tuple(f"{name}.cross" for name in names),
            gravity=gravity,
            notes=(*notes, *self._notes()),
        )

    # --- poses ----------------------------------------------------------------------------------

    def pose_of(self, name: str, above: tuple[str, ...] = ()) -> pin.SE3:
        """Return the pose of a link, joint or frame in the model's frame."""
        if name in above:
            raise MechanismError(
                f"{self.where}: the poses of {', '.join(above)} refer to each other in a ring; "
                "give one of them relative to the model"
            )
        if name not in self.poses:
            element = self._element(name)
            place, base = _pose(element, self.where)
            base = base or (MODEL if element.tag == "link" else self._attached(element))
            self.poses[name] = self.pose_of(base, (*above, name)) * place
        return self.poses[name]

    def link_of(self, name: str, above: tuple[str, ...] = ()) -> str:
        """Return the link that a frame is attached to; a link's own name, or "world"."""
        if name == MODEL:
            return self.canonical
        if name == "world" or self._element(name).tag == "link":
            return name
        if name in above:
            raise MechanismError(
                f"{self.where}: the frames {', '.join(above)} are attached to each other in a ring"
            )
        return self.link_of(self._attached(self._element(name)), (*above, name))

    def _attached(self, element: etree._Element) -> str:
        if element.tag == "joint":
            return self._end(element, "child")
        return element.get("attached_to") or MODEL

    def _element(self, name: str) -> etree._Element:
        if name not in self.named:
            raise MechanismError(f"{self.where}: no frame '{name}'; {one_of(name, self.named)}")
        return self.named[name]

    @property
    def canonical(self) -> str:
        """The model's canonical link: the first one, unless the model names another."""
        return self.model.get("canonical_link") or next(iter(self.links), "")

    def _within(self, element: etree._Element, link: etree._Element) -> pin.SE3:
        place, base = _pose(element, self.where)
        if not base:
            return place
        return self.pose_of(str(link.get("name"))).inverse() * self.pose_of(base) * place

    # --- the tree -------------------------------------------------------------------------------

    @cached_property
    def carrying(self) -> dict[str, etree._Element]:
        """By link, the joint whose child it is in the tree."""
        carrying: dict[str, etree._Element] = {}
        grounded = False
        for joint in self.model.findall("joint"):
            parent, child = self._ends(joint)
            if child in ("world", parent):
                self.refuse(
                    joint,
                    f"joint '{joint.get('name')}' leads from "
                    f"'{parent}' to '{child}'; its child must be another link",
                )
            grounded = grounded or parent == "world"
            first = carrying.setdefault(child, joint)
            if first.get("type") not in TREE and joint.get("type") in TREE:
                carrying[child] = joint
        if not grounded and len(carrying) == len(self.links):
            carrying.pop(self.canonical, None)  # a ring, of which one link is the ground
        return carrying

    @cached_property
    def closing(self) -> list[etree._Element]:
        """Joints to a link that another joint carries."""
        carrying = list(self.carrying.values())
        return [joint for joint in self.model.findall("joint") if joint not in carrying]

    @cached_property
    def roots(self) -> list[str]:
        """Links that no joint carries: the ground, or none where a joint's parent is the world."""
        roots = [name for name in self.links if name not in self.carrying]
        in_world = "world" in [self._ends(joint)[0] for joint in self.carrying.values()]
        if len(roots) + in_world > 1:
            raise MechanismError(
                f"{self.where}: link '{roots[-1]}' is no joint's child, and the ground is "
                f"'{'world' if in_world else roots[0]}': it would hang free; add a joint, or turn "
                "parent and child of its joints round"
            )
        return roots

    def origin(self, link: str) -> pin.SE3:
        """Return the frame of a URDF's link in the model's: at the joint that carries it."""
        if link == "world":
            return self.pose.inverse()
        joint = self.carrying.get(link)
        return self.pose_of(link if joint is None else str(joint.get("name")))

    def _ends(self, joint: etree._Element) -> tuple[str, str]:
        return self.link_of(self._end(joint, "parent")), self.link_of(self._end(joint, "child"))

    def _end(self, joint: etree._Element, tag: str) -> str:
        name = _text(joint, tag)
        if not name:
            self.refuse(joint, f"joint '{joint.get('name')}' has no <{tag}>")
        if "::" in name:
            self.refuse(
                joint,
                f"'{name}' is in a model within the model, which is not read; write one "
                "model (gz sdf -p prints one)",
            )
        return name

    # --- bodies ---------------------------------------------------------------------------------

    def _body(self, link: etree._Element, offset: pin.SE3) -> RigidBody:
        inertial = link.find("inertial")
        if inertial is None:
            return RigidBody(1.0, np.zeros(3), np.eye(3)).expressed_at(offset)
        if inertial.get("auto") in TRUE:
            self.refuse(
                inertial,
                f"the inertia of link '{link.get('name')}' is to be worked out of its "
                "shapes; write its numbers (gz sdf --inertial-stats prints them)",
            )
        tensor = np.zeros((3, 3))
        for key, i, j in INERTIA:
            default = 1.0 if i == j else 0.0  # as SDF has it
            tensor[i, j] = tensor[j, i] = self._value(inertial, f"inertia/{key}", default)
        mass = self._value(inertial, "mass", 1.0)
        if mass < 0:
            self.refuse(
                inertial, f"link '{link.get('name')}' has the mass {mass:g} kg; it must be ≥ 0"
            )
        return RigidBody(mass, np.zeros(3), tensor).expressed_at(
            offset * self._within(inertial, link)
        )

    def _visuals(self, link: etree._Element, offset: pin.SE3) -> list[Visual]:
        visuals = []
        for visual in link.findall("visual"):
            at = offset * self._within(visual, link)
            for shape in visual.findall("geometry/*"):
                values = {str(part.tag): (part.text or "").strip() for part in shape}
                if shape.tag == "mesh" and "uri" in values:
                    mesh = {"filename": values["uri"], "scale": values.get("scale", "1 1 1")}
                    visuals.append(Visual("mesh", mesh, at))
                elif shape.tag in ("box", "sphere", "cylinder"):
                    sizes = {k: v for k, v in values.items() if k in ("size", "radius", "length")}
                    visuals.append(Visual(str(shape.tag), sizes, at))
        return visuals

    # --- joints ---------------------------------------------------------------------------------

    def _add(self, urdf: UrdfWriter, joint: etree._Element) -> None:
        name, kind = str(joint.get("name")), joint.get("type") or ""
        if kind not in (*TREE, *SEVERAL):
            valid = one_of(kind, (*TREE, *SEVERAL))
            self.refuse(joint, f"joint '{name}' is of type '{kind}'; {valid}")
        ends = self._ends(joint)
        placement = self.origin(ends[0]).inverse() * self.pose_of(name)
        if kind == "ball":
            urdf.joint(name, kind, ends, placement)
            return
        if kind == "universal":  # two turns, the first about the parent's axis
            between = f"{name}.cross"
            urdf.link(between)
            first, second = (self._axis(joint, tag) for tag in ("axis", "axis2"))
            urdf.joint(f"{name}.1", "continuous", (ends[0], between), placement, first)
            at = pin.SE3.Identity()
            urdf.joint(f"{name}.2", "continuous", (between, ends[1]), at, second)
            return
        if kind == "fixed":
            urdf.joint(name, kind, ends, placement)
            return
        lower, upper, velocity, effort = (
            x if abs(x) < NO_LIMIT else math.copysign(math.inf, x)
            for x in (
                self._value(joint, f"axis/limit/{key}", sign * math.inf, finite=False)
                for key, sign in (("lower", -1), ("upper", 1), ("velocity", 1), ("effort", 1))
            )
        )
        if kind == "revolute" and not (math.isfinite(lower) or math.isfinite(upper)):
            kind = "continuous"
        limits = {  # negative: none
            "velocity": velocity if velocity >= 0 else math.inf,
            "effort": effort if effort >= 0 else math.inf,
        }
        axis = self._axis(joint, "axis")
        urdf.joint(name, kind, ends, placement, axis, lower=lower, upper=upper, **limits)

    def _axis(self, joint: etree._Element, tag: str) -> np.ndarray:
        axis, name = joint.find(tag), joint.get("name")
        if axis is None:
            self.refuse(joint, f"joint '{name}' has no <{tag}>")
        xyz = axis.find("xyz")
        direction = np.array([0.0, 0.0, 1.0] if xyz is None else _values(xyz, 3, self.where))
        if np.linalg.norm(direction) < 1e-9:
            self.refuse(axis, f"joint '{name}' has the axis 0 0 0; give a direction")
        frame = "" if xyz is None else xyz.get("expressed_in") or ""
        if _text(axis, "use_parent_model_frame") in TRUE or self.version < (1, 5):
            frame = MODEL  # as SDF had it before 1.7, and always before 1.5
        if frame:
            joint_pose = self.pose_of(str(name))
            direction = joint_pose.rotation.T @ self.pose_of(frame).rotation @ direction
        return direction / np.linalg.norm(direction)

    def _closure(self, joint: etree._Element) -> dict[str, Any]:
        name, kind = str(joint.get("name")), joint.get("type") or ""
        if kind not in LOOP:
            self.refuse(joint, f"joint '{name}' is of type '{kind}'; {one_of(kind, LOOP)}")
        R = np.eye(3)
        if LOOP[kind] in ("revolute", "prismatic", "universal"):
            R = align_z(axis := self._axis(joint, "axis"))
        if kind == "universal":  # a's x and b's y stay at right angles
            other = self._axis(joint, "axis2")
            if abs(axis @ other) > 1e-6:
                self.refuse(joint, f"the axes of universal joint '{name}' are not at right angles")
            R = np.column_stack([axis, other, np.cross(axis, other)])
        at = self.pose_of(name) * pin.SE3(R, np.zeros(3))
        a, b = (place_table(link, self.origin(link).inverse() * at) for link in self._ends(joint))
        return {"name": name, "kind": LOOP[kind], "a": a, "b": b}

    def _mimic(self, joint: etree._Element) -> dict[str, Any] | None:
        mimic = joint.find("axis/mimic")
        if mimic is None:
            return None
        m = self._value(mimic, "multiplier", 1.0)
        offset = self._value(mimic, "offset", 0.0) - m * self._value(mimic, "reference", 0.0)
        return mimic_table(str(joint.get("name")), mimic.get("joint") or "", m, offset)

    def _notes(self) -> list[str]:
        notes = [
            f"link '{root}' is taken as the ground, where it stands at first" for root in self.roots
        ]
        notes += [f"joint '{joint.get('name')}' closes a loop" for joint in self.closing]
        bare = [
            name
            for name, link in self.links.items()
            if name in self.carrying
            and (link.find("inertial/mass") is None or link.find("inertial/inertia") is None)
        ]
        if bare:
            notes.append(
                f"{', '.join(bare)}: no mass or inertia written, so SDF's 1 kg or 1 kg m² holds"
            )
        joints = self.carrying.values()
        having = {
            word: [str(j.get("name")) for j in joints if self._value(j, f"axis/dynamics/{word}", 0)]
            for word in DYNAMICS
        }
        notes += effect_notes(having)
        shifted = [n for n in self.carrying if not self.origin(n).isApprox(self.pose_of(n), 1e-9)]
        if shifted:
            notes.append(
                f"{', '.join(shifted)}: the link's origin is at its joint, not at the body's"
            )
        return notes

    def _value(
        self, element: etree._Element, path: str, default: float, finite: bool = True
    ) -> float:
        inner = element.find(path)
        return default if inner is None else _values(inner, 1, self.where, finite=finite)[0]


def _pose(element: etree._Element, where: str) -> tuple[pin.SE3, str]:
    pose = element.find("pose")
    if pose is None:
        return pin.SE3.Identity(), ""
    if pose.get("frame"):
        refuse(
            pose,
            where,
            '<pose frame=…> is of SDF before 1.7 and was never defined; write relative_to="…"',
        )
    base = pose.get("relative_to") or ""
    if pose.get("rotation_format") == "quat_xyzw":
        x = _values(pose, 7, where)
        if math.hypot(*x[3:]) < 1e-9:
            refuse(pose, where, "a quaternion of length zero")
        R = pin.Quaternion(x[6], x[3], x[4], x[5]).normalized().matrix()
        return pin.SE3(R, np.array(x[:3])), base
    x = _values(pose, 6, where, default="0 0 0 0 0 0")
    unit = math.pi / 180 if pose.get("degrees") in TRUE else 1.0
    return pin.SE3(pin.rpy.rpyToMatrix(*(unit * a for a in x[3:])), np.array(x[:3])), base


def _values(
    element: etree._Element, count: int, where: str, default: str = "", finite: bool = True
) -> list[float]:
    text = (element.text or "").strip() or default
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or (finite and not all(abs(x) < HUGE for x in values)):
        refuse(
            element,
            where,
            f"<{element.tag}>{text}</{element.tag}>: {count} finite "
            f"number{'s' * (count > 1)} expected",
        )
    return values


def _text(element: etree._Element, tag: str) -> str:
    return (element.findtext(tag) or "").strip()
