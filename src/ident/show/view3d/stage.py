"""What is to be seen: bodies, joints and closures, and where they are over time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.show.view3d.shapes import Shape


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body: shapes in its own axes. The first of a stage is the ground."""

    name: str
    shapes: tuple[Shape, ...] = ()


@dataclass(frozen=True, eq=False)
class Pivot:
    """The mark of a joint: a disc about, or a bar along, the z of a frame of a body.

    Attributes:
        name: the joint's.
        rotational: whether it turns.
        body: index of the body it is drawn on.
        R, p: (3, 3), (3,) [m] of the frame in that body.
    """

    name: str
    rotational: bool
    body: int
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
    """What does not change over time.

    Attributes:
        name: the mechanism's.
        bodies: the ground, then the moving ones.
        pivots: of the joints; ties: of the closures that have two places.
        up: (3,) the direction against gravity.
        size: [m] of the mechanism, by which marks are scaled.
    """

    name: str
    bodies: tuple[Body, ...]
    pivots: tuple[Pivot, ...]
    ties: tuple[Tie, ...]
    up: np.ndarray
    size: float


@dataclass(frozen=True, eq=False)
class Loads:
    """Reactions over time, in world axes; K of them, two a closure.

    Attributes:
        names: (K,) as `pin on rocker`.
        second: (K,) whether it acts on the closure's b, against the one on a.
        at: (n, K, 3) points of action [m].
        force: (n, K, 3) [N]; moment: (n, K, 3) [N m].
    """

    names: tuple[str, ...]
    second: np.ndarray
    at: np.ndarray
    force: np.ndarray
    moment: np.ndarray


@dataclass(frozen=True, eq=False)
class Film:
    """Where everything is at n moments of one experiment.

    Attributes:
        name: the experiment's.
        t: (n,) [s].
        position, wxyz: (n, bodies, 3) [m] and (n, bodies, 4), of the stage's bodies.
        ends: (n, ties, 2, 3) origins of both frames of each closure in the world [m].
        gap: (n,) largest |Φ| [m | rad].
        loads: reactions, where they are known.
        misfit: (n, pivots) residual of a joint as a share of `unit`; NaN where not known.
        unit: of the misfit, in words.
    """

    name: str
    t: np.ndarray
    position: np.ndarray
    wxyz: np.ndarray
    ends: np.ndarray
    gap: np.ndarray
    loads: Loads | None = None
    misfit: np.ndarray | None = None
    unit: str = ""

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

    def nearest(self, t: float) -> int:
        """The moment nearest to a time [s]."""
        return int(nearest(self.t, np.array([t]))[0])


def nearest(t: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Indices (k,) of the samples of t (n,), ascending, that are nearest to `wanted` (k,)."""
    if len(t) == 1:
        return np.zeros(len(wanted), dtype=int)
    after = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    return np.where(wanted - t[after - 1] <= t[after] - wanted, after - 1, after)
