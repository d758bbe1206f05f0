"""The tree: from a checked URDF to Pinocchio's model, and its forward kinematics in CasADi.

Pinocchio stores a continuous joint as (cos, sin). Here every coordinate is an angle or a length, as
logs and tables have them: a continuous joint becomes a revolute one without limits. Mimicking
joints stay joints; the mechanism gets a `linear` closure for each.

PyPI's `pin` has no CasADi binding, so placements are written here from the model's own data: a
joint's placement in its parent, then the joint's motion. Tested against Pinocchio.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
from lxml import etree

from ident.errors import MechanismError, one_of
from ident.mechanism.description import UNLIMITED, mimic_table
from ident.mechanism.urdf import NUMBERS, numbers

PLACEHOLDER = 100.0  # range: m, a radius of gyration beyond which an inertia is no body's
LOWEST, HIGHEST = f"-{UNLIMITED}", f"{UNLIMITED}"  # as a URDF has them


@dataclass(frozen=True)
class Tree:
    """Pinocchio's model of a URDF with the names that it does not keep."""

    model: pin.Model  # one scalar coordinate a joint, `model.nq == model.nv`
    # the URDF link that each joint moves, by Pinocchio's joint index from 1 on
    links: tuple[str, ...]
    mimics: tuple[dict[str, Any], ...]  # joints that follow another, as tables [[closure]]
    notes: tuple[str, ...]  # interpretations that differ from the text of the URDF


def build_tree(robot: etree._Element, gravity: Sequence[float], where: str) -> Tree:
    """Return Pinocchio's model of a checked `<robot>`."""
    robot = copy.deepcopy(robot)
    notes: list[str] = []
    names = {link.get("name") for link in robot.findall("link")}
    used = {joint.find("parent").get("link") for joint in robot.findall("joint")}
    if "world" in used - names:
        robot.insert(0, etree.Element("link", name="world"))
        notes.append("the URDF does not declare the link 'world'; it is taken as the ground")
    # nothing here uses these, and urdfdom stumbles over some of them
    unused = ("dynamics", "safety_controller", "calibration", "visual", "collision")
    etree.strip_elements(robot, *unused, with_tail=False)
    for element in robot.iter("limit", "mass", "inertia"):
        for key, value in element.items():  # urdfdom stumbles over blanks around a number
            element.set(key, value.strip())
    for inertia in robot.iterfind("link/inertial/inertia"):  # urdfdom requires them
        for key in ("ixy", "ixz", "iyz"):
            inertia.set(key, inertia.get(key, "0"))
    notes += _without_placeholders(robot, where)
    moving = [joint for joint in robot.findall("joint") if joint.get("type") != "fixed"]
    mimics = tuple(_take_mimics(moving, where))
    for joint in robot.findall("joint[@type='fixed'][mimic]"):
        notes.append(f"joint '{joint.get('name')}' is fixed, so its <mimic> is ignored")
    etree.strip_elements(robot, "mimic", with_tail=False)
    for joint in moving:
        limit = joint.find("limit")
        if joint.get("type") == "continuous" or limit is None:
            limit = etree.SubElement(joint, "limit") if limit is None else limit
            limit.attrib.update({"lower": LOWEST, "upper": HIGHEST})
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
        for key in ("effort", "velocity"):
            limit.set(key, limit.get(key, HIGHEST))
    try:
        model = pin.buildModelFromXML(etree.tostring(robot).decode())
    except (RuntimeError, ValueError) as error:
        raise MechanismError(
            f"{where}: Pinocchio refuses it: {' '.join(str(error).split())}"
        ) from None
    if model.nv == 0:
        raise MechanismError(f"{where}: has no joint that moves; every joint is fixed")
    model.gravity.linear = np.array(gravity)
    child = {j.get("name"): j.find("child").get("link") for j in robot.findall("joint")}
    links = tuple(child[name] for name in list(model.names)[1:])
    return Tree(model, links, mimics, tuple(notes))


def _without_placeholders(robot: etree._Element, where: str) -> Iterator[str]:
    """Remove inertias that only satisfy a simulator, such as 1 kg m² at a milligram."""
    for link in robot.iterfind("link[inertial]"):
        inertia, mass = link.find("inertial/inertia"), link.find("inertial/mass")
        (m,) = numbers(mass, "value", "0", 1, where)
        trace = sum(numbers(inertia, key, "0", 1, where)[0] for key in ("ixx", "iyy", "izz"))
        if m > 0 and (gyration := (max(trace, 0.0) / (2 * m)) ** 0.5) > PLACEHOLDER:
            yield (
                f"link '{link.get('name')}': an inertia of {trace / 3:.3g} kg m² at {m:.3g} kg has "
                f"a radius of gyration of {gyration:,.0f} m: a placeholder, which counts as zero"
            )
            inertia.attrib.update(dict.fromkeys(inertia.attrib, "0"))


