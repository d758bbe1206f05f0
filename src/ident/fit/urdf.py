"""identified.urdf: the user's URDF with the inertias that were identified, all else unchanged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from lxml import etree

from ident.errors import FitError
from ident.fit.sanity import LEAST
from ident.mechanism.parameters import COUNT, about_origin, pseudo_inertia, split
from ident.mechanism.placing import fixed_parameters
from ident.mechanism.urdf import read_urdf

if TYPE_CHECKING:
    from ident.fit.fit import Fit


def identified_urdf(fit: Fit) -> bytes:
    """The URDF's text with new `<inertial>` elements for the links of identified bodies.

    A body is its own link and those fixed to it; these keep their inertias, and the body's own link
    carries the rest. Pinocchio gives the same torques for it as the fit does.

    Raises:
        FitError: if a body has first moments and no mass, which a URDF cannot say.
    """
    mechanism = fit.mechanism
    pi = _with_masses(fit)
    robot = read_urdf(mechanism.urdf)
    links = {link.get("name"): link for link in robot.findall("link")}
    parents = {joint.find("parent").get("link") for joint in robot.findall("joint")}
    if "world" in parents and "world" not in links:  # Pinocchio insists that it be declared
        robot.insert(0, etree.Element("link", name="world"))
    unknown = {name.rsplit(".", 1)[0] for name in mechanism.unknown}
    for number, link in enumerate(mechanism.bodies.links):
        if link not in unknown:
            continue
        body = pi[COUNT * number : COUNT * (number + 1)]
        fixed = fixed_parameters(robot, link)
        if not fixed.any() or _carries(body, fixed):
            own = body - fixed
        else:  # nothing is left for the link itself: it takes the whole body
            own = body
            for other in _fixed_links(robot, link):
                for element in links[other].findall("inertial"):
                    links[other].remove(element)
        _set_inertial(links[link], own, mechanism.name)
    return etree.tostring(robot.getroottree(), xml_declaration=True, encoding="utf-8") + b"\n"


def _carries(body: np.ndarray, fixed: np.ndarray) -> bool:
    """Whether what the fixed links leave of a body has mass, and is possible if the body is."""
    left = body - fixed
    least = [float(np.linalg.eigvalsh(pseudo_inertia(pi))[0]) for pi in (left, body)]
    return bool(left[0] > 0 and (least[0] > 0 or least[1] <= 0))


def _fixed_links(robot: etree._Element, link: str) -> list[str]:
    found, front = [], [link]
    while front:
        here = front.pop()
        for joint in robot.findall("joint"):
            if joint.get("type") == "fixed" and joint.find("parent").get("link") == here:
                found.append(joint.find("child").get("link"))
                front.append(found[-1])
    return found


def _with_masses(fit: Fit) -> np.ndarray:
    """Dynamic parameters in which no body with first moments is massless.

    A mass that the data do not determine may be shifted along the directions that no torque feels.
    """
    x, base, columns = fit.estimate.solution.x.copy(), fit.estimate.base, fit.columns
    if fit.binding is not None:  # possible bodies have masses, however small
        return columns.dynamic_parameters(fit.mechanism, x)
    for number, link in enumerate(fit.mechanism.bodies.links):
        pi = columns.dynamic_parameters(fit.mechanism, x)
        body = pi[COUNT * number : COUNT * (number + 1)]
        if abs(body[0]) > LEAST or not np.any(np.abs(body[1:]) > 0):
            continue
        at = columns.index.get(f"{link}.m", -1)
        if at not in base.dependent:
            raise FitError(
                f"link '{link}' was found to have first moments but no mass, which a URDF cannot "
                f"say; make '{link}.m' unknown or give the link a mass"
            )
        column = base.K[:, int(np.flatnonzero(base.dependent == at)[0])]
        x[at] += 1.0
        x[base.independent] -= column
    return columns.dynamic_parameters(fit.mechanism, x)


def _set_inertial(link: etree._Element, pi: np.ndarray, name: str) -> None:
    m, moments, L = split(pi)
    inertial = link.find("inertial")
    if inertial is None:
        if not np.any(pi):
            return
        inertial = etree.SubElement(link, "inertial")
    for tag in ("origin", "mass", "inertia"):
        if inertial.find(tag) is None:
            etree.SubElement(inertial, tag)
    centre = moments / m if m else np.zeros(3)
    inertia = L - about_origin(m, moments)
    inertial.find("origin").set("xyz", " ".join(repr(float(x)) for x in centre))
    inertial.find("origin").set("rpy", "0 0 0")
    inertial.find("mass").set("value", repr(float(m)))
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        inertial.find("inertia").set("i" + "xyz"[i] + "xyz"[j], repr(float(inertia[i, j])))
