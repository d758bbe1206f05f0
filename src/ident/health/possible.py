"""What no machine can have, as inequalities on the unknowns: G x + g ≥ 0.

    inertia of an independent coordinate      u ↦ (Zᵀ Γ(q, 0, Z e_u) x)_u ≥ 0, mean over the log
    viscous and dry friction of a joint       Fv, Fc ≥ 0

A free fit to a torque with the wrong sign turns all of a joint's parameters over and is as good as
the right one; only that they cannot be negative tells the two apart.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from ident.equations.correct import Seen
from ident.equations.scene import Scene
from ident.equations.terms import Terms, terms
from ident.fit import Fit
from ident.health.evidence import USUAL
from ident.motion import Experiment

LOOKED_AT = 40  # samples at which the inertia is evaluated, over all experiments
POSITIVE = {"viscous": ("Fv",), "coulomb": ("Fc",)}  # and their place among the usual columns


def possible(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """G (d + 2 J, k + 5 J) and g (d + 2 J,)."""
    driven, k = fit.mechanism.driven, len(fit.columns)
    width = k + USUAL * len(driven)
    inertia, offset = _inertia(fit, width)
    friction = np.zeros((2 * len(driven), width))
    for j, joint in enumerate(driven):
        for i, (kind, (word,)) in enumerate(POSITIVE.items()):
            row = friction[2 * j + i]
            row[k + USUAL * j + i] = 1.0
            name = f"{kind}.{joint}.{word}"
            if name in fit.columns.index:
                row[fit.columns.index[name]] = 1.0
    return np.concatenate([inertia, friction]), np.concatenate([offset, np.zeros(len(friction))])


def _inertia(fit: Fit, width: int) -> tuple[np.ndarray, np.ndarray]:
    mechanism, k = fit.mechanism, len(fit.columns)
    d = len(fit.motion.independent)
    total, offset, count = np.zeros((d, width)), np.zeros(d), 0
    for e in fit.motion.experiments:
        share = LOOKED_AT // len(fit.motion.experiments)
        some = at_samples(
            e, np.flatnonzero(e.usable)[:: max(1, int(e.usable.sum()) // max(share, 4))]
        )
        still = replace(some, v=0 * some.v, yd=0 * some.yd, a=0 * some.a, ydd=0 * some.ydd)
        rest = _terms(fit, still)
        for u in range(d):
            if some.leverage is None or some.pinv is None:
                a, ydd = np.zeros_like(some.a), np.zeros_like(some.ydd)
                a[:, u] = 1.0
                ydd[:, [j.index for j in mechanism.joints].index(u)] = 1.0
            else:
                a, ydd = some.pinv[:, :, -d + u], some.leverage[:, :, u]
            moved = _terms(fit, replace(still, a=a, ydd=ydd))
            total[u, :k] += (moved.A - rest.A)[:, u].sum(axis=0)
            offset[u] -= float((moved.b - rest.b)[:, u].sum())
            for j, name in enumerate(mechanism.driven):
                lever = ydd[:, mechanism.joint_index[name]]
                total[u, k + USUAL * j + USUAL - 1] += float(lever @ lever)
        count += len(still)
    held = fit.estimate.held
    offset += total[:, :k][:, held] @ fit.estimate.solution.x[held]
    total[:, :k][:, held] = 0.0
    return total / count, offset / count


def _terms(fit: Fit, e: Experiment) -> Terms:
    """Of samples that are no course of time, so without what corrects the data."""
    scene = Scene(Seen(fit.mechanism, e), fit.columns, fit.point)
    return terms(scene, slice(0, len(e)))


def at_samples(e: Experiment, index: np.ndarray) -> Experiment:
    """An experiment of some of its samples alone, all of them usable."""
    own: dict[str, Any] = {
        field.name: value[index]
        for field in fields(e)
        if field.name != "still" and isinstance(value := getattr(e, field.name), np.ndarray)
    }
    return replace(e, **own, extra={name: x[index] for name, x in e.extra.items()})
