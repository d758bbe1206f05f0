"""identified.urdf: the user's URDF with the inertias that were identified, all else unchanged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from lxml import etree

from ident.errors import FitError
from ident.fit.sanity import LEAST
from ident.mechanism.description import urdf_bytes
from ident.mechanism.parameters import COUNT, pseudo_inertia
from ident.mechanism.urdf import UrdfText
from ident.mechanism.write import fixed_parameters, set_inertial

if TYPE_CHECKING:
    from ident.fit.fit import Fit


def identified_urdf(fit: Fit) -> bytes:
    """The URDF's text with new `<inertial>` numbers for the links of identified bodies.

    Every other byte is the user's: comments, meshes, transmissions, indentation, ends of lines.
    A body is its own link and those fixed to it; these keep their inertias, and the body's own link
    carries the rest. Pinocchio gives the same torques for it as the fit does.

    Raises:
        FitError: if a body has first moments and no mass, which a URDF cannot say.
    """
    mechanism = fit.mechanism
    pi = _with_masses(fit)
    text = UrdfText(urdf_bytes(mechanism.urdf), str(mechanism.urdf))
    robot = text.robot
    links = {link.get("name"): link for link in robot.findall("link")}
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
                    text.remove(element)
        set_inertial(text, links[link], own)
    return text.encoded()


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
