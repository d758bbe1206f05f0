"""The equations of motion without multipliers, the only place where they are put together.

    Γ p + E c + S s = τ + f_e − known + S s₀      A = [Γ E S] of what is unknown, b the right side

S are the sensitivities of shape parameters s at the working point s₀. In generalised coordinates
Jᵀλ is missing, and `stack` expands it in time; in the independent ones all terms are projected by
Zᵀ, and there is none. The samples know which coordinates they are in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.effects import Effect
from ident.equations.point import Point
from ident.equations.samples import Samples
from ident.equations.scene import Scene


@dataclass(frozen=True, eq=False)
class Terms:
    """The equations of n samples, r rows each: r = nv, or d if the samples are reduced.

    Attributes:
        A: (n, r, k), the columns of the unknowns x.
        b: (n, r) [N m | N], the known side.
        tau: (n, r) [N m | N], the measured torques alone.
        told: by effect and joint, where some sample does not inform: the joint's name and (n,),
            false where dry friction at standstill leaves the torque of that joint open.
    """

    A: np.ndarray
    b: np.ndarray
    tau: np.ndarray
    told: list[tuple[str, np.ndarray]]


def terms(scene: Scene, part: slice | np.ndarray, *, full: bool = False) -> Terms:
    """A x = b of some samples, in the independent coordinates or in full."""
    columns, point = scene.columns, scene.point
    s = scene.generalised(part) if full else scene.samples(part)
    tau = s.measured(s.mechanism.driven)
    b = tau.copy() if s.wrench is None else tau + s.wrench
    n, r = s.shape
    # columns stand whole in memory: that is how they are filled, cut in time and factored
    A = np.zeros((r, len(columns), n)).transpose(2, 0, 1)
    for place, column in enumerate(columns.rigid):
        A[:, :, place] = s.gamma[:, :, column]
    if len(columns.known):
        b -= s.gamma[:, :, columns.known] @ columns.known_values
    told = []
    for effect, places in columns.effects:
        if effect.corrects:
            continue
        c, shape = point.of(effect)
        u = len(effect.unknowns)
        unknown = places[:u] >= 0
        if unknown.any():
            mine = places[:u][unknown]  # neighbours in x, so that a view of A can be added to
            s.add_effect(A[:, :, mine[0] : mine[-1] + 1], effect, np.eye(u)[:, unknown], shape)
        if not unknown.all():
            s.add_effect(b, effect, -np.where(unknown, 0.0, c), shape)
        for at, name in zip(places[u:], (each.name for each in effect.shapes), strict=True):
            if at >= 0:  # ∂(E c)/∂s
                s.add_sensitivity(A[:, :, at], effect, c, shape, name)
                b += A[:, :, at] * shape[name]
        told += told_by(s, effect)
    for beside, above, below in scene.sensitivities(part, full):
        S = -(unbalanced(above, point) - unbalanced(below, point)) / (2 * beside.h)
        A[:, :, beside.place] = S
        b += S * beside.value
    return Terms(A, b, tau, told)


def told_by(s: Samples, effect: Effect) -> list[tuple[str, np.ndarray]]:
    """Joints of an effect at which some sample does not inform, with (n,) whether it does."""
    if not effect.local:
        return []
    informed = effect.informed(s.signals(effect.joints))
    return [
        (name, informed[:, i]) for i, name in enumerate(effect.joints) if not informed[:, i].all()
    ]


def unbalanced(s: Samples, point: Point) -> np.ndarray:
    """b − A x (n, r) at the working point."""
    f = s.measured(s.mechanism.driven) - s.gamma @ point.pi
    if s.wrench is not None:
        f += s.wrench
    for effect in s.mechanism.effects:
        c, shape = point.of(effect)
        if effect.unknowns and len(shape) == len(effect.shapes):
            s.add_effect(f, effect, -c, shape)
    return f
