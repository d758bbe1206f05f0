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
from ident.solve.reflect import reflect, release, weak

_SURE = (
    1e3  # tolerances: a combination of coefficients weighed more than this has a finite variance
)


@dataclass(frozen=True, eq=False)
class Level:
    """Knots eliminated together: R a_mid = d - P p - N [a_left; a_right], R regular.

    left, mid, right: (n,) numbers of knots, w = group m coefficients each.
    X: (n, w, 3 w) = [R | N]; Y: (n, w, k + 1) = [P | d]. In the rows of combinations that no
        equation weighs, R has the tolerance and the rest is zero.
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
    sure: combinations of coefficients that the equations weigh less than this are as good as open.
    levels: in the order of their elimination.
    """

    factors: tuple[Factor, ...]
    rows: int
    rank: int
    count: int
    m: int
    group: int
    sure: float
    levels: tuple[Level, ...]

    @property
    def border(self) -> Factor:
        """All equations of p, merged."""
        return Factor.merge(self.factors)

    def back_substitute(self, x: ArrayLike) -> Array:
        """The coefficients a (count, m) [N or N m] that fit best with the parameters p = x (k,).

        Combinations that the equations leave open are zero. A redundancy that turns with the
        motion is not quite open, but as good as: then lambda is noise along it, J^T lambda is not,
        and J_T^+ J_T lambda, `multipliers_samplewise(J_T, J_T @ lambda)`, is what can be reported.
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
    tol: float = 1e-9,
) -> Elimination:
    """Eliminate the multipliers from [A | L] [p; a] = b, given in chunks of the same shapes.

    count: number of basis functions.
    blocks: number of equal time blocks, or the basis functions at which a new one begins. Equations
        of p belong to the block in which they become free of multipliers.
    tol: combinations of a knot's coefficients that the equations weigh less than tol max|L| are
        undetermined (redundant closures, gaps) and set to zero; nothing else feels it.

    Raises `FitError` for no chunks, differing shapes, windows beyond `count`, numbers not finite.
    """
    if not 0 < tol < 1:
        raise FitError(f"tolerance {tol}; valid: above 0, small beside 1")
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
        reduced, freed = compress(chunk, group, tol * scale)
        border.count(chunk.first // group, 1)
        border.absorb(freed)
        compressed.append(reduced)
        rows += len(chunk.b)
    if border is None or not compressed:
        raise FitError("no equations; valid: at least one chunk with rows")

    tol *= scale or 1.0
    X, Y, freed = unite(compressed, (count - width) // group + 1, tol)
    knots, levels = np.arange(len(X) + 1) - 1, []  # -1 and the last are the empty ones at the ends
    while len(X) > 1:
        level, determined, X, Y, free = _halve(knots, X, Y, tol)
        knots = np.delete(knots, np.s_[1 : 2 * len(level.mid) : 2])
        levels.append(level)
        freed += free
        border.count(level.mid, -determined)
    freed.append(Free(knots[:1], Y))  # between two empty knots: no multiplier is left
    border.absorb(freed)
    factors = border.finished()
    rank = rows - sum(factor.rows for factor in factors)
    return Elimination(factors, rows, rank, count, m, group, _SURE * tol, tuple(levels))


def _halve(
    knots: Index, X: Array, Y: Array, tol: float
) -> tuple[Level, Index, Array, Array, list[Free]]:
    """Eliminate every other knot: intervals 0 and 1 become one, 2 and 3, …; an odd one stays.

    Returns the level, how many of each knot's coefficients are determined, the intervals that are
    left and the rows that became free.
    """
    n, w, k = len(X) // 2, X.shape[-1] // 2, Y.shape[-1]
    left, right = X[0 : 2 * n : 2], X[1 : 2 * n : 2]
    pair = np.zeros((n, 4 * w, 3 * w))  # columns: mid, left, right
    pair[:, : 2 * w, :w], pair[:, : 2 * w, w : 2 * w] = left[..., w:], left[..., :w]
    pair[:, 2 * w :, :w], pair[:, 2 * w :, 2 * w :] = right[..., :w], right[..., w:]
    side = Y[: 2 * n].reshape(n, 4 * w, k)
    mid = knots[1 : 2 * n : 2]

    R, rest = reflect(pair, side)
    own_X, own_Y = R[:, :w].copy(), rest[:, :w].copy()
    kept_X, kept_Y, free = R[:, w:, w:].copy(), rest[:, w : 3 * w].copy(), rest[:, 3 * w :].copy()
    determined, freed = np.full(n, w), []
    doubtful = weak(own_X, tol).any(axis=1)
    if doubtful.any():
        own, determined[doubtful], kept, more = _halve_doubtful(pair[doubtful], side[doubtful], tol)
        own_X[doubtful], own_Y[doubtful] = own
        kept_X[doubtful], kept_Y[doubtful] = kept
        free[doubtful] = 0.0
        freed.append(Free(mid[doubtful], more))
    released, more = release(kept_X, kept_Y, tol)
    freed += [Free(mid, free), Free(mid[released], more)]
    level = Level(knots[0 : 2 * n : 2], mid, knots[2 : 2 * n + 1 : 2], own_X, own_Y)
    X, Y = np.concatenate([kept_X, X[2 * n :]]), np.concatenate([kept_Y, Y[2 * n :]])
    return level, determined, X, Y, freed


def _halve_doubtful(
    pair: Array, side: Array, tol: float
) -> tuple[tuple[Array, Array], Index, tuple[Array, Array], Array]:
    """The same for knots of which the equations may leave combinations open, by singular values."""
    w = pair.shape[-1] // 3
    U, s, Vt = np.linalg.svd(pair[..., :w])
    seen = (s > tol)[..., None]
    rows = U.swapaxes(1, 2) @ np.concatenate([pair[..., w:], side], axis=2)
    own = np.where(seen, rows[:, :w], 0.0)
    rows[:, :w] -= own
    own_X = np.concatenate([np.where(seen, s[..., None], tol) * Vt, own[..., : 2 * w]], axis=2)
    R, rest = reflect(rows[..., : 2 * w], rows[..., 2 * w :])
    return (
        (own_X, own[..., 2 * w :]),
        seen.sum(axis=(1, 2)),
        (R, rest[:, : 2 * w]),
        rest[:, 2 * w :],
    )
