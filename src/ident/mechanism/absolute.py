"""The same mechanism in absolute coordinates: every moving body free, every joint a closure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from ident.errors import MechanismError
from ident.mechanism.closures import Closure, Frame, PrismaticClosure, RevoluteClosure
from ident.mechanism.description import align_z
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.tree import joint_axis

HALF_TURN = np.pi + 0.01  # [rad] with room for limits written as 3.15


def absolute(mechanism: Mechanism) -> Mechanism:
    """The mechanism restated with six coordinates a body; parameters, joints and logs are the same.

    A turning joint becomes a `revolute` closure and a sliding one a `prismatic` closure, whose own
    joint carries the joint's name: its angle is the joint's coordinate, the logged torque acts on
    it, and effects sit on it as before. The joint's multipliers are named `joint.<joint>.<x|…>`.

    Args:
        mechanism: in joint coordinates.

    Returns:
        One with 6 · bodies coordinates and the same degrees of freedom.

    Raises:
        MechanismError: for gears between joints that turn by more than half a turn.
    """
    for closure in mechanism.closures:
        tied = map(mechanism.joint, closure.tied)
        if any(j.rotational and max(-j.lower, j.upper) > HALF_TURN for j in tied):
            raise MechanismError(
                f"{mechanism.name}: closure '{closure.name}' ties joints that turn by more than "
                "half a turn, which absolute coordinates do not count; use joint coordinates, or "
                "give these joints limits within ±3.14 rad"
            )
    tree = mechanism.model
    model = pin.Model()
    model.name = tree.name
    model.gravity = tree.gravity
    for index, link in enumerate(mechanism.bodies.links, start=1):
        added = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), link)
        model.appendBodyToJoint(added, tree.inertias[index], pin.SE3.Identity())
    for frame in tree.frames:
        if frame.type == pin.FrameType.BODY and frame.name not in [f.name for f in model.frames]:
            model.addFrame(
                pin.Frame(frame.name, frame.parentJoint, frame.placement, pin.FrameType.BODY), False
            )
    data = tree.createData()
    pin.forwardKinematics(tree, data, mechanism.assembled)
    return replace(
        mechanism,
        name=f"{mechanism.name} (absolute)",
        model=model,
        joints=tuple(
            replace(joint, index=i, in_tree=False) for i, joint in enumerate(mechanism.joints)
        ),
        closures=(
            *(_closure(mechanism, index) for index in range(1, tree.njoints)),
            *mechanism.closures,
        ),
        start=np.concatenate([pin.SE3ToXYZQUAT(data.oMi[i]) for i in range(1, tree.njoints)]),
    )


def _closure(mechanism: Mechanism, index: int) -> Closure:
    tree = mechanism.model
    align = pin.SE3(align_z(joint_axis(tree, index)), np.zeros(3))
    links = ("world", *mechanism.bodies.links)
    parent, joint = tree.parents[index], mechanism.joint(tree.names[index])
    a = Frame(links[parent], parent, tree.jointPlacements[index] * align)
    kind = RevoluteClosure if joint.rotational else PrismaticClosure
    return kind(f"joint.{joint.name}", a, Frame(links[index], index, align), joint.name)
