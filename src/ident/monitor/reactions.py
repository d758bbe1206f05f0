"""Where a change is felt: what it does to the forces in the loops.

    Δλ = −K⁺ᵀ_λ A Δx          rms over normal running, from one triangle a multiplier

Torques alone do not show it: of suspects that they cannot tell apart, a force sensor in a closure
may tell.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.equations.terms import terms
from ident.monitor.watched import Watched
from ident.motion import Motion
from ident.solve.factor import Factor

LOOKED_AT = 600  # samples of an experiment in which Δλ is taken


def felt(watched: Watched, motion: Motion) -> tuple[Factor, ...]:
    """For every multiplier the triangle of ∂λ/∂x (samples, k) over a motion; none for a tree.

    Args:
        watched: whose columns.
        motion: of normal running.
    """
    m = len(watched.mechanism.kinematics.multipliers)
    found = [Factor.empty(len(watched.columns)) for _ in range(m)]
    for e in motion.experiments if m else ():
        at = np.flatnonzero(e.usable)[:: max(1, len(e) // LOOKED_AT)]
        scene = watched.scene(e.at_samples(at))
        assert scene.e.pinv is not None
        A = terms(scene, slice(None), full=True).A
        slope = -scene.e.pinv[:, :, :m].transpose(0, 2, 1) @ A
        found = [f.updated(slope[:, j], np.zeros(len(at))) for j, f in enumerate(found)]
    return tuple(found)


def changes(watched: Watched, factors: Sequence[Factor], dx: np.ndarray) -> dict[str, float]:
    """By multiplier the rms of Δλ [N | N m] that a change dx (k,) makes in normal running."""
    names = watched.mechanism.kinematics.multipliers
    return {
        name: float(np.linalg.norm(factor.R @ dx)) / max(factor.rows, 1) ** 0.5
        for name, factor in zip(names, factors, strict=False)
    }
