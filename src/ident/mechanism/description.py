"""A mechanism's file as a URDF and what a URDF cannot state: closures, passive joints, gravity.

A URDF describes itself. MuJoCo models and formats of other packages are rewritten as a URDF,
for which `UrdfWriter` is the tool.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.effects.library import KINDS
from ident.errors import MechanismError
from ident.files import OWN, reader_of, regular
from ident.mechanism.urdf import parse_urdf, parse_xml, words

LARGEST = 50_000_000  # work: bytes of a file
UNLIMITED = 1e9  # range: what a URDF states where there is no limit
FORMATS = {"mujoco": ".mjcf", "mujocoinclude": ".mjcf"}  # by root element


@dataclass(frozen=True)
class Description:
    """Content of a mechanism file, as a URDF and the tables of a mechanism.toml."""

    urdf: bytes  # the URDF's text; the file's own, where it is one
    format: str = "urdf"  # or the name of the file's format
    closures: tuple[Mapping[str, Any], ...] = ()  # tables as in [[closure]]
    passive: tuple[str, ...] = ()  # joints of [joints] passive
    start: Mapping[str, float] = field(default_factory=dict)  # [joints] start
    gravity: tuple[float, float, float] | None = None  # [m/s²], where the file gives it
    # massless links between joints of one body, which the file does not name
    auxiliary: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # what was understood otherwise than it is written, in words


def read_description(path: Path) -> Description:
    """Read a URDF, a MuJoCo model or a format of another package."""
    try:
        if (size := regular(path).stat().st_size) > LARGEST:
            raise MechanismError(f"{path}: {size} bytes; a URDF has at most {LARGEST}")
        data = path.read_bytes()
    except OSError as error:
        raise MechanismError(f"{path}: cannot be read: {error.strerror}") from None
    return description_of(data, path)


def description_of(data: bytes, path: Path) -> Description:
    """Read as `read_description` does, given the file's content, or a URDF in its place."""
    suffix = path.suffix.lower()
    if suffix == ".urdf":
        return Description(data)
    foreign = None if f"mechanism{suffix}" in OWN else reader_of("mechanism", suffix)
    if foreign is not None and b"<robot" not in data:
        content = foreign(path)
        if isinstance(content, str):
            content = content.encode()
        return Description(content, suffix[1:]) if isinstance(content, bytes) else content
    reader = reader_of("mechanism", FORMATS.get(str(parse_xml(data, str(path)).tag), ""))
    return Description(data) if reader is None else reader(path, data)


def read_urdf(path: Path) -> etree._Element:
    """Return the checked `<robot>` element of a mechanism's file, comments included."""
    return parse_urdf(read_description(path).urdf, str(path))


# --- a URDF written from bodies and joints ------------------------------------------------------


@dataclass(frozen=True)
class RigidBody:
    """A rigid body in a link's frame; not a pin.Inertia, which refuses impossible tensors."""

    mass: float  # [kg]
    centre: np.ndarray  # (3,) [m]
    inertia: np.ndarray  # (3, 3) [kg m²] about the centre

    def moved(self, placement: pin.SE3) -> RigidBody:
        """Return the body in a frame in which its own is at `placement`."""
        R = placement.rotation
        return RigidBody(self.mass, placement.act(self.centre), R @ self.inertia @ R.T)


@dataclass(frozen=True)
class Visual:
    """A shape to be shown."""

    kind: str  # `box`, `sphere`, `cylinder` or `mesh`
    attributes: Mapping[str, str]  # of the URDF's element
    placement: pin.SE3  # in the link's frame


@dataclass(frozen=True)
class JointLimits:
    """Limits of a joint [rad | m, rad/s | m/s, N m | N]; infinite where there is none."""

    lower: float = -np.inf
    upper: float = np.inf
    velocity: float = np.inf
    effort: float = np.inf


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
        for each in visuals:
            visual = etree.SubElement(link, "visual")
            self._origin(visual, each.placement)
            geometry = etree.SubElement(visual, "geometry")
            etree.SubElement(geometry, each.kind, dict(each.attributes))

    def joint(
        self,
        name: str,
        kind: str,
        ends: tuple[str, str],
        placement: pin.SE3,
        axis: np.ndarray | None = None,
        limits: JointLimits = JointLimits(),
    ) -> None:
        """Append a joint of type `kind` from a parent to a child link, both named by `ends`."""
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
        """Return the text of the file."""
        etree.indent(self.robot)
        text: bytes = etree.tostring(self.robot, xml_declaration=True, encoding="utf-8")
        return text + b"\n"


def place_table(link: str, placement: pin.SE3) -> dict[str, Any]:
    """Return a closure's frame as mechanism.toml has it."""
    rpy = [float(x) for x in pin.rpy.matrixToRpy(placement.rotation)]
    table = {"link": link, "xyz": [float(x) for x in placement.translation]}
    return table | ({"rpy": rpy} if any(rpy) else {})


def mimic_table(joint: str, other: str, multiplier: float, offset: float) -> dict[str, Any]:
    """Return the table [[closure]] of q_joint = multiplier · q_other + offset."""
    return {
        "name": f"mimic.{joint}",
        "kind": "linear",
        "joints": [joint, other],
        "ratios": [1.0, -multiplier],
        "offset": offset,
    }


def effect_notes(having: Mapping[str, Sequence[str]]) -> list[str]:
    """Return notes about properties of joints that are effects here, and how to identify them.

    `having` gives the joints by the word of the format.
    """
    effects = {word: kind.kind for kind in KINDS.values() for word in kind.model_words}
    return [
        f"{word} of {', '.join(joints)} is not taken over; to identify it: --with "
        + (effects[word] if len(joints) > 1 else f"{effects[word]}:{joints[0]}")
        for word, joints in having.items()
        if joints
    ]


def align_z(axis: np.ndarray) -> np.ndarray:
    """Return a rotation (3, 3) whose z is `axis`, for a closure in place of a joint about it; its x
    is nearest to the frame's own x (or y).
    """
    z = axis / np.linalg.norm(axis)
    seed = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    x = seed - z * (z @ seed)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
