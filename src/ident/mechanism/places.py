"""Places whose coordinates a mechanism takes from the URDF or the closures, and how they are moved.

<joint>.<x|y|z>                  a joint's origin in its parent's axes
<closure>.<a|b>.<x|y|z>          an end of a closure in its link's axes
<closure>.length                 of a `distance` closure
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from ident.errors import MechanismError, one_of
from ident.mechanism.closures import Closure
from ident.mechanism.mechanism import Mechanism


def places(mechanism: Mechanism) -> tuple[str, ...]:
    """All places, in order: joints', closures'."""
    found = [
        f"{joint.name}.{axis}"
        for joint in mechanism.joints
        if joint.in_tree and mechanism.model.existJointName(joint.name)
        for axis in "xyz"
    ]
    for closure in mechanism.closures:
        if not isinstance(closure, Closure):
            continue
        found += [f"{closure.name}.{end}.{axis}" for end in "ab" for axis in "xyz"]
        if closure.kind == "distance":
            found.append(f"{closure.name}.length")
    return tuple(found)


def moved(mechanism: Mechanism, place: str, by: float) -> Mechanism:
    """The mechanism with a place moved by a displacement [m].

    Raises:
        MechanismError: if there is no such place.
    """
    if place not in places(mechanism):
        raise MechanismError(
            f"{mechanism.name}: no place '{place}'; {one_of(place, places(mechanism))}"
        )
    owner, _, axis = place.rpartition(".")
    step = np.eye(3)["xyz".index(axis)] * by if axis in "xyz" else np.zeros(3)
    if mechanism.model.existJointName(owner):
        model = mechanism.model.copy()
        index = model.getJointId(owner)
        at = model.jointPlacements[index]
        model.jointPlacements[index] = pin.SE3(at.rotation, at.translation + step)
        return replace(mechanism, model=model)
    closures = []
    for closure in mechanism.closures:
        if isinstance(closure, Closure) and axis == "length" and owner == closure.name:
            closure = replace(closure, length=closure.length + by)
        elif isinstance(closure, Closure) and owner in (f"{closure.name}.a", f"{closure.name}.b"):
            end = owner[-1]
            frame = getattr(closure, end)
            at = frame.placement
            frame = replace(
                frame, placement=pin.SE3(at.rotation, at.translation + at.rotation @ step)
            )
            closure = replace(closure, **{end: frame})
        closures.append(closure)
    return replace(mechanism, closures=tuple(closures))
