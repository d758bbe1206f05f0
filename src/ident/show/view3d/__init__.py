"""A mechanism moving in 3-D: shapes, bodies, joints, closures and reactions as plain arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np


def rotations(wxyz: np.ndarray) -> np.ndarray:
    """Return rotation matrices (…, 3, 3) of unit quaternions (…, 4), scalar part first."""
    from scipy.spatial.transform import Rotation

    flat = np.roll(wxyz.reshape(-1, 4), -1, axis=-1)
    return Rotation.from_quat(flat).as_matrix().reshape(*wxyz.shape[:-1], 3, 3)


def wxyz(R: np.ndarray) -> np.ndarray:
    """Return unit quaternions (…, 4), scalar part first, of rotation matrices (…, 3, 3)."""
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat()
    return np.roll(flat, 1, axis=-1).reshape(*R.shape[:-2], 4)


Colour = tuple[int, int, int]
CIRCLE = 40  # segments of a round thing


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangles of one colour: vertices (k, 3) [m], faces (f, 3) indices of vertices."""

    vertices: np.ndarray
    faces: np.ndarray
    colour: Colour | None = None  # that of the body
    flat: bool = True  # whether edges are visible

    def moved(self, R: np.ndarray, p: np.ndarray) -> Shape:
        """The shape turned by R (3, 3), then moved by p (3,) [m]."""
        return replace(self, vertices=self.vertices @ np.asarray(R).T + p)

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


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body: shapes in its own axes. The first of a stage is the ground."""

    name: str
    shapes: tuple[Shape, ...] = ()


@dataclass(frozen=True, eq=False)
class Pivot:
    """The mark of a joint: a disc about, or a bar along, z of the frame R (3, 3), p (3,) [m]."""

    name: str
    rotational: bool
    body: int  # index of the body in whose axes the frame is
    R: np.ndarray
    p: np.ndarray


@dataclass(frozen=True)
class Tie:
    """A closure between two frames, a and b, by the names of their links."""

    name: str
    kind: str
    a: str
    b: str


@dataclass(frozen=True, eq=False)
class Stage:
    """A mechanism without its motion: the ground and the bodies, joints, closures of two frames."""

    name: str
    bodies: tuple[Body, ...]
    pivots: tuple[Pivot, ...]
    ties: tuple[Tie, ...]
    up: np.ndarray  # (3,) against gravity
    size: float  # [m] of the mechanism, by which marks are scaled


@dataclass(frozen=True, eq=False)
class Loads:
    """Reactions over time in world axes, K of them, two a closure: (n, K, 3) each."""

    names: tuple[str, ...]  # as `pin on rocker`
    second: np.ndarray  # (K,) whether it acts on the closure's b, against the one on a
    at: np.ndarray  # points of action [m]
    force: np.ndarray  # [N]
    moment: np.ndarray  # [N m]


@dataclass(frozen=True, eq=False)
class Film:
    """Positions of everything at n moments of one experiment."""

    name: str
    t: np.ndarray  # (n,) [s]
    position: np.ndarray  # (n, bodies, 3) [m]
    wxyz: np.ndarray  # (n, bodies, 4)
    ends: np.ndarray  # (n, ties, 2, 3) [m] origins of both frames of each closure in the world
    gap: np.ndarray  # (n,) largest |Φ| [m | rad]
    loads: Loads | None = None
    misfit: np.ndarray | None = None  # (n, pivots) residual as a share of `unit`, or NaN
    unit: str = ""  # of the misfit, in words

    def __len__(self) -> int:
        return len(self.t)

    def at(self, index: np.ndarray) -> Film:
        """Some moments only, (k,) indices."""
        loads = self.loads
        if loads is not None:
            loads = replace(
                loads, at=loads.at[index], force=loads.force[index], moment=loads.moment[index]
            )
        return replace(
            self, t=self.t[index], position=self.position[index], wxyz=self.wxyz[index],
            ends=self.ends[index], gap=self.gap[index], loads=loads,
            misfit=None if self.misfit is None else self.misfit[index],
        )  # fmt: skip


def nearest(t: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the indices (k,) of the samples of t (n,), ascending, nearest to `wanted` (k,)."""
    if len(t) == 1:
        return np.zeros(len(wanted), dtype=int)
    after = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    return np.where(wanted - t[after - 1] <= t[after] - wanted, after - 1, after)


def frames(t: np.ndarray, rate: float, most: int, least: int = 2) -> np.ndarray:
    """Return the indices (k,) of samples of t (n,) [s] that become frames, evenly in time.

    First and last are among them; `rate` frames a second [Hz], `most` and, of a short motion to be
    watched slowly, `least` frames.
    """
    span = float(t[-1] - t[0])
    count = int(np.clip(round(rate * span) + 1, least, most))
    if count >= len(t):
        return np.arange(len(t))
    return np.unique(nearest(t, np.linspace(t[0], t[-1], count)))


def running_rms(t: np.ndarray, x: np.ndarray, width: float) -> np.ndarray:
    """Return the rms of x (n, k) over `width` [s] around each t (n,); NaN counts as no sample."""
    known = np.isfinite(x)
    zero = np.zeros((1, x.shape[1]))
    power = np.concatenate([zero, np.cumsum(np.where(known, x, 0.0) ** 2, axis=0)])
    count = np.concatenate([zero, np.cumsum(known, axis=0)])
    first = np.searchsorted(t, t - width / 2, side="left")
    last = np.searchsorted(t, t + width / 2, side="right")
    number = count[last] - count[first]
    mean = (power[last] - power[first]) / np.where(number > 0, number, np.nan)
    return np.sqrt(np.maximum(mean, 0.0))
