"""Inertias of URDF links that are fixed to a moving link, in that link's frame."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.description.urdf import numbers
from ident.mechanism.parameters import COUNT, about_origin, join


def fixed_parameters(robot: etree._Element, link: str) -> np.ndarray:
    """The ten dynamic parameters (10,) that links fixed to `link` add to its body."""
    total = np.zeros(COUNT)
    links = {element.get("name"): element for element in robot.findall("link")}
    for joint in robot.findall("joint"):
        if joint.get("type") != "fixed" or joint.find("parent").get("link") != link:
            continue
        child = joint.find("child").get("link")
        place = _placement(joint.find("origin"))
        pi = own_parameters(links[child]) + fixed_parameters(robot, child)
        if np.any(pi):
            total += place.act(pin.Inertia.FromDynamicParameters(pi)).toDynamicParameters()
    return total


def own_parameters(link: etree._Element) -> np.ndarray:
    """The ten dynamic parameters (10,) of a link's <inertial>, in the link's frame."""
    inertial = link.find("inertial")
    if inertial is None:
        return np.zeros(COUNT)
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    place = _placement(inertial.find("origin"))
    xx, xy, xz, yy, yz, zz = (
        numbers(inertia, key, "0", 1, "")[0] for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    R = place.rotation
    about_centre = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    m = numbers(mass, "value", "0", 1, "")[0]
    moments = m * place.translation
    # not by pin.Inertia, which refuses the tensors of impossible bodies; files have them
    return join(m, moments, about_centre + about_origin(m, moments))


def _placement(origin: etree._Element | None) -> pin.SE3:
    if origin is None:
        return pin.SE3.Identity()
    rpy = numbers(origin, "rpy", "0 0 0", 3, "")
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(numbers(origin, "xyz", "0 0 0", 3, "")))
