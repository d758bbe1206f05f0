"""Simple bodies for links of which no shape is known: rods between joints, and the inertia."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ident.mechanism.closures import Closure
from ident.mechanism.mechanism import Mechanism
from ident.show.view3d import Shape, capsule, ellipsoid

ROD = 0.012  # radius over the mechanism's size
WIDEST = 0.05  # semi-axis of an inertia's ellipsoid over the size
THINNEST = 0.015


def sites(mechanism: Mechanism) -> list[list[np.ndarray]]:
    """Places (3,) [m] on each body, the ground first: own joint, next joints, closures' frames."""
    model = mechanism.model
    found: list[list[np.ndarray]] = [[] for _ in range(model.njoints)]
    for index in range(1, model.njoints):
        found[model.parents[index]].append(np.array(model.jointPlacements[index].translation))
        found[index].append(np.zeros(3))
    for closure in mechanism.closures:
        if isinstance(closure, Closure):
            for frame in (closure.a, closure.b):
                found[frame.joint].append(np.array(frame.placement.translation))
    return found


def simple_body(mechanism: Mechanism, index: int, size: float) -> list[Shape]:
    """Rods from the body's joint to its other places, and the ellipsoid of its inertia.

    Args:
        mechanism: the mechanism; index: of the body, from 1 on; size: of the mechanism [m].
    """
    origin, *others = sites(mechanism)[index] or [np.zeros(3)]
    shapes = [
        capsule(origin, other, ROD * size)
        for other in others
        if np.linalg.norm(other - origin) > 1e-6 * size
    ]
    inertia = mechanism.model.inertias[index]
    return [*shapes, *([_ellipsoid(inertia, size)] if inertia.mass > 0 else [])]


def _ellipsoid(inertia: pin.Inertia, size: float) -> Shape:
    """Of even density with the same inertia, made smaller where it would hide the mechanism."""
    # I_x = m (b² + c²) / 5, so a² = 5 (I_y + I_z − I_x) / (2 m)
    moments, axes = np.linalg.eigh(inertia.inertia)
    squares = 2.5 * (moments.sum() - 2 * moments) / inertia.mass
    semi = np.sqrt(np.maximum(squares, 0.0))
    semi = np.maximum(semi * min(1.0, WIDEST * size / max(semi.max(), 1e-300)), THINNEST * size)
    if np.linalg.det(axes) < 0:
        axes = axes * [1, 1, -1]
    return ellipsoid(semi).moved(axes, inertia.lever)
