"""Multipliers eliminated by nested dissection of time: linear in samples, and all in batches.

    [A | L] [p; a] = b,   L banded in time  ->   factors of p alone, and a as a function of p

Knots lambda_0 … lambda_S cut time into S intervals; the rows of interval s touch lambda_s and
lambda_{s+1}. Each interval is reduced to a small triangle; then every other knot is eliminated,
which makes one interval of two, and so on: log2(S) levels, each one batch of equal Householder
reductions. At each step rows become free of multipliers: they are the equations of p. Where nobody
asks in which block of time that is, small knots are eliminated several at once: fewer calls.

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
from ident.solve.halve import Level, halve, inside_out
from ident.solve.intervals import Blocks, Free, Index, compress, unite
from ident.solve.reflect import reflect

SMALL = 9  # coefficients that are eliminated together, where the time blocks do not mind
_SURE = 1e3  # of tol: below this weight a combination has no finite variance


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
        w = self.m * self.group
        a = np.zeros((self.levels[-1].right[-1] + 2, w))  # the last is for knot -1, empty
        for level in reversed(self.levels):
            around = np.concatenate([a[level.left], a[level.right]], axis=1)[..., None]
            c = level.X.shape[1]
            rest = (level.Y @ homogeneous)[..., None] - level.X[..., c:] @ around
            a[level.inside] = np.linalg.solve(level.X[..., :c], rest).reshape(
                *level.inside.shape, w
            )
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
            alone = m > 0 and len(border.factors) == 1
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
        reduced, freed = compress(chunk, group, tol * scale, span)
        border.count(chunk.first // group, 1)
        border.absorb(freed)
        compressed.append(reduced)
        rows += len(chunk.b)
    if border is None or not compressed:
        raise FitError("no equations; valid: at least one chunk with rows")

    tol *= scale or 1.0
    X, Y, freed = unite(compressed, (count - width) // (group * span) + 1, tol)
    knots, levels = np.arange(len(X) + 1) - 1, []  # -1 and the last are the empty ones at the ends
    if span > 1:
        level, determined, knots, X, Y, free = _inside_of_spans(X[1:-1], Y[1:-1], span, tol)
        levels.append(level)
        freed += free
        border.count(level.inside[:, 0], -determined)
    while len(X) > 1 or knots[0] == 0:
        if knots[0] == 0 and len(X) <= 2 * by:  # now the knots at the ends are inner ones, too
            X, Y = (_between_empty(part) for part in (X, Y))
            knots = np.concatenate([[-1], knots, knots[-1:] + 1])
        last = span > 1 and len(X) <= 2 * by + 2
        level, determined, knots, X, Y, free = halve(knots, X, Y, tol, len(X) if last else by)
        levels.append(level)
        freed += free
        border.count(level.inside[:, 0], -determined)
    freed.append(Free(knots[:1], Y))  # between two empty knots: no multiplier is left
    border.absorb(freed)
    factors = border.finished()
    rank = rows - sum(factor.rows for factor in factors)
    return Elimination(factors, rows, rank, count, m, group, _SURE * tol, tuple(levels))


def _between_empty(stack: Array) -> Array:
    whole = np.zeros((len(stack) + 2, *stack.shape[1:]))
    whole[1:-1] = stack
    return whole


def _inside_of_spans(
    X: Array, Y: Array, span: int, tol: float
) -> tuple[Level, Index, Index, Array, Array, list[Free]]:
    """Eliminate the knots inside of the spans to which `compress` has reduced the rows."""
    around = span * np.arange(len(X))[:, None] + np.arange(span + 1)
    triangles = not np.tril(X, -1).any()  # but where `release` was at work
    reduced = (X, Y) if triangles else reflect(X, Y)
    level, determined, kept, freed = inside_out(around, (X, Y), reduced, tol)
    return level, determined, np.append(around[:, 0], around[-1, -1]), *kept, freed
