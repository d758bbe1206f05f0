"""Frames of links: which of them move, and the joints between the ground and one of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ident.effects import FramePath
from ident.errors import MechanismError
from ident.mechanism.description import joint_axis


def moving_frames(model: pin.Model) -> tuple[str, ...]:
    """Return the names of links that move, those fixed to another one as well."""
    body = pin.FrameType.BODY
    return tuple(f.name for f in model.frames if f.type == body and f.parentJoint > 0)


def path_to(model: pin.Model, frame: str, joints: Sequence[str]) -> FramePath:
    """Return the joints between the ground and a link's frame.

    Args:
        model: a tree of scalar joints.
        frame: one of `moving_frames`.
        joints: names that the mechanism has.

    Raises:
        MechanismError: in absolute coordinates, which have no such joints.
    """
    place = model.frames[model.getFrameId(frame, pin.FrameType.BODY)]
    chain = [i for i in model.supports[place.parentJoint] if i > 0]
    names = tuple(model.names[i] for i in chain)
    if not {*names} <= {*joints}:
        raise MechanismError(
            f"frame '{frame}': in absolute coordinates a force at a place has no joints to act on; "
            "add it to the mechanism in joint coordinates before"
        )
    return FramePath(
        joints=names,
        rotations=np.array([model.jointPlacements[i].rotation for i in chain]),
        offsets=np.array([model.jointPlacements[i].translation for i in chain]),
        axes=np.array([joint_axis(model, i) for i in chain]),
        turning=np.array([model.joints[i].shortname().startswith("JointModelR") for i in chain]),
        tip=(place.placement.rotation.copy(), place.placement.translation.copy()),
    )
