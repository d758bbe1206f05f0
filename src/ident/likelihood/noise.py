"""How much of the torques' error is noise of the motion, and the least that torques can have.

Var r = G P Gᵀ + σ²        P: of the smooth motion, N⁻¹ = (UᵀU)⁻¹ seen through B, Ḃ, B̈
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ident.equations.filter import Decimator
from ident.equations.point import Point
from ident.likelihood.gain import gain
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment
from ident.motion.spline import WIDTH, Spline

LOOKED_AT = 60  # samples of an experiment
LONGEST = 2000  # functions of a run that are looked at


def motion_noise(
    mechanism: Mechanism, e: Experiment, point: Point, cutoff: float | None
) -> np.ndarray:
    """(d,) variance of r that noise of the smooth motion makes, over an experiment."""
    assert e.smooth is not None
    near = np.zeros(len(e), dtype=bool)
    for run, spline in e.smooth.runs:
        last = spline.basis.t0 + (LONGEST - WIDTH) * spline.basis.spacing
        near[run] = e.t[run] < last
    usable = np.flatnonzero(e.usable & near)
    chosen = usable[:: max(1, len(usable) // LOOKED_AT)]
    some = e.at_samples(chosen)
    G = gain(mechanism, some, e.smooth.names, point, cutoff)
    total = np.zeros(G.shape[1])
    for run, spline in e.smooth.runs:
        inside = (chosen >= run.start) & (chosen < run.stop)
        if inside.any():
            P = _spread(spline, e.t[chosen[inside]])
            total += np.einsum("nuir,nirjs,nujs->u", G[inside], P, G[inside])
    return total / max(len(chosen), 1)


def torque_noise(mechanism: Mechanism, e: Experiment, cutoff: float | None) -> np.ndarray:
    """(d,) white noise of the measured torques that the rows' filter lets pass [N m | N]."""
    taps = Decimator.of(cutoff, e.rate).taps
    passed = 1.0 if taps is None else float(np.sqrt(taps @ taps))
    sigma = np.array([e.noise.get(f"tau.{name}", 0.0) for name in mechanism.driven])
    if e.leverage is None:
        found = np.zeros(mechanism.model.nv)
        found[[mechanism.joint(name).index for name in mechanism.driven]] = sigma
        return passed * found
    W = e.leverage[e.usable][:, [mechanism.joint_index[name] for name in mechanism.driven]]
    return passed * np.asarray(np.sqrt(np.einsum("nju,j->u", W**2, sigma**2) / max(len(W), 1)))


def _spread(spline: Spline, t: np.ndarray) -> np.ndarray:
    """P (n, d, 3, d, 3) of u, u̇, ü at times t (n,)."""
    basis, (count, d) = spline.basis, spline.c.shape
    size = min(count, LONGEST) * d  # N's leading block is that of U
    first = spline.first[:size]
    row = np.repeat(np.arange(size), WIDTH * d)
    column = (first[:, None] * d + np.arange(WIDTH * d)).ravel()
    inside = column < size
    entries = spline.leading(size).ravel()[inside]
    U = sp.csr_matrix((entries, (row[inside], column[inside])), shape=(size, size))
    factor = splu((U.T @ U).tocsc())
    t = np.clip(t, basis.t0, basis.t_end)
    B = np.zeros((len(t), d, 3, size))
    for order in range(3):
        first, values = basis.window(t, order)
        for i in range(d):
            for r in range(WIDTH):
                B[np.arange(len(t)), i, order, (first + r) * d + i] = values[:, r]
    flat = B.reshape(-1, size)
    solved = factor.solve(flat.T).T.reshape(len(t), d, 3, size)
    return np.asarray(np.einsum("nirk,njsk->nirjs", B, solved))
