"""Torques that a model predicts of a motion, their parts, and the multipliers.

    f = Γ π + E c − f_e                generalised forces of rigid bodies, effects, less wrenches
    [−λ; τ̂_u] = K⁺ᵀ (f − Σ_{driven, not in u} W_jᵀ τ_j)
                                       λ from the rows of the passive joints, then τ̂ of the
                                       independent ones; τ̂_u never sees the measured torque of u
    residual = measured − predicted    predicted = Σ parts

A `Prediction` is at full rate and unfiltered; a `Trace` at the rows of the regression, filtered and
decimated as they are, so that its residual is b − A x.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ident.equations.corrections import Scene
from ident.equations.filter import Decimator
from ident.equations.rows import informing, largest_transmission
from ident.equations.terms import Samples, informative_joints
from ident.equations.unknowns import NOTHING, Point
from ident.information.blocks import Squares
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, State
from ident.motion.regressor import rigid_forces

CHUNK = 2048  # samples whose regressor is in memory at once
RIGID, WRENCHES = "rigid bodies", "external wrenches"


@dataclass(frozen=True, eq=False)
class TorqueParts:
    """Measured torques of one experiment, and the parts of the predicted ones.

    Attributes:
        name: the experiment's; t: (n,) [s].
        measured: (n, d) torques of the independent coordinates [N m | N].
        parts: (n, d) by name: `rigid bodies`, each effect, less the `external wrenches`; they add
            up to `predicted`.
    """

    name: str
    t: np.ndarray
    measured: np.ndarray
    parts: Mapping[str, np.ndarray]

    @cached_property
    def predicted(self) -> np.ndarray:
        """Σ parts (n, d)."""
        return sum(self.parts.values(), np.zeros_like(self.measured))

    @property
    def residual(self) -> np.ndarray:
        """measured − predicted (n, d)."""
        return self.measured - self.predicted

    @property
    def squares(self) -> Squares:
        """Sums of squares of the residual and of the measured torques."""
        return _squares(self.residual, self.measured)


@dataclass(frozen=True, eq=False)
class Prediction(TorqueParts):
    """Prediction of one experiment: n samples, d independent coordinates and m multipliers.

    Attributes:
        joints: names of the independent coordinates.
        multipliers: (n, m) λ.
        usable: (n,) samples that take part.
    """

    joints: tuple[str, ...]
    multipliers: np.ndarray
    usable: np.ndarray

    @property
    def squares(self) -> Squares:
        """The same, of usable samples."""
        return _squares(self.residual[self.usable], self.measured[self.usable])


@dataclass(frozen=True, eq=False)
class Trace(TorqueParts):
    """The residual of one experiment: n rows, filtered and decimated as the regression had them.

    With d independent coordinates and J named joints:

    Attributes:
        segment: (n,), rows of one number follow each other without a gap.
        gravity: (n, d), what of the rigid bodies' part is there without motion.
        q, v, a: (n, J) [rad | m], [.../s], [.../s²] of all named joints.
        direction: (n, J), sign(v), v/still at standstill.
        informed: (n, d), false where dry friction at standstill leaves the torque open.
    """

    segment: np.ndarray
    gravity: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    direction: np.ndarray
    informed: np.ndarray

    def __len__(self) -> int:
        return len(self.t)

    @cached_property
    def load(self) -> np.ndarray:
        """Torque (n, d) that the links ask of each joint: the prediction without the effects."""
        known = [self.parts[name] for name in (RIGID, WRENCHES) if name in self.parts]
        return sum(known, np.zeros_like(self.measured))

    def runs(self) -> list[slice]:
        """Return rows without a gap between them."""
        edges = [0, *(np.flatnonzero(np.diff(self.segment)) + 1), len(self)]
        return [slice(int(i), int(j)) for i, j in pairwise(edges) if j > i]


def _squares(residual: np.ndarray, measured: np.ndarray) -> Squares:
    rows = np.full(measured.shape[1], float(len(measured)))
    return Squares((residual**2).sum(axis=0), (measured**2).sum(axis=0), rows)


def predict(mechanism: Mechanism, motion: Motion, point: Point) -> list[Prediction]:
    """Predict every experiment of a motion, at full rate and unfiltered."""
    return [_predict(mechanism, motion, e, point) for e in motion.experiments]


def _predict(mechanism: Mechanism, motion: Motion, bare: State, point: Point) -> Prediction:
    scene = Scene.of(mechanism, NOTHING, bare, point, motion.band.cutoff)
    mechanism, e = scene.mechanism, scene.e
    n, d, m = len(e), e.leverage.shape[2], len(mechanism.kinematics.multipliers)
    parts: dict[str, np.ndarray] = {}
    others = tuple(name for name in mechanism.driven if name not in motion.independent)
    measured, multipliers = np.empty((n, d)), np.empty((n, m))
    for start in range(0, n, CHUNK):
        part = slice(start, min(start + CHUNK, n))
        s, u = scene.generalised(part), scene.samples(part)
        forces = _generalised(s, point)
        for name, force in forces.items():
            parts.setdefault(name, np.empty((n, d)))[part] = u.reduce(force)
        measured[part] = u.measured(mechanism.driven)
        if e.loop is not None:
            f = sum(forces.values()) - s.measured(others)
            multipliers[part] = -np.einsum("nij,ni->nj", e.pinv[part][:, :, :m], f)
    return Prediction(e.name, e.t, measured, parts, motion.independent, multipliers, e.usable)


def trace_of(mechanism: Mechanism, point: Point, motion: Motion, e: State) -> Trace:
    """Return the residual of one experiment at a working point."""
    scene = Scene.of(mechanism, NOTHING, e, point, motion.band.cutoff)
    mechanism, e = scene.mechanism, scene.e
    farthest = largest_transmission(e)
    names = list(_generalised(scene.generalised(slice(0, 1)), point))

    def make(part: slice) -> list[np.ndarray]:
        """Return measured torque, gravity, parts; joint signals; informed."""
        s, u = scene.generalised(part), scene.samples(part)
        forces = _generalised(s, scene.point)
        gravity = rigid_forces(mechanism.model, e.q[part], 0 * e.v[part], 0 * e.v[part], point.pi)
        direction = np.clip(e.yd[part] / e.still, -1.0, 1.0)
        informs = [each for effect in mechanism.effects for each in informative_joints(u, effect)]
        rows = [u.measured(mechanism.driven), u.reduce(gravity), *map(u.reduce, forces.values())]
        joints = np.stack([e.y[part], e.yd[part], e.ydd[part], direction], axis=1)
        return [np.stack(rows, axis=1), joints, informing(u, informs, farthest)]

    d, J = len(motion.independent), len(mechanism.joints)
    counts = 2 + len(names)
    empty = np.zeros((0, counts, d)), np.zeros((0, 4, J)), np.ones((0, d), bool)
    found: list[list[np.ndarray]] = [[np.zeros(0), np.zeros(0, int), *empty]]
    for number, segment in enumerate(e.segments()):
        decimator = Decimator.of(motion.band.cutoff, e.rate)
        for sample, series in decimator.filtered(segment, make):
            found.append([e.t[sample], np.full(len(sample), number), *series])
    t, segments, torques, joints, informed = (np.concatenate(x) for x in zip(*found, strict=True))
    measured, gravity, *parts = (torques[:, i] for i in range(counts))
    q, v, a, direction = (joints[:, i] for i in range(4))
    by_name = dict(zip(names, parts, strict=True))
    return Trace(e.name, t, measured, by_name, segments, gravity, q, v, a, direction, informed)


def _generalised(s: Samples, point: Point) -> dict[str, np.ndarray]:
    """Return generalised forces (n, nv) of rigid bodies, of each effect, and less the wrenches."""
    forces = {RIGID: s.rigid(point.pi)}
    for effect in s.mechanism.effects:
        if effect.unknowns:
            forces[effect.label] = np.zeros(s.shape)
            s.add_effect(forces[effect.label], effect, *point.of(effect))
    if s.e.wrench is not None:
        forces[WRENCHES] = -s.e.wrench[s.part]
    return forces
