"""Where a machine would be if its model were true: the measured motion, and what torques add.

    M_u δü = r,   M_u = Lᵀ M L,   δu = δu̇ = 0 every T seconds,   q_ghost = q + L δu

with the residual r = measured − predicted torque of the independent coordinates u and the velocity
transmission L = ∂q̇/∂u̇. It is the simulation of `replay` to first order: for the short time T the
ghost stays near the measured state, at which M, L and r are known. It costs some 10 µs a sample
where an integration costs milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ident.fit.prediction import Prediction
from ident.mechanism.parameters import rigid_tangents
from ident.motion.signals import runs

LONGEST = 0.5  # shown: [s] from one restart to the next
SPREAD = 0.3  # shown: of a joint's travel, that a ghost leaves the measured position by at most
RATE = 200.0  # numerics: [Hz] at which the deviation is integrated, linear in between
PERCENTILE = 95.0  # shown: of accelerations, whose ghost is to stay within SPREAD


def deviation_rate(prediction: Prediction, samples: slice) -> tuple[np.ndarray, np.ndarray]:
    """Return δü (n, d), by which a model's acceleration differs from the measured one, and L
    (n, nv, d); 0 where a sample is not usable.
    """
    scene = prediction.scene
    e, model, point = scene.e, scene.mechanism.model, scene.point
    q, d = e.q[samples], prediction.residual.shape[1]
    L, zero = np.asarray(e.pinv[samples][:, :, -d:]), np.zeros((len(q), model.nv))
    M = np.ascontiguousarray(rigid_tangents(model, q, zero, zero, point.pi)[2].transpose(2, 0, 1))
    values = dict(point.values)
    for effect in scene.mechanism.effects:
        if effect.kind == "rotor_inertia":
            for joint in effect.joints:
                i = scene.mechanism.joint(joint).index
                M[:, i, i] += values.get(f"rotor_inertia.{joint}.Ia", 0.0)
    inertia = L.transpose(0, 2, 1) @ M @ L
    scale = np.trace(inertia, axis1=1, axis2=2)[:, None, None] / d
    inertia += 1e-9 * np.abs(scale) * np.eye(d)  # massless joints follow
    r = np.where(prediction.usable[samples, None], prediction.residual[samples], 0.0)
    return np.linalg.solve(inertia, np.nan_to_num(r)[:, :, None])[:, :, 0], L


def drift(
    predictions: Sequence[Prediction], samples: slice = slice(None), longest: float = LONGEST
) -> tuple[list[np.ndarray], float]:
    """Return positions (n, nq) of each model's ghost over some samples of one experiment, and the
    time [s] from one restart to the next, the same for all of them and at most the `longest`.
    """
    first = predictions[0]
    every = max(1, int(first.scene.e.rate / RATE))
    all_samples = range(*samples.indices(len(first.t)))
    thin = slice(all_samples.start, all_samples.stop, every)
    t, fine = first.t[thin], first.t[samples]
    rates = [deviation_rate(p, thin) for p in predictions]
    q = first.scene.e.q[thin]
    travel = np.ptp(q, axis=0)
    window = longest
    for a, L in rates:
        size = np.percentile(np.abs(np.einsum("nvd,nd->nv", L, a)), PERCENTILE, axis=0)
        moving = (size > 0) & (travel > 0)
        if moving.any():
            window = min(window, float(np.sqrt(2 * SPREAD * (travel / size)[moving]).min()))
    length = max(2, round(window * (len(t) - 1) / float(t[-1] - t[0]))) if len(t) > 1 else 2
    edges = {0, len(t)}
    for segment in runs(first.usable[thin]):
        edges |= {*range(segment.start, segment.stop, length), segment.stop}
    starts = sorted(edges)
    ghosts = []
    for p, (a, L) in zip(predictions, rates, strict=True):
        u = np.zeros_like(a)
        for start, stop in pairwise(starts):
            part = slice(start, stop)
            if stop - start > 1:
                u[part] = _integrated(_integrated(a[part], t[part]), t[part])
        deviation = np.einsum("nvd,nd->nv", L, u)
        nearest = np.minimum(np.searchsorted(t, fine), len(t) - 1)
        ghosts.append(p.scene.e.q[samples] + deviation[nearest])
    return ghosts, window


def _integrated(x: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the integral (n, k) of x (n, k) over t (n,) from its first row on, by trapezoids."""
    areas = 0.5 * (x[1:] + x[:-1]) * np.diff(t)[:, None]
    return np.concatenate([np.zeros_like(x[:1]), np.cumsum(areas, axis=0)])
