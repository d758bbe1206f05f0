"""A machine as an SDF model (1.9), for Gazebo: links, joints with dynamics, loops as joints.

A closure is one more joint, between two links that both have parents already.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.export.laws import JointLaws, Translation, Vocabulary
from ident.export.machine import Body, Link, Machine
from ident.export.target import Job, Product, Target, translated
from ident.mechanism.closures import FrameClosure
from ident.mechanism.description import words

JOINTS = {
    "point": "ball", "revolute": "revolute", "prismatic": "prismatic", "fixed": "fixed",
    "universal": "universal",
}  # fmt: skip
WORDS = Vocabulary(
    {"viscous": "dynamics/damping", "coulomb": "dynamics/friction", "payload": "inertial",
     "spring": "dynamics/spring_stiffness", "geometry": "pose"},
    {kind: f"a {word} joint" for kind, word in JOINTS.items()}, degree=1,
)  # fmt: skip


def write(job: Job) -> Product:
    """Return the model of a job."""
    translation = translated(job, WORDS)
    # a constant torque is the preload of a spring; without stiffness it has no words here
    notes = [
        f"{name}: a constant torque of {laws.position[0]:.3g} is left out, as there is no spring"
        for name, laws in translation.laws.items()
        if laws.position and not _stiffness(laws)
    ]
    return Product({job.out.name: text(translation)}, translation, tuple(notes))


def text(translation: Translation) -> bytes:
    """Return the text of the model, with the gravity of its world beside it."""
    machine = translation.machine
    root = etree.Element("sdf", version="1.9")
    root.append(etree.Comment(f" gravity of the world: {words(machine.gravity)} "))
    model = etree.SubElement(root, "model", name=machine.name)
    for link in machine.links:
        _link(model, link, machine)
        _joint(model, link, machine, translation.laws[link.joint.name])
    for closure in machine.drawing.closures:
        if isinstance(closure, FrameClosure):
            _loop(model, closure)
    etree.indent(root)
    data: bytes = etree.tostring(root, encoding="utf-8", xml_declaration=True)
    return data + b"\n"


def _link(model: etree._Element, link: Link, machine: Machine) -> None:
    element = etree.SubElement(model, "link", name=link.name)
    above = "__model__" if link.parent < 0 else machine.links[link.parent].name
    _pose(element, link.placement, above)
    body = Body.of(machine.total(link))
    if body.none:
        return
    inertial = etree.SubElement(element, "inertial")
    _pose(inertial, pin.SE3(np.eye(3), body.centre))
    etree.SubElement(inertial, "mass").text = words([body.mass])
    tensor = etree.SubElement(inertial, "inertia")
    for key, x in zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), body.six, strict=True):
        etree.SubElement(tensor, key).text = words([x])


def _joint(model: etree._Element, link: Link, machine: Machine, laws: JointLaws) -> None:
    joint = link.joint
    kind = "revolute" if joint.rotational else "prismatic"
    element = etree.SubElement(model, "joint", name=joint.name, type=kind)
    above = "world" if link.parent < 0 else machine.links[link.parent].name
    etree.SubElement(element, "parent").text = above
    etree.SubElement(element, "child").text = link.name
    axis = etree.SubElement(element, "axis")
    etree.SubElement(axis, "xyz").text = words(link.axis)
    limit = etree.SubElement(axis, "limit")
    for key in ("lower", "upper", "effort", "velocity"):
        x = getattr(joint, key)
        if np.isfinite(x):
            etree.SubElement(limit, key).text = words([x])
    dynamics = {"damping": laws.viscous, "friction": laws.coulomb}
    if k := _stiffness(laws):
        dynamics |= {"spring_reference": -laws.position[0] / k, "spring_stiffness": k}
    if any(dynamics.values()):
        inside = etree.SubElement(axis, "dynamics")
        for key, x in dynamics.items():
            etree.SubElement(inside, key).text = words([x])


def _stiffness(laws: JointLaws) -> float:
    return laws.position[1] if len(laws.position) > 1 else 0.0


def _loop(model: etree._Element, closure: FrameClosure) -> None:
    a, b = closure.frames
    name = f"{closure.name}_closure"
    for end, frame in zip("ab", (a, b), strict=True):
        place = etree.SubElement(model, "frame", name=f"{name}_{end}")
        place.set("attached_to", "world" if frame.joint == 0 else frame.link)
        _pose(place, frame.placement)
    element = etree.SubElement(model, "joint", name=name, type=JOINTS[closure.kind])
    etree.SubElement(element, "parent").text = f"{name}_a"
    etree.SubElement(element, "child").text = f"{name}_b"
    if closure.kind in ("revolute", "prismatic", "universal"):
        axis = etree.SubElement(element, "axis")
        first = "1 0 0" if closure.kind == "universal" else "0 0 1"
        etree.SubElement(axis, "xyz").text = first
    if closure.kind == "universal":
        axis = etree.SubElement(element, "axis2")
        etree.SubElement(axis, "xyz").text = "0 1 0"


def _pose(element: etree._Element, placement: pin.SE3, relative: str = "") -> None:
    values = [*placement.translation, *pin.rpy.matrixToRpy(placement.rotation)]
    pose = etree.SubElement(element, "pose")
    pose.text = words(values)
    if relative:
        pose.set("relative_to", relative)


SDF = Target("sdf", "an SDF model", ".sdf", WORDS, write)
