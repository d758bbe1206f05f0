"""An SDF model as a URDF with closures. Pinocchio's wheels are built without libsdformat.

Of two joints with the same child the first in the file that a URDF has carries it, and the other
closes a loop. A URDF's link has its origin at its joint: here at that of the joint that carries it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.description.axes import align_z
from ident.description.check_urdf import parse_xml
from ident.description.document import Document, Limits, Shape, Source, place_table
from ident.description.sdf_model import (
    axis_of,
    check_links,
    mimic_of,
    model_of,
    shapes_of,
    solid_of,
)
from ident.description.sdf_poses import Poses, text_of, value_of
from ident.errors import MechanismError, one_of

TREE = {
    "revolute": "revolute",
    "continuous": "continuous",
    "prismatic": "prismatic",
    "fixed": "fixed",
}
LOOP = {  # an SDF joint that closes a loop, and the kind of closure
    "revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed",
    "ball": "point", "universal": "universal",
}  # fmt: skip
EFFECTS = {"damping": "viscous", "friction": "coulomb", "spring_stiffness": "spring"}
NO_LIMIT = 1e15  # SDF's own default is 1e16


def read_sdf(path: Path, data: bytes) -> Source:
    """The only model of an SDF file, or of its world, that is not static.

    Raises:
        MechanismError: naming file, line, and what is not read: models within models, includes,
            joints whose state is no column of a log, bodies that hang free.
    """
    root = parse_xml(data, str(path))
    model, pose, gravity, notes = model_of(root, str(path))
    check_links(model, str(path))
    version = tuple(
        int(part) for part in (root.get("version") or "1.11").split(".") if part.isdigit()
    )
    return Reader(model, pose, version, str(path)).source(gravity, notes)


@dataclass(frozen=True, eq=False)
class Reader:
    """One `<model>`, where it stands in the world, and what is made of it."""

    model: etree._Element
    pose: pin.SE3
    version: tuple[int, ...]
    where: str

    def source(self, gravity: tuple[float, float, float] | None, notes: list[str]) -> Source:
        """All of it."""
        document = Document(self.model.get("name") or "", "written from an SDF model")
        document.link("world")
        for link in self.model.findall("link"):
            name = str(link.get("name"))
            offset = self.origin(name).inverse() * self.poses.of(name)
            document.link(name, solid_of(link, self.poses, offset), self._shapes(link, offset))
        for root in self.roots:
            placement = self.pose * self.origin(root)
            document.joint(f"{root}_to_world", "fixed", ("world", root), placement)
        for joint in self.carrying.values():
            self._add(document, joint)
        closures = [self._closure(joint) for joint in self.closing]
        mimics = [m for j in self.carrying.values() if (m := mimic_of(j, self.where))]
        return Source(
            urdf=document.text(),
            format="sdf",
            closures=(*closures, *mimics),
            passive=tuple(mimic["joints"][0] for mimic in mimics),
            gravity=gravity,
            notes=(*notes, *self._notes()),
        )

    @cached_property
    def poses(self) -> Poses:
        """In the model's frame."""
        return Poses(self.model, self.where)

    @cached_property
    def carrying(self) -> dict[str, etree._Element]:
        """By link, the joint whose child it is in the tree."""
        found: dict[str, etree._Element] = {}
        grounded = False
        for joint in self.model.findall("joint"):
            parent, child = self._ends(joint)
            if child in ("world", parent):
                raise MechanismError(
                    f"{self.where}:{joint.sourceline}: joint '{joint.get('name')}' leads from "
                    f"'{parent}' to '{child}'; its child must be another link"
                )
            grounded = grounded or parent == "world"
            first = found.setdefault(child, joint)
            if first.get("type") not in TREE and joint.get("type") in TREE:
                found[child] = joint
        if not grounded and len(found) == len(self.model.findall("link")):
            found.pop(self.poses.canonical, None)  # a ring, of which one link is the ground
        return found

    @cached_property
    def closing(self) -> list[etree._Element]:
        """Joints to a link that another joint carries."""
        carrying = list(self.carrying.values())
        return [joint for joint in self.model.findall("joint") if joint not in carrying]

    @cached_property
    def roots(self) -> list[str]:
        """Links that no joint carries: none, where a joint's parent is the world, or the ground."""
        links = [str(link.get("name")) for link in self.model.findall("link")]
        roots = [name for name in links if name not in self.carrying]
        parents = [self._ends(joint)[0] for joint in self.carrying.values()]
        if len(roots) + ("world" in parents) > 1:
            free = roots[-1]
            raise MechanismError(
                f"{self.where}: link '{free}' is no joint's child, and the ground is "
                f"'{'world' if 'world' in parents else roots[0]}': it would hang free; add a "
                "joint, or turn parent and child of its joints round"
            )
        return roots

    def origin(self, link: str) -> pin.SE3:
        """Of a URDF's link in the model's frame: at the joint that carries it."""
        if link == "world":
            return self.pose.inverse()
        joint = self.carrying.get(link)
        return self.poses.of(link if joint is None else str(joint.get("name")))

    def _ends(self, joint: etree._Element) -> tuple[str, str]:
        parent, child = (text_of(joint, end, self.where) for end in ("parent", "child"))
        return self.poses.link_of(parent), self.poses.link_of(child)

    def _kind(self, joint: etree._Element, valid: dict[str, str], why: str) -> str:
        kind = joint.get("type") or ""
        if kind not in valid:
            raise MechanismError(
                f"{self.where}:{joint.sourceline}: joint '{joint.get('name')}' is of type '{kind}'"
                f"{why}; {one_of(kind, valid)}"
            )
        return valid[kind]

    def _add(self, document: Document, joint: etree._Element) -> None:
        name = str(joint.get("name"))
        why = ", which only a joint that closes a loop may be" if joint.get("type") in LOOP else ""
        kind = self._kind(joint, TREE, why)
        ends = self._ends(joint)
        placement = self.origin(ends[0]).inverse() * self.poses.of(name)
        if kind == "fixed":
            document.joint(name, kind, ends, placement)
            return
        limits = self._limits(joint)
        if kind == "revolute" and not (np.isfinite(limits.lower) or np.isfinite(limits.upper)):
            kind = "continuous"
        axis = axis_of(joint, "axis", self.poses, self.version, self.where)
        document.joint(name, kind, ends, placement, axis, limits)

    def _limits(self, joint: etree._Element) -> Limits:
        values = [
            value_of(joint.find("axis"), f"limit/{key}", sign * np.inf, self.where, finite=False)
            for key, sign in (("lower", -1), ("upper", 1), ("velocity", 1), ("effort", 1))
        ]
        lower, upper, velocity, effort = (
            x if abs(x) < NO_LIMIT else float(np.copysign(np.inf, x)) for x in values
        )
        return Limits(
            lower, upper, velocity if velocity >= 0 else np.inf, effort if effort >= 0 else np.inf
        )

    def _closure(self, joint: etree._Element) -> dict[str, Any]:
        """The table [[closure]] of a joint whose child hangs on another already."""
        name = str(joint.get("name"))
        kind = self._kind(joint, LOOP, "")
        R = np.eye(3)
        if kind in ("revolute", "prismatic", "universal"):
            axis = axis_of(joint, "axis", self.poses, self.version, self.where)
            R = align_z(axis)
        if kind == "universal":  # a's x and b's y stay at right angles
            other = axis_of(joint, "axis2", self.poses, self.version, self.where)
            if abs(axis @ other) > 1e-6:
                raise MechanismError(
                    f"{self.where}:{joint.sourceline}: the axes of universal joint '{name}' are "
                    "not at right angles"
                )
            R = np.column_stack([axis, other, np.cross(axis, other)])
        at = self.poses.of(name) * pin.SE3(R, np.zeros(3))
        a, b = (place_table(link, self.origin(link).inverse() * at) for link in self._ends(joint))
        return {"name": name, "kind": kind, "a": a, "b": b}

    def _shapes(self, link: etree._Element, offset: pin.SE3) -> list[Shape]:
        return shapes_of(link, self.poses, offset)

    def _notes(self) -> list[str]:
        notes = [
            f"link '{root}' is taken as the ground, where it stands at first" for root in self.roots
        ]
        notes += [f"joint '{joint.get('name')}' closes a loop" for joint in self.closing]
        bare = [
            str(link.get("name"))
            for link in self.model.findall("link")
            if link.get("name") in self.carrying
            and (link.find("inertial/mass") is None or link.find("inertial/inertia") is None)
        ]
        if bare:
            notes.append(
                f"{', '.join(bare)}: no mass or inertia written, so SDF's 1 kg or 1 kg m² holds"
            )
        for word, effect in EFFECTS.items():
            having = [
                str(joint.get("name"))
                for joint in self.carrying.values()
                if value_of(joint.find("axis"), f"dynamics/{word}", 0.0, self.where)
            ]
            if having:
                notes.append(
                    f"{word} of {', '.join(having)} is not taken over; to identify it: --with "
                    + (effect if len(having) > 1 else f"{effect}:{having[0]}")
                )
        away = [
            name
            for name in self.carrying
            if not self.origin(name).isApprox(self.poses.of(name), 1e-9)
        ]
        if away:
            notes.append(f"{', '.join(away)}: the link's origin is at its joint, not at the body's")
        return notes
