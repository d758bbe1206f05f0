"""Coefficients of a time basis eliminated by nested dissection of time: linear in samples.

    [A | L] [p; a] = b,   L banded in time  →   triangles of p alone, and a as a function of p

Knots 0 … S cut time into S intervals; the rows of interval s touch knots s and s + 1. Each interval
is reduced to a small block; then the knots between intervals are eliminated, which makes one
interval of several: log S levels, each one batch of equal Householder reductions. At each step rows
become free of multipliers: they are the equations of p.

Sources: paper, eq. 7-8; G. Golub and R. Plemmons, Linear Algebra Appl. 34, 1980 (orthogonal nested
dissection); Å. Björck, Numerical Methods for Least Squares Problems, 1996, sect. 6.3 (bordered and
block-angular least squares).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ident.errors import FitError
from ident.information import linear
from ident.information.reduction import (
    Blocks,
    Chunk,
    Free,
    compress,
    reflect,
    release,
    unite,
    weak,
)
from ident.information.triangle import Array, Index, Triangle

SMALL = 9  # coefficients that are eliminated together, where the time blocks do not mind
TOLERANCE = 1e-9  # of max|L|: what equations weigh less, they do not determine

Rows = tuple[Array, Array]  # X (n, r, c), Y (n, r, k + 1)


@dataclass(frozen=True, eq=False)
class Freed:
    """Equations of k parameters alone, by the block of time in which they became free."""

    begins: Index  # knots at which a new block begins, ascending
    k: int  # parameters
    factors: Mapping[int, Triangle]  # by number of the block, where there is any
    balance: Index  # (blocks,) equations less unknowns

    @classmethod
    def empty(cls, begins: Sequence[int] | Index, group: int, k: int) -> Freed:
        """Return no equations; blocks begin at these basis functions, `group` of them a knot."""
        knots = -(-np.asarray(begins, dtype=int) // group)
        return cls(knots, k, {}, np.zeros(len(knots) + 1, dtype=int))

    def counting(self, place: Index, equations: int | Index) -> Freed:
        """Count equations that came (or, negative, that a multiplier used up) at places, knots."""
        balance = self.balance.copy()
        np.add.at(balance, self._block(place), equations)
        return replace(self, balance=balance)

    def with_rows(self, free: Iterable[Free]) -> Freed:
        """Absorb rows that touch no multiplier; one update a block, however many batches."""
        parts: dict[int, list[Array]] = {}
        for place, rows in free:
            block = self._block(place)
            for number in np.unique(block).tolist():
                mine = rows[block == number].reshape(-1, rows.shape[-1])
                parts.setdefault(number, []).append(mine)
        factors = dict(self.factors)
        for number, mine in parts.items():
            rows = np.concatenate(mine)
            before = factors.get(number, Triangle.empty(self.k))
            factors[number] = before.updated(rows[:, :-1], rows[:, -1])
        return replace(self, factors=factors)

    def finished(self) -> tuple[Triangle, ...]:
        """Return a triangle a block; one short of equations owes them to the next ones."""
        sums = np.maximum.accumulate(np.maximum(np.cumsum(self.balance), 0))
        rows = np.diff(np.minimum(sums, max(int(self.balance.sum()), 0)), prepend=0)
        none = Triangle.empty(self.k)
        return tuple(
            replace(self.factors.get(number, none), rows=int(n)) for number, n in enumerate(rows)
        )

    def _block(self, place: Index) -> Index:
        return np.searchsorted(self.begins, place, side="right")


@dataclass(frozen=True, eq=False)
class EliminationLevel:
    """Knots eliminated together: R a_inside = d − P p − N [a_left; a_right], R regular.

    In the rows of combinations that no equation weighs, R has the tolerance and the rest is zero.
    """

    left: Index  # (n,) numbers of knots, w = group m coefficients each
    inside: Index  # (n, i)
    right: Index  # (n,)
    X: Array  # (n, i w, (i + 2) w) = [R | N]
    Y: Array  # (n, i w, k + 1) = [P | d]


@dataclass(frozen=True, eq=False)
class Elimination:
    """The equations without the multipliers, and the way back to them."""

    factors: tuple[Triangle, ...]  # of p, one a time block; their `rows` sum to rows − rank
    rows: int  # equations
    rank: int  # multiplier coefficients that they determine
    count: int  # basis functions
    m: int  # multipliers
    group: int  # functions to a knot
    levels: tuple[EliminationLevel, ...]  # in the order of their elimination

    @property
    def border(self) -> Triangle:
        """All equations of p, merged."""
        return Triangle.merge(self.factors)

    def back_substitute(self, x: ArrayLike) -> Array:
        """Return the coefficients a (count, m) [N or N m] that fit best with p = x (k,).

        Combinations that the equations leave open are zero. A redundancy that turns with the
        motion is not quite open, but as good as: then λ is noise along it, Jᵀλ is not, and the part
        J_T⁺ J_T λ is what can be reported.
        """
        homogeneous = np.append(-np.asarray(x, dtype=float), 1.0)
        if len(homogeneous) != self.factors[0].k + 1:
            raise FitError(f"{len(homogeneous) - 1} parameters; valid: {self.factors[0].k}")
        w = self.m * self.group
        a = np.zeros((self.levels[-1].right[-1] + 2, w))  # the last is for knot −1, empty
        for level in reversed(self.levels):
            around = np.concatenate([a[level.left], a[level.right]], axis=1)[..., None]
            c = level.X.shape[1]
            rest = (level.Y @ homogeneous)[..., None] - level.X[..., c:] @ around
            solved = np.linalg.solve(level.X[..., :c], rest)
            a[level.inside] = solved.reshape(*level.inside.shape, w)
        return a.reshape(len(a) * self.group, self.m)[: self.count]


def eliminate(
    chunks: Iterable[Chunk],
    count: int,
    blocks: int | Sequence[int] = 1,
    tol: float = TOLERANCE,
) -> Elimination:
    """Eliminate the multipliers from [A | L] [p; a] = b, given in chunks of the same shapes.

    Args:
        chunks: the equations.
        count: number of basis functions.
        blocks: number of equal time blocks, or the basis functions at which a new one begins.
            Equations of p belong to the block in which they become free of multipliers.
        tol: combinations of a knot's coefficients that the equations weigh less than tol max|L| are
            undetermined (redundant closures, gaps) and set to zero; nothing else depends on it.

    Raises:
        FitError: for no chunks, differing shapes, windows beyond `count`, numbers not finite.
    """
    if not 0 < tol < 1:
        raise FitError(f"tolerance {tol}; valid: above 0, small beside 1")
    if isinstance(blocks, int | np.integer):
        valid, begins = blocks >= 1, np.arange(1, blocks) * count // max(int(blocks), 1)
    else:
        begins = np.asarray(blocks, dtype=int)
        valid = bool((np.diff(begins) >= 0).all())
    if not valid:
        raise FitError(f"blocks {blocks}; valid: a number >= 1, or ascending basis functions")
    compressed: list[Blocks] = []
    shape, rows, scale = None, 0, 0.0
    for chunk in chunks:
        if shape is None:
            shape = width, m, k = chunk.shape
            group = max(width - 1, 1)
            freed = Freed.empty(begins, group, k)
            alone = m > 0 and len(freed.balance) == 1  # nobody asks when rows become free
            by = max(SMALL // (group * m) + 1, 2) if alone else 2  # intervals made one of
            span = by if by > 2 else 1  # that the rows are reduced to at once
        if chunk.shape != shape:
            raise FitError(f"(width, m, k) {chunk.shape} after {shape}; valid: all the same")
        if not len(chunk.b):
            continue
        low, high = chunk.first.min(), chunk.first.max() + width
        if low < 0 or high > count:
            raise FitError(f"windows from {low} to {high - 1}; valid: 0 to {count - 1}")
        scale = max(scale, float(np.abs(chunk.L).max(initial=0.0)))
        reduced, free = compress(chunk, group, tol * scale, span)
        freed = freed.counting(chunk.first // group, 1).with_rows(free)
        compressed.append(reduced)
        rows += len(chunk.b)
    if shape is None or not compressed:
        raise FitError("no equations; valid: at least one chunk with rows")

    tol *= scale or 1.0
    X, Y, free = unite(compressed, (count - width) // (group * span) + 1, tol)
    levels, knots = [], span * np.arange(len(X) + 1)
    if span > 1:
        reduced_too = not np.tril(X, -1).any()  # but where `release` was at work
        around = knots[:-1, None] + np.arange(span + 1)
        level, determined, (X, Y), more = _without_inner(
            around, (X, Y), (X, Y) if reduced_too else reflect(X, Y), tol
        )
        levels.append(level)
        free += more
        freed = freed.counting(level.inside[:, 0], -determined)
    more_levels, _, Y, freed = _closed(knots, X, Y, tol, freed.with_rows(free), by)
    factors = freed.finished()
    rank = rows - sum(factor.rows for factor in factors)
    return Elimination(factors, rows, rank, count, m, group, (*levels, *more_levels))


def _closed(
    knots: Index, X: Array, Y: Array, tol: float, freed: Freed, by: int = 2
) -> tuple[list[EliminationLevel], Array, Array, Freed]:
    """Eliminate all knots, those at the ends too: they lie between the intervals and empty ones."""
    knots = np.concatenate([[knots[0] - 1], knots, [knots[-1] + 1]])
    X, Y = (np.pad(part, [(1, 1), (0, 0), (0, 0)]) for part in (X, Y))
    levels, X, Y, freed = _merged(knots, X, Y, tol, freed, by)
    return levels, X, Y, freed.with_rows([Free(knots[:1] + 1, Y)])  # no multiplier is left


def _merged(
    knots: Index, X: Array, Y: Array, tol: float, freed: Freed, by: int = 2
) -> tuple[list[EliminationLevel], Array, Array, Freed]:
    """Make one interval of all, level by level, `by` neighbours at a time."""
    levels: list[EliminationLevel] = []
    free: list[Free] = []
    while len(X) > 1:
        last = by > 2 and len(X) <= 2 * by + 2
        level, determined, knots, X, Y, more = _halved(knots, X, Y, tol, len(X) if last else by)
        levels.append(level)
        free += more
        freed = freed.counting(level.inside[:, 0], -determined)
    return levels, X, Y, freed.with_rows(free)


def _halved(
    knots: Index, X: Array, Y: Array, tol: float, by: int
) -> tuple[EliminationLevel, Index, Index, Array, Array, list[Free]]:
    """Make one interval of `by`: 0 and 1, 2 and 3, … for 2; what is over stays as it is.

    Returns the level, how many coefficients of each interval's knots are determined, the knots and
    intervals that are left, and the rows that became free.
    """
    n, w = len(X) // by, X.shape[-1] // 2
    each, rest = X[: n * by].reshape(n, by, 2 * w, 2 * w), slice(n * by, None)
    stack = np.zeros((n, by, 2 * w, by + 1, w))  # columns: inside, left, right
    place = [by - 1, *range(by - 1), by]
    for i in range(by):
        stack[:, i, :, place[i]] = each[:, i, :, :w]
        stack[:, i, :, place[i + 1]] = each[:, i, :, w:]
    rows = (
        stack.reshape(n, 2 * w * by, (by + 1) * w),
        Y[: n * by].reshape(n, 2 * w * by, Y.shape[-1]),
    )
    around = knots[by * np.arange(n)[:, None] + np.arange(by + 1)]
    level, determined, ends, freed = _without_inner(around, rows, reflect(*rows), tol)
    knots = np.concatenate([around[:, 0], knots[rest]])
    X, Y = np.concatenate([ends[0], X[rest]]), np.concatenate([ends[1], Y[rest]])
    return level, determined, knots, X, Y, freed


def _without_inner(
    knots: Index, rows: Rows, reduced: Rows, tol: float
) -> tuple[EliminationLevel, Index, Rows, list[Free]]:
    """Eliminate the knots inside of intervals: all of `knots` (n, i + 2) but their ends.

    rows: with the columns of the knots inside, then of left and right; reduced: by `reflect`.
    Returns the level, how many coefficients are determined, the rows of the ends that are left, and
    those that became free.
    """
    (R, rest), n, i = reduced, len(knots), knots.shape[1] - 2
    w = R.shape[-1] // (i + 2)
    c, inside = i * w, knots[:, 1:-1]
    own_X, own_Y = R[:, :c].copy(), rest[:, :c].copy()
    ends_X, ends_Y = R[:, c:, c:].copy(), rest[:, c : c + 2 * w].copy()
    free, determined, freed = rest[:, c + 2 * w :].copy(), np.full(n, c), []
    doubtful = weak(own_X, tol).any(axis=1)
    if doubtful.any():
        X, Y = (part[doubtful] for part in rows)
        own, determined[doubtful], ends, more = _by_singular_values(X, Y, c, tol)
        own_X[doubtful], own_Y[doubtful] = own
        ends_X[doubtful], ends_Y[doubtful] = ends
        free[doubtful] = 0.0
        freed.append(Free(inside[doubtful, 0], more))
    released, more = release(ends_X, ends_Y, tol)
    freed += [Free(inside[:, 0], free), Free(inside[released, 0], more)]
    level = EliminationLevel(knots[:, 0], inside, knots[:, -1], own_X, own_Y)
    return level, determined, (ends_X, ends_Y), freed


def _by_singular_values(X: Array, Y: Array, c: int, tol: float) -> tuple[Rows, Index, Rows, Array]:
    """Eliminate knots of which the equations may leave combinations open, by singular values."""
    ends = X.shape[-1] - c
    U, s, Vt = linear.svd(X[..., :c])
    weighed = (s > tol)[..., None]
    rows = U.swapaxes(1, 2) @ np.concatenate([X[..., c:], Y], axis=2)
    own = np.where(weighed, rows[:, :c], 0.0)
    rows[:, :c] -= own
    own_X = np.concatenate([np.where(weighed, s[..., None], tol) * Vt, own[..., :ends]], axis=2)
    R, rest = reflect(rows[..., :ends], rows[..., ends:])
    return (own_X, own[..., ends:]), weighed.sum(axis=(1, 2)), (R, rest[:, :ends]), rest[:, ends:]
