"""Turns of rods about themselves, which nobody logs and nothing drives.

    N = null [J; W of the drives]      a sparse basis of it: each vector z is one freedom

A rod with a ball at each end, whole or cut in halves that a closure joins, or with a drive along
itself, can spin about the line between the balls: all bodies that z moves have one and the same
twist, a pure rotation. One of the rod's angles is held, so that a ball is a cross joint; the rod's
tips are where they were. How a rod turns about itself is unknown then, and so are its parameters
beside those of a slender body on its axis. A freedom that moves bodies otherwise, such as a foot on
a passive ankle, is none of these: it has to be logged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ident.information import linear
from ident.mechanism.mechanism import Mechanism

NOTHING = 1e-7  # numerics: [1 | m/s at 1 rad/s] components and speeds that count as none
SAME_TWIST = 1e-6  # numerics: [rad/s | m/s at 1 rad/s] by which the twists of one rod may differ
OFF_AXIS = 1e-3  # range: [m] from its axis to an axle's centre of mass
FREE = 6  # numerics: joints one after the other that leave a body free
PRODUCTS = ("Lxy", "Lxz", "Lyz")


@dataclass(frozen=True, eq=False)
class Spin:
    """A rod's turn about itself."""

    joint: str  # whose angle is held
    value: float  # [rad]
    unseen: tuple[str, ...]  # names of parameters that no motion of the tips shows
    links: tuple[str, ...]  # bodies that turn


def spins(mechanism: Mechanism) -> list[Spin]:
    """Return the turns of rods about themselves, each with the angle to hold."""
    if not mechanism.closures or not mechanism.assembly.closed:
        return []
    if mechanism.degrees_of_freedom <= len(mechanism.driven):
        return []
    model, q = mechanism.model, mechanism.general
    J = mechanism.kinematics.closure_rows(q[None]).rate[0]
    tree = {joint.index: joint for joint in mechanism.joints if joint.in_tree}
    drives = [index for index, joint in tree.items() if joint.name in mechanism.driven]
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    turns_of_rods = []
    for z in _sparse(_null(np.vstack([J, np.eye(model.nv)[drives]]))):
        if (turned := _rod(mechanism, data, z)) is not None:
            turns = [k for k in np.flatnonzero(np.abs(z) > NOTHING) if tree[int(k)].rotational]
            joint = tree[int(max(turns, key=lambda k: abs(z[k])))]
            unseen = tuple(name for names in turned.values() for name in names)
            value = float(mechanism.assembled[joint.index])
            turns_of_rods.append(Spin(joint.name, value, unseen, tuple(turned)))
    return turns_of_rods


def _null(A: np.ndarray) -> np.ndarray:
    """Return a basis (n, nv) of the null space of A (m, nv)."""
    _, sizes, directions = linear.svd(A)
    return directions[int((sizes > 1e-8 * sizes.max(initial=1.0)).sum()) :]


def _sparse(basis: np.ndarray) -> np.ndarray:
    """Return the basis in reduced row echelon form, with the largest pivots."""
    A = basis.copy()
    for i in range(len(A)):
        column = int(np.abs(A[i:]).max(axis=0).argmax())
        pivot = i + int(np.abs(A[i:, column]).argmax())
        A[[i, pivot]] = A[[pivot, i]]
        A[i] /= A[i, column]
        others = np.arange(len(A)) != i
        A[others] -= np.outer(A[others, column], A[i])
    return A


def _rod(mechanism: Mechanism, data: pin.Data, z: np.ndarray) -> dict[str, list[str]] | None:
    """Return the bodies that z turns about one line, with what is unseen of each; else None."""
    model = mechanism.model
    world = pin.ReferenceFrame.WORLD
    jacobians = (pin.getJointJacobian(model, data, i, world) for i in range(1, model.njoints))
    twists = np.array([np.zeros(6), *(J @ z for J in jacobians)])
    moves = np.abs(twists).max(axis=1) > NOTHING
    bodies = [i for i in _bodies(model) if moves[i]]
    if not bodies:
        return None
    twist = twists[bodies[0]]
    if np.abs(twists[bodies] - twist).max() > SAME_TWIST or abs(twist[:3] @ twist[3:]) > SAME_TWIST:
        return None
    inertias = [data.oMi[i].act(model.inertias[i]) for i in bodies]
    masses = np.array([inertia.mass for inertia in inertias])
    if masses.any():
        moving = (twist[:3] + np.cross(twist[3:], inertia.lever) for inertia in inertias)
        speeds = np.linalg.norm([*moving], axis=1) / np.linalg.norm(twist[3:])
        if not _held_twice(mechanism, moves, bool((speeds[masses > 0] < OFF_AXIS).all())):
            return None
    unseen = {}
    for i in bodies:
        local = data.oMi[i].actInv(pin.Motion(twist))
        axis = local.angular / np.linalg.norm(local.angular)
        link = mechanism.bodies.links[i - 1]
        unseen[link] = _unseen(link, local.linear, axis)
    return unseen


def _bodies(model: pin.Model) -> list[int]:
    """Return joints that carry a body: with a mass, or at the end of a branch."""
    last = (len(model.subtrees[i]) == 1 for i in range(model.njoints))
    return [i for i, end in enumerate(last) if i and (end or model.inertias[i].mass > 0)]


def _held_twice(mechanism: Mechanism, moves: np.ndarray, balanced: bool) -> bool:
    """Return whether the bodies that turn are held in two places or more by those that do not, in
    one of them by a ball or a cross joint, or `balanced`, their centres of mass on the axis: an
    axle in two hinges idles, but a door swings, and so does a pendulum on a ball.
    """
    model, places, balls = mechanism.model, 0, 0
    for i in _bodies(model):
        chain = [i]  # the joints between this body and the one before it
        while (above := int(model.parents[chain[-1]])) and above not in _bodies(model):
            chain.append(above)
        if moves[i] != moves[above] and len(chain) < FREE:  # a floating joint holds nothing
            places += 1
            balls += sum(mechanism.joint(model.names[k]).rotational for k in chain) > 1
    for closure in mechanism.closures:
        places += len({bool(moves[frame.joint]) for frame in closure.frames}) > 1
    return places > 1 and (balls > 0 or balanced)


def _unseen(link: str, speed: np.ndarray, axis: np.ndarray) -> list[str]:
    """Return names of parameters that a body's turn leaves unknown, where it is about one of the
    link's axes; `speed` is that of the link's origin.
    """
    if np.abs(speed).max() > SAME_TWIST or np.sort(np.abs(axis))[1] > SAME_TWIST:
        return []
    along = "xyz"[int(np.abs(axis).argmax())]
    words = [f"m{letter}" for letter in "xyz" if letter != along]
    return [f"{link}.{word}" for word in (*words, f"L{along}{along}", *PRODUCTS)]
