"""What a model says of a motion: torques of the driven joints, the sum taken apart, multipliers.

    f = Γ π + E c − f_e − Σ_{driven, not in u} W_jᵀ τ_j  =  W_uᵀ τ_u − Jᵀ λ
    [−λ; τ̂_u] = K⁺ᵀ f         λ from the rows of the passive joints, then τ̂ of the independent ones

τ̂_u never sees the measured torque of u.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.rows import dof
from ident.equations.samples import Samples
from ident.equations.scene import Scene
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment, Motion

CHUNK = 2048
NOTHING = Columns((), (), np.empty(0), np.empty(0, int), np.empty(0, int), np.empty(0), ())


@dataclass(frozen=True, eq=False)
class Prediction:
    """Of one experiment, with n samples, d independent coordinates and m multipliers.

    Attributes:
        t: (n,) [s]; joints: names of the independent coordinates.
        measured, predicted: (n, d) torques [N m | N]; residual = measured − predicted.
        parts: (n, d) by name: `rigid bodies`, each effect, `external wrenches`; they add up to
            `predicted`.
        multipliers: (n, m) λ.
        usable: (n,) samples that take part.
    """

    name: str
    t: np.ndarray
    joints: tuple[str, ...]
    measured: np.ndarray
    predicted: np.ndarray
    parts: dict[str, np.ndarray]
    multipliers: np.ndarray
    usable: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        """measured − predicted (n, d)."""
        return self.measured - self.predicted


def predict(mechanism: Mechanism, motion: Motion, point: Point) -> list[Prediction]:
    """Predictions for every experiment, at full rate and unfiltered.

    Args:
        mechanism: the mechanism.
        motion: its motion.
        point: values of all parameters.
    """
    return [_predict(mechanism, motion, e, point) for e in motion.experiments]


def _predict(mechanism: Mechanism, motion: Motion, bare: Experiment, point: Point) -> Prediction:
    scene = Scene.of(mechanism, NOTHING, bare, point, motion.band.cutoff)
    mechanism, e = scene.mechanism, scene.e
    effects = [effect for effect in mechanism.effects if effect.unknowns]
    n, d, m = len(e), dof(mechanism, e), len(mechanism.kinematics.multipliers)
    names = ["rigid bodies", *(effect.label for effect in effects)]
    if e.wrench is not None:
        names.append("external wrenches")
    parts = {name: np.empty((n, d)) for name in names}
    others = tuple(name for name in mechanism.driven if name not in motion.independent)
    measured, multipliers = np.empty((n, d)), np.empty((n, m))
    for start in range(0, n, CHUNK):
        part = slice(start, min(start + CHUNK, n))
        s, u = scene.generalised(part), scene.samples(part)
        forces = generalised(s, point)
        for name, force in zip(names, forces, strict=True):
            parts[name][part] = u.reduce(force)
        measured[part] = u.measured(mechanism.driven)
        if e.pinv is not None:
            f = sum(forces) - s.measured(others)
            multipliers[part] = -np.einsum("nij,ni->nj", e.pinv[part][:, :, :m], f)
    return Prediction(
        e.name, e.t, motion.independent, measured, sum(parts.values(), np.zeros((n, d))), parts,
        multipliers, e.usable,
    )  # fmt: skip


def generalised(s: Samples, point: Point) -> list[np.ndarray]:
    """Generalised forces (n, nv) of the rigid bodies, of each effect, and less the wrenches."""
    forces = [s.rigid(point.pi)]
    for effect in s.mechanism.effects:
        if effect.unknowns:
            forces.append(np.zeros(s.shape))
            s.add_effect(forces[-1], effect, *point.of(effect))
    if s.e.wrench is not None:
        forces.append(-s.e.wrench[s.part])
    return forces
