"""Which signals a residual depends on: smooth maps, held out in stretches of time.

    R² = 1 − Σ_folds ‖r − Φ ĉ₋fold‖² / Σ_folds ‖r − r̄₋fold‖²        ĉ by ridge least squares

Signals are chosen one after the other (greedy, forward), so that one that only copies another earns
nothing; each must beat what it would earn on noise with the spectrum of what is left. All of it
comes from ΦᵀΦ and Φᵀr of the folds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ident.residual.noise import surrogates
from ident.residual.signals import Candidate

LEAST = 0.03  # R² that is worth a mention, of what the signals before it leave
GAIN = 0.02  # and of the whole
SURE = 0.6  # R² that is always believed, however short the log
SIMPLER = 0.02  # R² that is given up for the simpler map, or for the joint's own signal
DRAWS = 60  # surrogates of noise
LONGEST = 4  # signals of one joint


@dataclass(frozen=True, eq=False)
class Step:
    """One signal that was chosen: its map's values (c,), and R² without and with it."""

    candidate: Candidate
    values: np.ndarray
    before: float
    after: float


@dataclass(frozen=True, eq=False)
class Found:
    """The signals of one joint's residual.

    Attributes:
        steps: the most important first.
        best: R² of the best signal that was left out, of what is left.
        threshold: R² that it would have needed, the largest that surrogates of noise have.
    """

    steps: tuple[Step, ...]
    best: float
    threshold: float


class _Sums:
    """ΦᵀΦ (F, c, c), Φᵀr (F, c, m) and rᵀr (F, m) of the folds, for m series r at a time."""

    def __init__(self, candidates: Sequence[Candidate], fold: np.ndarray) -> None:
        width = [1, *(each.columns.shape[1] for each in candidates)]
        edges = np.cumsum([0, *width])
        self.places = [np.arange(a, b) for a, b in pairwise(edges)]
        ones = np.ones((len(fold), 1))
        self.Phi = np.hstack([ones, *(each.columns for each in candidates)])
        cuts = np.flatnonzero(np.diff(fold)) + 1
        self.parts = np.split(np.arange(len(fold)), cuts)
        self.gram = np.stack([self.Phi[part].T @ self.Phi[part] for part in self.parts])
        self.penalty = np.zeros(self.gram.shape[1:])
        for each, place in zip(candidates, self.places[1:], strict=True):
            self.penalty[np.ix_(place, place)] = each.penalty(len(fold))

    def moments(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Φᵀr (F, c, m) and rᵀr (F, m) of series r (n, m)."""
        cross = np.stack([self.Phi[part].T @ r[part] for part in self.parts])
        return cross, np.stack([(r[part] ** 2).sum(axis=0) for part in self.parts])

    def solve(self, chosen: Sequence[int], cross: np.ndarray) -> np.ndarray:
        """Values (c,) of the maps that are chosen, from all folds."""
        at = np.concatenate([self.places[0], *(self.places[i + 1] for i in chosen)])
        A = self.gram.sum(axis=0)[np.ix_(at, at)] + self.penalty[np.ix_(at, at)]
        return np.asarray(np.linalg.solve(A, cross.sum(axis=0)[at]))

    def held_out(self, chosen: Sequence[int], cross: np.ndarray, square: np.ndarray) -> np.ndarray:
        """Σ_folds ‖r − Φ ĉ₋fold‖² (m,)."""
        at = np.concatenate([self.places[0], *(self.places[i + 1] for i in chosen)])
        G, b = self.gram[:, at[:, None], at], cross[:, at]
        A = G.sum(axis=0) - G + self.penalty[np.ix_(at, at)]
        c = np.linalg.solve(A, b.sum(axis=0) - b)
        return np.asarray(
            (square - 2 * (c * b).sum(axis=1) + (c * (G @ c)).sum(axis=1)).sum(axis=0)
        )


def depends_on(
    r: np.ndarray, fold: np.ndarray, candidates: Sequence[Candidate], runs: Sequence[slice]
) -> Found:
    """The signals that explain a joint's residual, out of those in `candidates`.

    Args:
        r: (n,) the residual; fold: (n,) consecutive rows of one number are one stretch of time.
        candidates: in order of preference where they explain alike.
        runs: of rows without a gap.
    """
    scale = float(np.sqrt(np.mean(r**2)))
    if len(r) < 20 or scale == 0:
        return Found((), 0.0, 1.0)
    r = r / scale
    sums = _Sums(candidates, fold)
    cross, square = sums.moments(r[:, None])
    total = float(sums.held_out([], cross, square)[0])
    if not total > 0:  # one stretch of time alone, of which nothing can be held out
        return Found((), 0.0, 1.0)
    chosen: list[int] = []
    steps: list[Step] = []
    now = total
    while True:
        left = r
        if chosen:
            at = np.concatenate([sums.places[0], *(sums.places[i + 1] for i in chosen)])
            left = r - sums.Phi[:, at] @ sums.solve(chosen, cross)[:, 0]
        noise = surrogates([left[run] for run in runs], DRAWS, seed=len(chosen))
        noise_cross, noise_square = sums.moments(noise)
        nothing = sums.held_out(chosen, noise_cross, noise_square)
        rest = [i for i in range(len(candidates)) if i not in chosen]
        after = {i: float(sums.held_out([*chosen, i], cross, square)[0]) for i in rest}
        after = {i: left for i, left in after.items() if np.isfinite(left)}
        if not after:
            return Found(tuple(steps), 0.0, 1.0)
        chance = max(
            float((1 - sums.held_out([*chosen, i], noise_cross, noise_square) / nothing).max())
            for i in rest
        )
        threshold = float(np.clip(chance, LEAST, SURE))
        least = min(after.values())
        pick = _simplest(candidates, after, least + SIMPLER * now)
        share = 1 - least / now
        enough = share > threshold and now - after[pick] > GAIN * total
        if not enough or len(chosen) == LONGEST:
            return Found(tuple(steps), share, threshold)
        chosen.append(pick)
        values = sums.solve(chosen, cross)[:, 0][-len(sums.places[pick + 1]) :]
        steps.append(
            Step(candidates[pick], scale * values, 1 - now / total, 1 - after[pick] / total)
        )
        now = after[pick]


def _simplest(candidates: Sequence[Candidate], after: dict[int, float], enough: float) -> int:
    """The map of fewest columns, then the first, of those that leave no more than `enough`."""
    near = [i for i, left in after.items() if left <= enough]
    return min(near, key=lambda i: (candidates[i].columns.shape[1], i))
