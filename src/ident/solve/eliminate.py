"""Multipliers eliminated by nested dissection of time: linear in samples, and all in batches.

    [A | L] [p; a] = b,   L banded in time  ->   factors of p alone, and a as a function of p

Knots lambda_0 … lambda_S cut time into S intervals; the rows of interval s touch lambda_s and
lambda_{s+1}. Each interval is reduced to a small triangle; then every other knot is eliminated,
which makes one interval of two, and so on: log2(S) levels, each one batch of equal Householder
reductions. At each step rows become free of multipliers: they are the equations of p.

Sources: paper, eq. 7-8; G. Golub and R. Plemmons, Linear Algebra Appl. 34, 1980 (orthogonal nested
dissection); Å. Björck, Numerical Methods for Least Squares Problems, 1996, sect. 6.3 (bordered and
block-angular least squares).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ident.errors import FitError
from ident.solve.border import Border
from ident.solve.chunk import Chunk
from ident.solve.factor import Array, Factor
from ident.solve.intervals import Blocks, Free, Index, compress, unite
from ident.solve.reflect import reflect

_SEEN = 100.0  # a pivot this many times the damping comes from data


@dataclass(frozen=True, eq=False)
class Level:
    """Knots eliminated together: R a_mid = d - P p - N [a_left; a_right].

    left, mid, right: (n,) numbers of knots, w = group m coefficients each.
    X: (n, w, 3 w) = [R | N]; Y: (n, w, k + 1) = [P | d].
    """

    left: Index
    mid: Index
    right: Index
    X: Array
    Y: Array


@dataclass(frozen=True, eq=False)
class Elimination:
    """What is left of the equations once the multipliers are gone, and the way back to them.

    factors: the equations of p, one `Factor` a time block; their `rows` are what the multipliers
        leave of the equations, and sum to rows - rank.
    rows: number of equations; rank: number of multiplier coefficients that they determine.
    count, m: basis functions and multipliers; group: functions to a knot.
    seen: a combination of coefficients that the equations weigh less than this is undetermined.
    levels: in the order of their elimination.
    """

    factors: tuple[Factor, ...]
    rows: int
    rank: int
    count: int
    m: int
    group: int
    seen: float
    levels: tuple[Level, ...]

    @property
    def border(self) -> Factor:
        """All equations of p, merged."""
        return Factor.merge(self.factors)

    def back_substitute(self, x: ArrayLike) -> Array:
        """The coefficients a (count, m) [N or N m] that fit best with the parameters p = x (k,).

        Undetermined combinations of them come out as zero.
        """
        homogeneous = np.append(-np.asarray(x, dtype=float), 1.0)
        if len(homogeneous) != self.factors[0].k + 1:
            raise FitError(f"{len(homogeneous) - 1} parameters; valid: {self.factors[0].k}")
        w = self.levels[0].X.shape[1]
        a = np.zeros((self.levels[-1].right[-1] + 2, w))  # the last is for knot -1, empty
        for level in reversed(self.levels):
            around = np.concatenate([a[level.left], a[level.right]], axis=1)[..., None]
            rest = (level.Y @ homogeneous)[..., None] - level.X[..., w:] @ around
            a[level.mid] = np.linalg.solve(level.X[..., :w], rest)[..., 0]
        return a.reshape(len(a) * self.group, self.m)[: self.count]

    def __repr__(self) -> str:
        return (
            f"Elimination({self.rows} equations, {self.rank} of {self.count * self.m} multiplier "
            f"coefficients determined, {len(self.factors)} time blocks)"
        )


def eliminate(
    chunks: Iterable[Chunk],
    count: int,
    blocks: int | Sequence[int] = 1,
    damping: float = 1e-9,
) -> Elimination:
    """Eliminate the multipliers from [A | L] [p; a] = b, given in chunks of the same shapes.

    count: number of basis functions.
    blocks: number of equal time blocks, or the basis functions at which a new one begins. Equations
        of p belong to the block in which they become free of multipliers.
    damping: every coefficient gets an equation damping max|L| a = 0. It gives those that the data
        leave open (redundant closures, gaps) the least norm; others feel it by (damping max|L| /
        their singular value)², 1e-18 and up.

    Raises `FitError` for no chunks, differing shapes, windows beyond `count`, numbers not finite.
    """
    if not 0 < damping < 1e-4:
        raise FitError(f"damping {damping}; valid: above 0, small beside 1")
    compressed: list[Blocks] = []
    border, rows, scale = None, 0, 0.0
    for chunk in chunks:
        if border is None:
            shape = width, m, k = chunk.shape
            group = max(width - 1, 1)
            border = Border(blocks, count, group, k)
        if chunk.shape != shape:
            raise FitError(f"(width, m, k) {chunk.shape} after {shape}; valid: all the same")
        if not len(chunk.b):
            continue
        low, high = chunk.first.min(), chunk.first.max() + width
        if low < 0 or high > count:
            raise FitError(f"windows from {low} to {high - 1}; valid: 0 to {count - 1}")
        scale = max(scale, float(np.abs(chunk.L).max(initial=0.0)))
        reduced, free = compress(chunk, group)
        border.count(chunk.first // group, 1)
        border.absorb([free])
        compressed.append(reduced)
        rows += len(chunk.b)
    if border is None or not compressed:
        raise FitError("no equations; valid: at least one chunk with rows")

    X, Y, freed = unite(compressed, (count - width) // group + 1)
    knots = np.arange(len(X) + 1) - 1  # of the two empty intervals at the ends: -1 and the last
    floor, levels, rank = damping * (scale or 1.0), [], 0
    while len(X) > 1:
        level, X, Y, free = _halve(knots, X, Y, floor)
        knots = np.delete(knots, np.s_[1 : 2 * len(level.mid) : 2])
        pivots = np.abs(level.X.diagonal(axis1=1, axis2=2)) > _SEEN * floor
        levels.append(level)
        freed.append(free)
        border.count(level.mid, -pivots.sum(axis=1))
        rank += int(pivots.sum())
    freed.append(Free(knots[:1], Y))  # between two empty knots: no multiplier is left
    border.absorb(freed)
    return Elimination(border.finished(), rows, rank, count, m, group, _SEEN * floor, tuple(levels))


def _halve(knots: Index, X: Array, Y: Array, floor: float) -> tuple[Level, Array, Array, Free]:
    """Eliminate every other knot: intervals 0 and 1 become one, 2 and 3, … ; an odd one stays."""
    n, w = len(X) // 2, X.shape[-1] // 2
    k = Y.shape[-1]
    left, right = X[0 : 2 * n : 2], X[1 : 2 * n : 2]
    pair = np.zeros((n, 5 * w, 3 * w))  # columns: mid, left, right
    pair[:, : 2 * w, :w], pair[:, : 2 * w, w : 2 * w] = left[..., w:], left[..., :w]
    pair[:, 2 * w : 4 * w, :w], pair[:, 2 * w : 4 * w, 2 * w :] = right[..., :w], right[..., w:]
    pair[:, 4 * w :, :w] = floor * np.eye(w)
    side = np.zeros((n, 5 * w, k))
    side[:, : 4 * w] = Y[: 2 * n].reshape(n, 4 * w, k)
    R, side = reflect(pair, side, _SEEN * floor)
    level = Level(
        knots[0 : 2 * n : 2],
        knots[1 : 2 * n : 2],
        knots[2 : 2 * n + 1 : 2],
        R[:, :w].copy(),
        side[:, :w].copy(),
    )
    X = np.concatenate([R[:, w:, w:], X[2 * n :]])
    Y = np.concatenate([side[:, w : 3 * w], Y[2 * n :]])
    return level, X, Y, Free(level.mid, side[:, 3 * w :].copy())
