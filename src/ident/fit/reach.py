"""What can be said of the multipliers: which are determined, and which rest on priors."""

from __future__ import annotations

import numpy as np

from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.scene import Scene
from ident.equations.terms import terms
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.solve.rank import Base

SAMPLES = 200  # of an experiment that are looked at
MATTERS = 0.01  # share of a multiplier that priors may move unmentioned


def identifiable_multipliers(mechanism: Mechanism, motion: Motion) -> np.ndarray:
    """(m,) whether each multiplier is determined: no null direction of Jᵀ touches it.

    Redundant closure equations, such as the normal row of a planar loop closed by a `point`, carry
    loads that no motion shows.
    """
    m = len(mechanism.kinematics.multipliers)
    determined = np.ones(m, dtype=bool)
    for e in motion.experiments:
        q = e.q[e.usable][:: max(1, len(e) // SAMPLES)]
        if not m or not len(q):
            continue
        J = mechanism.kinematics.closure_rows(q).rate
        U, s, _ = np.linalg.svd(J, full_matrices=True)
        for k in range(len(q)):
            null = U[k][:, int((s[k] > 1e-8 * s[k].max(initial=1e-300)).sum()) :]
            determined &= (null**2).sum(axis=1) < 1e-12
    return determined


def resting_on_priors(
    mechanism: Mechanism,
    motion: Motion,
    columns: Columns,
    base: Base,
    plausible: np.ndarray,
    point: Point,
) -> dict[str, list[str]]:
    """By multiplier the unknowns whose priors it rests on, most important first.

    Some inertial directions change λ and never a torque: with A the columns of all rows and
    K⁺ = [J; W_u]⁺, λ = −K⁺ᵀ(A x − b) moves by −K⁺ᵀ(A_D − A_I K) when an unknown x_D that torques
    do not determine moves and the base parameters stay.

    Args:
        plausible: (k,) how far an unknown can be from its prior.
    """
    names, m = mechanism.kinematics.multipliers, len(mechanism.kinematics.multipliers)
    if not m or not len(base.dependent):
        return {}
    moved, size = np.zeros((m, len(base.dependent))), np.zeros(m)
    for e in motion.experiments:
        at = np.flatnonzero(e.usable)[:: max(1, len(e) // SAMPLES)]
        scene = Scene.of(mechanism, columns, e, point, motion.band.cutoff)
        found = terms(scene, at, full=True)
        assert e.pinv is not None
        extract = -e.pinv[at][:, :, :m].transpose(0, 2, 1)
        A, open_ = found.A, found.A @ columns.prior - found.b
        change = extract @ (A[:, :, base.dependent] - A[:, :, base.independent] @ base.K)
        moved = np.maximum(moved, np.abs(change).max(axis=0, initial=0.0))
        loads = np.einsum("nmi,ni->nm", extract, open_)
        size = np.maximum(size, np.abs(loads).max(axis=0, initial=0.0))
    by = moved * plausible[base.dependent]
    mentioned = {}
    for i, name in enumerate(names):
        order = np.argsort(-by[i])
        mine = [columns.names[base.dependent[j]] for j in order if by[i, j] > MATTERS * size[i]]
        if mine:
            mentioned[name] = mine
    return mentioned
