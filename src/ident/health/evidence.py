"""Rows in memory, in which the torque channels stand apart: any exchange of them is a sum.

    X x = known + Σ_{j,i} c_ji Z W_jᵀ τ_i + Σ_{j,l} c_jl Z W_jᵀ τ_j(t + l dt)

c_ji is how much of channel i is taken for the torque of joint j (as logged: 1 for i = j). X are the
model's columns and, at every driven joint, v, sign(v), 1, q and a: friction, offset, spring and
rotor inertia that the model may lack are no fault of the data.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ident.equations.filter import Decimator
from ident.equations.scene import Scene
from ident.equations.terms import terms
from ident.fit import Fit
from ident.motion import Experiment

MOST = 6000  # rows a coordinate; a share that is to be told to 10 % needs no more
CHUNK = 1024  # samples at a time
STICKING = 0.2  # share of a filtered row that may come from samples at standstill
USUAL = 5  # v, sign(v), 1, q, a
LONGEST = 0.1  # s; a longer delay is a wrong clock
NODES = 12  # shifts on either side, from one to two samples up to LONGEST


@dataclass(frozen=True, eq=False)
class Evidence:
    """Rows of all experiments, with J driven joints, d coordinates, k unknowns and L shifts.

    Attributes:
        X: (n, d, k + 5 J); B: (n, d, 1 + J J + J L): known, τ_i at joint j, τ_j shifted.
        informed: (n, d), false at standstill.
        t: (n,) [s]; experiment: (n,) its number.
        lags: (L,) shifts of the torques [s], positive: taken from later.
        dt: step of the clock [s].
    """

    X: np.ndarray
    B: np.ndarray
    informed: np.ndarray
    t: np.ndarray
    experiment: np.ndarray
    lags: np.ndarray
    dt: float


def gather(
    fit: Fit, experiments: Sequence[Experiment] | None = None, most: int = MOST, shifts: bool = True
) -> Evidence:
    """The rows of a fit's motion, or of other experiments of its mechanism.

    Args:
        fit: whose mechanism, columns and filter are taken.
        experiments: default: the fit's own.
        most: rows a coordinate that are kept.
        shifts: whether torques shifted in time are wanted.
    """
    experiments = fit.motion.experiments if experiments is None else experiments
    dt = 1 / experiments[0].rate
    most_steps = min(LONGEST / dt, 0.05 * len(experiments[0]))
    steps = sorted({1, 2, *(max(1, round(i * most_steps / NODES)) for i in range(1, NODES + 1))})
    lags = np.array([*(-k for k in reversed(steps)), *steps] if shifts else [], dtype=int)
    total = sum(int(e.usable.sum()) for e in experiments)
    found: list[tuple[np.ndarray, ...]] = []
    for number, bare in enumerate(experiments):
        cutoff = fit.motion.band.cutoff
        scene = Scene.of(fit.mechanism, fit.columns, bare, fit.point, cutoff)
        e, decimator = scene.e, Decimator.of(cutoff, bare.rate)
        every = max(1, -(-total // decimator.factor // most))
        for inside, sample in _pieces(decimator, e, every):
            X, B, told = _columns(fit, scene, inside, lags)
            if decimator.taps is not None:
                part = slice(int(inside[0]), int(inside[-1]) + 1)
                X, B = (decimator.apply(x, part, sample) for x in (X, B))
                open_ = decimator.apply((~told).astype(float), part, sample, absolute=True)
                told = open_ < STICKING
            found.append((X, B, told, e.t[sample], np.full(len(sample), number)))
    X, B, informed, t, experiment = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return Evidence(X, B, informed, t, experiment, lags * dt, dt)


def _pieces(
    decimator: Decimator, e: Experiment, every: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Samples that are needed, and those whose rows are kept, piece by piece."""
    if decimator.taps is None:
        kept = np.flatnonzero(e.usable)[::every]
        for start in range(0, len(kept), CHUNK):
            yield kept[start : start + CHUNK], kept[start : start + CHUNK]
        return
    for segment in e.segments():
        for inside, part in decimator.pieces(segment, CHUNK):
            sample = decimator.centres(part, segment)
            first = (sample - segment.start - decimator.half) // decimator.factor
            kept = sample[first % every == 0]
            if len(kept):
                yield np.arange(inside.start, inside.stop), kept


def _columns(
    fit: Fit, scene: Scene, part: np.ndarray, lags: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """X, B and informed of some samples, unfiltered."""
    e, s = scene.e, scene.samples(part)
    driven, (n, d) = fit.mechanism.driven, s.shape
    found = terms(scene, part)
    k, J, L = len(fit.columns), len(driven), len(lags)
    X = np.zeros((n, d, k + USUAL * J))
    X[:, :, :k] = found.A
    held = fit.estimate.held
    known = found.b - found.tau - found.A[:, :, held] @ fit.estimate.solution.x[held]
    X[:, :, :k][:, :, held] = 0.0
    B = np.zeros((n, d, 1 + J * J + J * L))
    B[:, :, 0] = known
    informed = np.ones((n, d), dtype=bool)
    for _, told in found.told:
        informed &= told[:, None] | (e.leverage is None)
    tau = e.tau[part]
    for j, name in enumerate(driven):
        rows, W = s.lever(name)
        x = s.signals((name,))
        q, v, a = x.q[:, 0], x.v[:, 0], x.a[:, 0]
        usual = np.stack([v, np.clip(v / x.still, -1, 1), np.ones(n), q, a], axis=-1)
        W = W[:, :, None]
        X[:, rows, k + USUAL * j : k + USUAL * (j + 1)] = W * usual[:, None]
        B[:, rows, 1 + J * j : 1 + J * (j + 1)] = W * tau[:, None]
        shifted = e.tau[np.clip(part[:, None] + lags, 0, len(e) - 1), j]
        B[:, rows, 1 + J * J + L * j : 1 + J * J + L * (j + 1)] = W * shifted[:, None]
        informed[:, rows] &= (np.abs(v) >= x.still)[:, None]
    return X, B, informed
