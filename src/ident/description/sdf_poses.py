"""Where the links, joints and frames of an SDF model stand, each given relative to another."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.description.check_urdf import HUGE
from ident.errors import MechanismError, one_of

MODEL = "__model__"


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses in the model's frame, by the name of a link, joint or frame."""

    model: etree._Element
    where: str
    known: dict[str, pin.SE3] = field(default_factory=lambda: {MODEL: pin.SE3.Identity()})

    def of(self, name: str, asked: tuple[str, ...] = ()) -> pin.SE3:
        """The pose of a link, joint or frame.

        Raises:
            MechanismError: if there is none of this name, or poses refer to each other in a ring.
        """
        if name in self.known:
            return self.known[name]
        if name in asked:
            raise MechanismError(
                f"{self.where}: the poses of {', '.join(asked)} refer to each other in a ring; "
                "give one of them relative to the model"
            )
        element = self._element(name)
        default = MODEL
        if element.tag == "joint":
            default = text_of(element, "child", self.where)
        elif element.tag == "frame":
            default = element.get("attached_to") or MODEL
        place, base = pose_of(element, self.where)
        self.known[name] = self.of(base or default, (*asked, name)) * place
        return self.known[name]

    def link_of(self, name: str, asked: tuple[str, ...] = ()) -> str:
        """The link that a frame is attached to; a link's own name, or "world".

        Raises:
            MechanismError: if there is none of this name, or frames hang on each other in a ring.
        """
        element = None if name in ("world", MODEL) else self._element(name)
        if element is None:
            return self.canonical if name == MODEL else name
        if element.tag == "link":
            return name
        if name in asked:
            raise MechanismError(
                f"{self.where}: the frames {', '.join(asked)} are attached to each other in a ring"
            )
        to = element.get("attached_to") or MODEL
        if element.tag == "joint":
            to = text_of(element, "child", self.where)
        return self.link_of(to, (*asked, name))

    @property
    def canonical(self) -> str:
        """The model's first link, or the one it says is the canonical one."""
        first = self.model.find("link")
        given = self.model.get("canonical_link")
        return given or ("" if first is None else str(first.get("name")))

    def within(self, element: etree._Element, owner: str) -> pin.SE3:
        """The pose in a link's frame of something in that link: its inertia, a visual."""
        place, base = pose_of(element, self.where)
        return place if not base else self.of(owner).inverse() * self.of(base) * place

    def _element(self, name: str) -> etree._Element:
        named = [e for tag in ("link", "joint", "frame") for e in self.model.findall(tag)]
        for element in named:
            if element.get("name") == name:
                return element
        valid = [str(element.get("name")) for element in named]
        raise MechanismError(f"{self.where}: no frame '{name}'; {one_of(name, valid)}")


def pose_of(element: etree._Element, where: str) -> tuple[pin.SE3, str]:
    """The element's `<pose>`, and the name it is relative to, "" where it says none.

    Raises:
        MechanismError: for anything but six numbers, or seven with a quaternion.
    """
    pose = element.find("pose")
    if pose is None:
        return pin.SE3.Identity(), ""
    if pose.get("frame"):
        raise MechanismError(
            f"{where}:{pose.sourceline}: <pose frame=…> is of SDF before 1.7 and was never "
            'defined; write relative_to="…"'
        )
    base = pose.get("relative_to") or ""
    if pose.get("rotation_format") == "quat_xyzw":
        x = values_of(pose, 7, where)
        length = math.hypot(*x[3:])
        if length < 1e-9:
            raise MechanismError(f"{where}:{pose.sourceline}: a quaternion of length zero")
        R = pin.Quaternion(x[6], x[3], x[4], x[5]).normalized().matrix()
        return pin.SE3(R, np.array(x[:3])), base
    x = values_of(pose, 6, where, default="0 0 0 0 0 0")
    unit = math.pi / 180 if pose.get("degrees") in ("true", "1") else 1.0
    return pin.SE3(pin.rpy.rpyToMatrix(*(unit * a for a in x[3:])), np.array(x[:3])), base


def values_of(
    element: etree._Element, count: int, where: str, default: str = "", finite: bool = True
) -> list[float]:
    """The numbers that are an element's text.

    Raises:
        MechanismError: if there are not `count` of them, or one is not finite.
    """
    text = (element.text or "").strip() or default
    try:
        found = [float(word) for word in text.split()]
    except ValueError:
        found = []
    if len(found) != count or (finite and not all(abs(x) < HUGE for x in found)):
        raise MechanismError(
            f"{where}:{element.sourceline}: <{element.tag}>{text}</{element.tag}>: {count} finite "
            f"number{'s' * (count > 1)} expected"
        )
    return found


def value_of(
    element: etree._Element | None, path: str, default: float, where: str, finite: bool = True
) -> float:
    """The number at a path below an element, or what holds where there is none.

    Raises:
        MechanismError: as `values_of`.
    """
    inner = None if element is None else element.find(path)
    return default if inner is None else values_of(inner, 1, where, finite=finite)[0]


def text_of(element: etree._Element, tag: str, where: str) -> str:
    """The text of a child that must be there.

    Raises:
        MechanismError: if it is not, or names what is in another model.
    """
    inner = element.find(tag)
    text = "" if inner is None else (inner.text or "").strip()
    if not text:
        raise MechanismError(
            f"{where}:{element.sourceline}: {element.tag} '{element.get('name')}' has no <{tag}>"
        )
    if "::" in text:
        raise MechanismError(
            f"{where}:{element.sourceline}: '{text}' is in a model within the model, which is not "
            "read; write one model (gz sdf -p prints one)"
        )
    return text
