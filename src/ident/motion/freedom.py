"""Whether a mechanism can move at all, and what to look at if it cannot."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ident.errors import MechanismError
from ident.mechanism.mechanism import Mechanism

PARALLEL = 1e-6  # sine of the angle between axes that are meant to be parallel


def check_freedom(mechanism: Mechanism) -> None:
    """Refuses a mechanism that its loops hold still.

    Raises:
        MechanismError: if they leave no degree of freedom, with the axes that stand apart.
    """
    if mechanism.degrees_of_freedom > 0:
        return
    name = mechanism.name
    if not mechanism.closures:
        raise MechanismError(
            f"{name}: no joint of it moves; valid: one revolute or prismatic, or more"
        )
    apart, others = _apart(mechanism)
    why = "check the closures' kinds and frames, and the joints' <axis>"
    if apart:
        why = (
            f"the axis of {', '.join(apart)} is not parallel to those of {', '.join(others)}, as "
            "it is in a planar loop: check its <axis> (without one it is x of the joint's frame) "
            "and the closures' frames and kinds"
        )
    raise MechanismError(
        f"{name}: the loops leave 0 degrees of freedom, so nothing can move; {why}"
    )


def _apart(mechanism: Mechanism) -> tuple[list[str], list[str]]:
    """Turning joints whose axes are not parallel to those of most, and the most; or none."""
    model = mechanism.model
    J = pin.computeJointJacobians(model, model.createData(), mechanism.assembled)
    axes = {j.name: J[3:, j.index] for j in mechanism.joints if j.in_tree and j.rotational}
    sets = [
        [name for name, axis in axes.items() if np.linalg.norm(np.cross(one, axis)) < PARALLEL]
        for one in axes.values()
    ]
    most = max(sets, key=len, default=[])
    apart = [name for name in axes if name not in most]
    return (apart, most) if len(apart) < len(most) else ([], [])
