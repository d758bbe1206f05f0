"""Shapes as triangles, in the axes of the body that carries them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Colour = tuple[int, int, int]
CIRCLE = 40  # segments of a round thing


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangles of one colour.

    Attributes:
        vertices: (k, 3) [m].
        faces: (f, 3) indices of vertices.
        colour: red, green, blue of 0 … 255; None takes that of the body.
        flat: whether edges are to be seen as edges.
    """

    vertices: np.ndarray
    faces: np.ndarray
    colour: Colour | None = None
    flat: bool = True

    def moved(self, R: np.ndarray, p: np.ndarray) -> Shape:
        """The shape turned by R (3, 3), then moved by p (3,) [m]."""
        return replace(self, vertices=self.vertices @ np.asarray(R).T + p)

    def coloured(self, colour: Colour | None) -> Shape:
        """The shape in another colour."""
        return replace(self, colour=colour)

    @property
    def corners(self) -> np.ndarray:
        """Corners (8, 3) of the box around it [m]."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        grid = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T
        return low + grid * (high - low)


def _shape(mesh: Any, flat: bool = True) -> Shape:
    return Shape(np.array(mesh.vertices, float), np.array(mesh.faces, np.uint32), None, flat)


def box(size: Sequence[float]) -> Shape:
    """A cuboid with edges of `size` (3,) [m], about the origin."""
    import trimesh

    return _shape(trimesh.creation.box(extents=np.asarray(size, float)))


def cylinder(radius: float, length: float) -> Shape:
    """A cylinder along z, about the origin [m]."""
    import trimesh

    return _shape(trimesh.creation.cylinder(radius, length, sections=CIRCLE))


def sphere(radius: float) -> Shape:
    """A ball about the origin [m]."""
    return ellipsoid((radius, radius, radius))


def ellipsoid(axes: Sequence[float]) -> Shape:
    """An ellipsoid about the origin with semi-axes (3,) [m]."""
    import trimesh

    ball = _shape(trimesh.creation.icosphere(subdivisions=3), flat=False)
    return replace(ball, vertices=ball.vertices * np.asarray(axes, float))


def capsule(a: np.ndarray, b: np.ndarray, radius: float) -> Shape:
    """A rod with round ends from a (3,) to b (3,) [m]."""
    import trimesh

    along = np.asarray(b, float) - np.asarray(a, float)
    length = float(np.linalg.norm(along))
    rod = _shape(trimesh.creation.capsule(length, radius, count=[16, 16]), flat=False)
    middle = (rod.vertices.min(axis=0) + rod.vertices.max(axis=0)) / 2
    rod = replace(rod, vertices=rod.vertices - middle)
    return rod.moved(turned_to(along), (np.asarray(a, float) + np.asarray(b, float)) / 2)


def turned_to(direction: np.ndarray) -> np.ndarray:
    """A rotation (3, 3) that turns z to `direction` (3,); the identity for none."""
    length = float(np.linalg.norm(direction))
    if length == 0:
        return np.eye(3)
    z = np.asarray(direction, float) / length
    seed = np.eye(3)[int(np.abs(z).argmin())]
    x = seed - z * (z @ seed)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def arrow() -> Shape:
    """An arrow from the origin to (0, 0, 1), its radii of 1: to be scaled by (r, r, length)."""
    import trimesh

    shaft = trimesh.creation.cylinder(0.4, 0.78, sections=20)
    shaft.apply_translation([0, 0, 0.39])
    head = trimesh.creation.cone(1.0, 0.25, sections=20)
    head.apply_translation([0, 0, 0.75 - head.bounds[0][2]])
    return _shape(trimesh.util.concatenate([shaft, head]))
