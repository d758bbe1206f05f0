"""A URDF written from bodies and joints that another format described."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

UNLIMITED = 1e9  # what a URDF says where there is no limit


@dataclass(frozen=True)
class Source:
    """What a file says of a mechanism, as a URDF and the tables of a mechanism.toml.

    Attributes:
        urdf: the URDF's text; the file's own, where it is one.
        format: `urdf`, `mjcf` or `sdf`.
        closures: tables as in [[closure]].
        passive: joints of [joints] passive.
        start: [joints] start.
        gravity: [m/s²], where the file gives it.
        auxiliary: massless links between joints of one body, which no file names.
        notes: what was understood otherwise than it is written, in words.
    """

    urdf: bytes
    format: str = "urdf"
    closures: tuple[Mapping[str, Any], ...] = ()
    passive: tuple[str, ...] = ()
    start: Mapping[str, float] = field(default_factory=dict)
    gravity: tuple[float, float, float] | None = None
    auxiliary: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Solid:
    """A rigid body in its link's frame: mass [kg], centre (3,) [m], inertia (3, 3) about it."""

    mass: float
    centre: np.ndarray
    inertia: np.ndarray

    def moved(self, placement: pin.SE3) -> Solid:
        """The same body in a frame in which its own stands at `placement`."""
        R = placement.rotation
        return Solid(self.mass, placement.act(self.centre), R @ self.inertia @ R.T)


@dataclass(frozen=True)
class Shape:
    """A visual: `box`, `sphere`, `cylinder` or `mesh` with its URDF attributes, where it stands."""

    kind: str
    attributes: Mapping[str, str]
    placement: pin.SE3


@dataclass(frozen=True)
class Limits:
    """Of a joint; infinite where there is none."""

    lower: float = -np.inf
    upper: float = np.inf
    velocity: float = np.inf
    effort: float = np.inf


class Document:
    """A `<robot>` that grows link by link and joint by joint."""

    def __init__(self, name: str, said: str) -> None:
        self.robot = etree.Element("robot", name=name or "robot")
        self.robot.append(etree.Comment(f" {said.replace('--', '- -')} "))

    def link(self, name: str, solid: Solid | None = None, shapes: Sequence[Shape] = ()) -> None:
        """A link with its inertia and what it looks like."""
        link = etree.SubElement(self.robot, "link", name=name)
        if solid is not None and (solid.mass or np.any(solid.inertia)):
            inertial = etree.SubElement(link, "inertial")
            etree.SubElement(inertial, "origin", xyz=words(solid.centre), rpy="0 0 0")
            etree.SubElement(inertial, "mass", value=words([solid.mass]))
            tensor = etree.SubElement(inertial, "inertia")
            for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
                tensor.set("i" + "xyz"[i] + "xyz"[j], words([solid.inertia[i, j]]))
        for shape in shapes:
            visual = etree.SubElement(link, "visual")
            self._origin(visual, shape.placement)
            etree.SubElement(
                etree.SubElement(visual, "geometry"), shape.kind, dict(shape.attributes)
            )

    def joint(
        self,
        name: str,
        kind: str,
        ends: tuple[str, str],
        placement: pin.SE3,
        axis: np.ndarray | None = None,
        limits: Limits = Limits(),
    ) -> None:
        """A joint of type `kind` from a parent to a child link, both named by `ends`."""
        joint = etree.SubElement(self.robot, "joint", name=name, type=kind)
        etree.SubElement(joint, "parent", link=ends[0])
        etree.SubElement(joint, "child", link=ends[1])
        self._origin(joint, placement)
        if axis is not None:
            etree.SubElement(joint, "axis", xyz=words(axis))
            values = vars(limits)
            if kind != "continuous" or any(np.isfinite(x) for x in values.values()):
                # urdfdom wants all four where there is a limit
                full = {key: np.clip(x, -UNLIMITED, UNLIMITED) for key, x in values.items()}
                etree.SubElement(joint, "limit", {key: words([x]) for key, x in full.items()})

    @staticmethod
    def _origin(element: etree._Element, placement: pin.SE3) -> None:
        rpy = pin.rpy.matrixToRpy(placement.rotation)
        etree.SubElement(element, "origin", xyz=words(placement.translation), rpy=words(rpy))

    def text(self) -> bytes:
        """The document as a file has it."""
        etree.indent(self.robot)
        text: bytes = etree.tostring(self.robot, xml_declaration=True, encoding="utf-8")
        return text + b"\n"


def place_table(link: str, placement: pin.SE3) -> dict[str, Any]:
    """A closure's frame as mechanism.toml has it."""
    rpy = [float(x) for x in pin.rpy.matrixToRpy(placement.rotation)]
    table = {"link": link, "xyz": [float(x) for x in placement.translation]}
    return table | ({"rpy": rpy} if any(rpy) else {})


def words(values: Sequence[float] | np.ndarray) -> str:
    """Numbers as XML has them, none of them rounded."""
    return " ".join(repr(float(x) + 0.0) for x in values)
