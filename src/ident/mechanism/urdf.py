"""URDFs written: from bodies and joints of another format, or with other inertias."""

from __future__ import annotations

import codecs
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.effects.library import KINDS
from ident.mechanism.description import TERMS, UNLIMITED, numbers, parse_urdf, words
from ident.mechanism.parameters import about_origin, split

UPPER = np.triu_indices(3)
NO_LIMITS = {"lower": -np.inf, "upper": np.inf, "velocity": np.inf, "effort": np.inf}


@dataclass(frozen=True)
class RigidBody:
    """A rigid body in a link's frame; not a pin.Inertia, which refuses impossible tensors."""

    mass: float  # [kg]
    centre: np.ndarray  # (3,) [m]
    inertia: np.ndarray  # (3, 3) [kg m²] about the centre

    def expressed_at(self, placement: pin.SE3) -> RigidBody:
        """Return the body in a frame in which its own is at `placement`."""
        R = placement.rotation
        return RigidBody(self.mass, placement.act(self.centre), R @ self.inertia @ R.T)


@dataclass(frozen=True)
class Visual:
    """A shape to be shown."""

    kind: str  # `box`, `sphere`, `cylinder` or `mesh`
    attributes: Mapping[str, str]  # of the URDF's element
    placement: pin.SE3  # in the link's frame


class UrdfWriter:
    """A `<robot>` that grows link by link and joint by joint."""

    def __init__(self, name: str, comment: str) -> None:
        self.robot = etree.Element("robot", name=name or "robot")
        self.robot.append(etree.Comment(f" {comment.replace('--', '- -')} "))

    def link(
        self, name: str, body: RigidBody | None = None, visuals: Sequence[Visual] = ()
    ) -> None:
        """Append a link with its inertia and its shapes."""
        link = etree.SubElement(self.robot, "link", name=name)
        if body is not None and (body.mass or np.any(body.inertia)):
            inertial = etree.SubElement(link, "inertial")
            etree.SubElement(inertial, "origin", xyz=words(body.centre), rpy="0 0 0")
            etree.SubElement(inertial, "mass", value=words([body.mass]))
            tensor = etree.SubElement(inertial, "inertia")
            for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
                tensor.set("i" + "xyz"[i] + "xyz"[j], words([body.inertia[i, j]]))
        for shape in visuals:
            visual = etree.SubElement(link, "visual")
            self._origin(visual, shape.placement)
            geometry = etree.SubElement(visual, "geometry")
            etree.SubElement(geometry, shape.kind, dict(shape.attributes))

    def joint(
        self,
        name: str,
        kind: str,
        ends: tuple[str, str],
        placement: pin.SE3,
        axis: np.ndarray | None = None,
        **limits: float,
    ) -> None:
        """Append a joint of type `kind` from a parent to a child link, both named by `ends`.

        `limits` are `lower` and `upper` [rad | m], `velocity` and `effort`.
        """
        joint = etree.SubElement(self.robot, "joint", name=name, type=kind)
        etree.SubElement(joint, "parent", link=ends[0])
        etree.SubElement(joint, "child", link=ends[1])
        self._origin(joint, placement)
        if axis is not None:
            etree.SubElement(joint, "axis", xyz=words(axis))
            if kind != "continuous" or any(np.isfinite(x) for x in limits.values()):
                limit = etree.SubElement(joint, "limit")  # urdfdom wants all four
                for key, x in {**NO_LIMITS, **limits}.items():
                    limit.set(key, words([np.clip(x, -UNLIMITED, UNLIMITED)]))

    @staticmethod
    def _origin(element: etree._Element, placement: pin.SE3) -> None:
        rpy = pin.rpy.matrixToRpy(placement.rotation)
        etree.SubElement(element, "origin", xyz=words(placement.translation), rpy=words(rpy))

    def text(self) -> bytes:
        """Return the text of the file."""
        etree.indent(self.robot)
        text: bytes = etree.tostring(self.robot, xml_declaration=True, encoding="utf-8")
        return text + b"\n"


def place_table(link: str, placement: pin.SE3) -> dict[str, Any]:
    """Return a closure's frame as mechanism.toml has it."""
    rpy = [float(x) for x in pin.rpy.matrixToRpy(placement.rotation)]
    table = {"link": link, "xyz": [float(x) for x in placement.translation]}
    return table | ({"rpy": rpy} if any(rpy) else {})


def effect_notes(having: Mapping[str, Sequence[str]]) -> list[str]:
    """Return notes on properties of joints that are effects here, `having` them by its word."""
    effects = {word: kind.kind for kind in KINDS.values() for word in kind.model_words}
    return [
        f"{word} of {', '.join(joints)} is not taken over; to identify it: --with "
        + (effects[word] if len(joints) > 1 else f"{effects[word]}:{joints[0]}")
        for word, joints in having.items()
        if joints
    ]


# --- inertias -------------------------------------------------------------------------------------


def with_inertials(
    data: bytes, where: str, inertials: Mapping[str, np.ndarray | None], comment: str = ""
) -> bytes:
    """Return a URDF's text with other `inertials` of some links: by link its ten dynamic parameters
    (10,) in its frame, or None; with a `comment` first. All else stays as it is, but for quotes and
    blanks within tags.
    """
    robot = parse_urdf(data, where)
    if comment:
        note = etree.Comment(f" {comment.replace('--', '- -')} ")
        note.tail = robot.text
        robot.insert(0, note)
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