def _take_mimics(moving: Sequence[etree._Element], where: str) -> list[dict[str, Any]]:
    names, mimics, wrong = [joint.get("name") for joint in moving], [], []
    for joint in moving:
        mimic, name = joint.find("mimic"), joint.get("name")
        if mimic is None:
            continue
        of = mimic.get("joint") or ""
        if of not in names or of == name:
            wrong.append((name, of, mimic.sourceline))
            continue
        (multiplier,), (offset,) = (
            numbers(mimic, key, default, 1, where) for key, default in NUMBERS["mimic"].items()
        )
        mimics.append(mimic_table(name, of, multiplier, offset))
    if not wrong:
        return mimics
    (name, of, line), others = wrong[0], wrong[1:]
    locks = " ".join(f"--lock {each}" for each, *_ in wrong)
    more = ", ".join(f"'{each}' mimics '{it}' (line {at})" for each, it, at in others)
    raise MechanismError(
        f"{where}:{line}: joint '{name}' mimics '{of}', which is no other joint of one coordinate; "
        f"{one_of(of, [each for each in names if each != name])}"
        f"{f'; in the same way {more}' if more else ''}; correct the file, or take them as fixed: "
        f"{locks}"
    )


@dataclass(frozen=True)
class Placement:
    """A frame in the world: rotation R (3, 3) and origin p (3,) [m], CasADi or NumPy."""

    R: ca.SX
    p: ca.SX

    def __mul__(self, other: Placement) -> Placement:
        return Placement(self.R @ other.R, self.R @ other.p + self.p)

    @staticmethod
    def of(M: pin.SE3) -> Placement:
        """Return Pinocchio's constant placement, without rounding errors beside 0 and 1."""
        return Placement(ca.SX(_tidy(M.rotation)), ca.SX(_tidy(M.translation)))


def _tidy(values: np.ndarray) -> np.ndarray:
    nearest = np.round(values)
    return np.where(np.abs(values - nearest) < 1e-12, nearest, values)


def _motion_subspace(model: pin.Model, index: int) -> np.ndarray:
    joint = model.joints[index]
    data = joint.createData()
    joint.calc(data, np.zeros(model.nq))
    return np.asarray(data.S).reshape(6, -1)


def joint_axis(model: pin.Model, index: int) -> np.ndarray:
    """Return the unit axis (3,) of a joint with one coordinate, in the joint's frame."""
    S = _motion_subspace(model, index)
    if S.shape[1] != 1:
        raise MechanismError(f"joint '{model.names[index]}' has {S.shape[1]} coordinates, not one")
    return _tidy(S[:3, 0] + S[3:, 0])


def is_rotational(model: pin.Model, index: int) -> bool:
    """Return whether the joint's coordinate is an angle."""
    return bool(np.abs(_motion_subspace(model, index)[3:]).max() > 0.5)


def placements(model: pin.Model, q: ca.SX) -> list[Placement]:
    """Return world placements of all joints' frames, the world first, at q (nq,)."""
    placed = [Placement(ca.SX.eye(3), ca.SX.zeros(3))]
    for index in range(1, model.njoints):
        fixed = placed[model.parents[index]] * Placement.of(model.jointPlacements[index])
        at = model.idx_qs[index]
        if model.joints[index].nq == 7:
            own = Placement(_rotation_of_quaternion(q[at + 3 : at + 7]), q[at : at + 3])
        elif is_rotational(model, index):
            cross = ca.skew(ca.SX(joint_axis(model, index)))  # Rodrigues
            turned = ca.sin(q[at]) * cross + (1 - ca.cos(q[at])) * (cross @ cross)
            own = Placement(ca.SX.eye(3) + turned, ca.SX.zeros(3))
        else:
            own = Placement(ca.SX.eye(3), ca.SX(joint_axis(model, index)) * q[at])
        placed.append(fixed * own)
    return placed


def _rotation_of_quaternion(xyzw: ca.SX) -> ca.SX:
    cross = ca.skew(xyzw[:3])
    return ca.SX.eye(3) + 2 * xyzw[3] * cross + 2 * (cross @ cross)


def rates(model: pin.Model, q: ca.SX) -> ca.SX:
    """Return N(q) (nq, nv) of q̇ = N(q) v: 1 for scalar joints, a quaternion's for free bodies."""
    N = ca.SX(model.nq, model.nv)
    for index in range(1, model.njoints):
        joint, iq, iv = model.joints[index], model.idx_qs[index], model.idx_vs[index]
        if joint.nq == 1:
            N[iq, iv] = 1
            continue
        xyzw = q[iq + 3 : iq + 7]
        # ṗ = R v_lin ; quaternion rate = ½ quaternion ∘ (ω, 0), ω in the body's axes
        N[iq : iq + 3, iv : iv + 3] = _rotation_of_quaternion(xyzw)
        N[iq + 3 : iq + 6, iv + 3 : iv + 6] = 0.5 * (xyzw[3] * ca.SX.eye(3) + ca.skew(xyzw[:3]))
        N[iq + 6, iv + 3 : iv + 6] = -0.5 * xyzw[:3].T
    return N
