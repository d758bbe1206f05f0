"""Parts of an SDF: which model is meant, and its bodies, shapes, axes and mimicking joints."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.description.document import Shape, Solid
from ident.description.sdf_poses import Poses, pose_of, value_of, values_of
from ident.errors import MechanismError

INERTIA = (("ixx", 0, 0), ("iyy", 1, 1), ("izz", 2, 2), ("ixy", 0, 1), ("ixz", 0, 2), ("iyz", 1, 2))


def model_of(
    root: etree._Element, where: str
) -> tuple[etree._Element, pin.SE3, tuple[float, float, float] | None, list[str]]:
    """The model, its pose in the world, gravity [m/s²] where the file gives it, and notes.

    Raises:
        MechanismError: if there is not exactly one that moves, or it is put together from others.
    """
    world = root.find("world")
    place = root if world is None else world
    moving = [m for m in place.findall("model") if _text(m, "static") not in ("true", "1")]
    if len(moving) != 1:
        names = ", ".join(str(m.get("name")) for m in moving) or "none"
        raise MechanismError(
            f"{where}: {len(moving)} models that are not static ({names}); one is expected"
        )
    model = moving[0]
    for tag in ("include", "model"):
        for inner in model.findall(tag):
            raise MechanismError(
                f"{where}:{inner.sourceline}: a <{tag}> within the model is not read; write one "
                "model (gz sdf -p prints one)"
            )
    notes = []
    left = place.findall("include")
    if left:
        notes.append(f"{len(left)} <include> beside the model left out")
    element = None if world is None else world.find("gravity")
    gravity = None
    if element is not None:
        x, y, z = values_of(element, 3, where)
        gravity = (x, y, z)
    pose, base = pose_of(model, where)
    if base not in ("", "world"):
        raise MechanismError(
            f"{where}:{model.sourceline}: the model's pose is relative to '{base}'"
        )
    return model, pose, gravity, notes


def check_links(model: etree._Element, where: str) -> None:
    """Refuse links and joints without a name, and joints between what is no link.

    Raises:
        MechanismError: naming the line.
    """
    seen: set[str] = {"world"}
    for element in [e for tag in ("link", "joint", "frame") for e in model.findall(tag)]:
        name = element.get("name") or ""
        if not name or name in seen:
            what = f"is named '{name}' as another is" if name else "has no name"
            raise MechanismError(f"{where}:{element.sourceline}: a <{element.tag}> {what}")
        seen.add(name)


def solid_of(link: etree._Element, poses: Poses, offset: pin.SE3) -> Solid:
    """A link's body in the frame in which the link's own stands at `offset`."""
    inertial = link.find("inertial")
    if inertial is None:
        return Solid(1.0, np.zeros(3), np.eye(3)).moved(offset)
    if inertial.get("auto") in ("true", "1"):
        raise MechanismError(
            f"{poses.where}:{inertial.sourceline}: the inertia of link '{link.get('name')}' is to "
            "be worked out of its shapes; write its numbers (gz sdf --inertial-stats prints them)"
        )
    tensor = np.zeros((3, 3))
    for key, i, j in INERTIA:
        default = 1.0 if i == j else 0.0  # as SDF has it
        tensor[i, j] = tensor[j, i] = value_of(inertial, f"inertia/{key}", default, poses.where)
    mass = value_of(inertial, "mass", 1.0, poses.where)
    if mass < 0:
        raise MechanismError(
            f"{poses.where}:{inertial.sourceline}: link '{link.get('name')}' has the mass {mass:g} "
            "kg; it must be ≥ 0"
        )
    at = offset * poses.within(inertial, str(link.get("name")))
    return Solid(mass, np.zeros(3), tensor).moved(at)


def shapes_of(link: etree._Element, poses: Poses, offset: pin.SE3) -> list[Shape]:
    """What a link looks like, of the shapes that a URDF has."""
    found = []
    for visual in link.findall("visual"):
        at = offset * poses.within(visual, str(link.get("name")))
        for shape in visual.findall("geometry/*"):
            words = {str(part.tag): (part.text or "").strip() for part in shape}
            if shape.tag == "mesh" and "uri" in words:
                attributes = {"filename": words["uri"], "scale": words.get("scale", "1 1 1")}
                found.append(Shape("mesh", attributes, at))
            elif shape.tag in ("box", "sphere", "cylinder"):
                kept = {k: v for k, v in words.items() if k in ("size", "radius", "length")}
                found.append(Shape(str(shape.tag), kept, at))
    return found


def axis_of(
    joint: etree._Element, tag: str, poses: Poses, version: tuple[int, ...], where: str
) -> np.ndarray:
    """The unit axis (3,) of a joint in the joint's frame.

    Raises:
        MechanismError: if it has none, or it has no direction.
    """
    axis = joint.find(tag)
    xyz = None if axis is None else axis.find("xyz")
    if axis is None:
        raise MechanismError(
            f"{where}:{joint.sourceline}: joint '{joint.get('name')}' has no <{tag}>"
        )
    given = np.array([0.0, 0.0, 1.0] if xyz is None else values_of(xyz, 3, where))
    if np.linalg.norm(given) < 1e-9:
        raise MechanismError(
            f"{where}:{axis.sourceline}: joint '{joint.get('name')}' has the axis 0 0 0; give a "
            "direction"
        )
    frame = "" if xyz is None else xyz.get("expressed_in") or ""
    if _text(axis, "use_parent_model_frame") in ("true", "1") or version < (1, 5):
        frame = "__model__"  # as SDF had it before 1.7, and always before 1.5
    if frame:
        own = poses.of(str(joint.get("name")))
        given = own.rotation.T @ poses.of(frame).rotation @ given
    return given / np.linalg.norm(given)


def mimic_of(joint: etree._Element, where: str) -> dict[str, Any] | None:
    """The table [[closure]] of a joint that follows another: q = m (q' − reference) + offset."""
    mimic = joint.find("axis/mimic")
    if mimic is None:
        return None
    m = value_of(mimic, "multiplier", 1.0, where)
    offset = value_of(mimic, "offset", 0.0, where) - m * value_of(mimic, "reference", 0.0, where)
    name = str(joint.get("name"))
    return {
        "name": f"mimic.{name}",
        "kind": "linear",
        "joints": [name, mimic.get("joint") or ""],
        "ratios": [1.0, -m],
        "offset": offset,
    }


def _text(element: etree._Element, tag: str) -> str:
    return (element.findtext(tag) or "").strip()
