"""Where to look from, so that the whole motion fills the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.show.view3d.rotation import rotations
from ident.show.view3d.stage import Film, Stage

ANGLE = np.radians(35.0)  # vertical angle of view
LOOKED_AT = 40  # moments of a film that decide
FLAT = 0.35  # thickness over width below which a mechanism is looked at face on


@dataclass(frozen=True, eq=False)
class Camera:
    """Position, target (3,) [m], and the box (2, 3) [m] around everything that moves."""

    position: np.ndarray
    target: np.ndarray
    box: np.ndarray

    @property
    def size(self) -> float:
        """Diagonal of the box [m]."""
        return float(np.linalg.norm(self.box[1] - self.box[0]))


def points(stage: Stage, films: Sequence[Film]) -> np.ndarray:
    """Corners of all shapes, joints and closures (k, 3) at some moments of the films [m]."""
    found = []
    for film in films:
        for k in np.unique(np.linspace(0, len(film) - 1, LOOKED_AT).astype(int)):
            R = rotations(film.wxyz[k])
            for i, body in enumerate(stage.bodies):
                own = [shape.corners for shape in body.shapes]
                own += [pivot.p[None] for pivot in stage.pivots if pivot.body == i]
                if own:
                    found.append(np.concatenate(own) @ R[i].T + film.position[k, i])
            found.append(film.ends[k].reshape(-1, 3))
    return np.concatenate(found)


def framed(stage: Stage, films: Sequence[Film]) -> Camera:
    """The camera that sees all of the motion, a flat mechanism face on."""
    cloud = points(stage, films)
    box = np.array([cloud.min(axis=0), cloud.max(axis=0)])
    target = box.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov((cloud - target).T) + 1e-12 * np.eye(3))
    thin = axes[:, 0]
    up = stage.up
    side = np.cross(up, [0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [1.0, 0.0, 0.0])
    front = np.cross(side, up)
    if np.sqrt(spread[0] / spread[1]) < FLAT:
        towards = thin * (1.0 if thin @ (up + 0.3 * side - 0.6 * front) >= 0 else -1.0)
        # neither straight down, where "up" means nothing, nor without any depth
        lift = 0.35 * up if abs(thin @ up) < 0.7 else -0.6 * front
        direction = towards + lift + 0.3 * side
    else:
        direction = 0.8 * side - 1.0 * front + 0.55 * up
    direction = direction / np.linalg.norm(direction)
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    above = np.cross(direction, right)
    seen = cloud - target
    # far enough that every point is within the angle of view, with a margin
    reach = np.maximum(np.abs(seen @ right) / 1.25, np.abs(seen @ above)) * 1.25
    distance = float((reach / np.tan(ANGLE / 2) + seen @ direction).max())
    return Camera(target + max(distance, 1e-3) * direction, target, box)
