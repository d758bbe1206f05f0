"""A log's equations in pieces of any split: multipliers eliminated in each, the pieces merged.

    stretch:   X [a_i; a_j] = Y [p; -1]   for the knots i < j at the ends of each part,   R p = d

Inside a stretch no multiplier is left. At its ends there may be, since a neighbour's rows may touch
them: the first and the last interval are kept as they are, what is between them is one part. To
merge two neighbours is to stack the interval that they share, if they do, and to eliminate the
knots that are inside now. Merging is associative, so that the same few lines are

    batch        ((s₁ + s₂) + (s₃ + s₄))         a tree, which `eliminate` makes level by level
    recursive    (((s₁ + s₂) + s₃) + s₄)         each s a sample: constant memory
    distributed  whoever made which s            stretches are small and know no neighbour

Source: orthogonal nested dissection (G. Golub and R. Plemmons, Linear Algebra Appl. 34, 1980) on a
line, where it is sequential block QR from one end and a tree from the middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ident.errors import FitError
from ident.solve.chunk import Chunk
from ident.solve.factor import Array, Factor
from ident.solve.halve import halve
from ident.solve.intervals import Free, compress, unite
from ident.solve.reflect import reflect, release

TOLERANCE = 1e-9  # of max|L|: what equations weigh less, they do not determine


class Part(NamedTuple):
    """Rows between two knots, X (2 w, 2 w), Y (2 w, k + 1), w coefficients a knot."""

    left: int
    right: int
    X: Array
    Y: Array


@dataclass(frozen=True, eq=False)
class Stretch:
    """The equations of some samples that follow each other, free of all multipliers but the ends'.

    Attributes:
        parts: one interval, or the first, what is between, and the last.
        factor: what is free of multipliers already, in k parameters.
        rows: equations absorbed; determined: multipliers' coefficients eliminated.
        shape: width, m and k of the rows; scale: largest |L|.
    """

    parts: tuple[Part, ...]
    factor: Factor
    rows: int
    determined: int
    shape: tuple[int, int, int]
    scale: float

    @classmethod
    def of(cls, chunk: Chunk) -> Stretch:
        """The stretch of a chunk of one row or more.

        Raises:
            FitError: for a chunk without rows.
        """
        if not len(chunk.b):
            raise FitError("a chunk without rows; valid: one or more")
        group, scale = max(chunk.shape[0] - 1, 1), float(np.abs(chunk.L).max(initial=0.0))
        begin = int(chunk.first.min()) // group
        count = int(chunk.first.max()) // group - begin + 1
        reduced, freed = compress(chunk, group, TOLERANCE * scale)
        owner = reduced._replace(interval=reduced.interval - begin)
        X, Y, more = unite([owner], count, TOLERANCE * scale)
        parts = [Part(begin + i, begin + i + 1, X[i + 1], Y[i + 1]) for i in range(count)]
        factor = absorbed(Factor.empty(chunk.shape[2]), [*freed, *more])
        whole = cls(tuple(parts), factor, len(chunk.b), 0, chunk.shape, scale)
        return whole._inside_eliminated()

    def __add__(self, other: Stretch) -> Stretch:
        """Both stretches; they may share one interval of knots, and a gap between them is none.

        Raises:
            FitError: for other rows' shapes, and for stretches that overlap in more than that.
        """
        if self.shape != other.shape:
            raise FitError(f"(width, m, k) {other.shape} after {self.shape}; valid: all the same")
        first, second = sorted((self, other), key=lambda s: (s.parts[0].left, s.parts[-1].right))
        scale = max(self.scale, other.scale)
        factor = Factor.merge([self.factor, other.factor])
        before, after = [*first.parts], [*second.parts]
        freed: list[Free] = []
        if before[-1].right == after[0].right:  # the same interval of knots
            shared, freed = _stacked(before.pop(), after.pop(0), TOLERANCE * scale)
            before.append(shared)
        elif before[-1].right < after[0].left:  # knots between them that nothing weighs
            X, Y = np.zeros_like(after[0].X), np.zeros_like(after[0].Y)
            before.append(Part(before[-1].right, after[0].left, X, Y))
        elif before[-1].right > after[0].left:
            raise FitError(
                f"stretches of the knots {first.span} and {second.span}; valid: neighbours, which "
                "share one interval at most"
            )
        whole = Stretch(
            tuple(before + after),
            absorbed(factor, freed),
            self.rows + other.rows,
            self.determined + other.determined,
            self.shape,
            scale,
        )
        return whole._inside_eliminated()

    @property
    def span(self) -> tuple[int, int]:
        """The first and the last knot."""
        return self.parts[0].left, self.parts[-1].right

    def closed(self) -> Factor:
        """The factor of the parameters when no neighbour is to come; its rows are what is left."""
        w, k = len(self.parts[0].X) // 2, self.factor.k
        left, right = self.span
        X, Y = np.zeros((2 * w, 2 * w)), np.zeros((2 * w, k + 1))
        ends = Part(left - 1, left, X, Y), Part(right, right + 1, X, Y)
        last, determined, freed = _merged([ends[0], *self.parts, ends[1]], TOLERANCE * self.scale)
        factor = absorbed(self.factor, [*freed, Free(np.zeros(1, int), last.Y[None])])
        left_over = max(self.rows - self.determined - determined, 0)
        return Factor(factor.R, factor.d, factor.rho, left_over)

    def latest(self) -> tuple[int, Array, Array]:
        """What all equations so far say of the last interval: R [a_i; a_j] = d - P p.

        Returns the first basis function of knot i, R (2 w, 2 w), which may be singular, and
        Y = [P | d] (2 w, k + 1). A filtered estimate: later samples will still change it.
        """
        *before, last = self.parts
        if before:
            zero = np.zeros_like(last.X), np.zeros_like(last.Y)
            start = Part(before[0].left - 1, before[0].left, *zero)
            past, _, _ = _merged([start, *before], TOLERANCE * self.scale)
            w = len(past.X) // 2
            onto = np.concatenate([past.X[:, w:], np.zeros((2 * w, w))], axis=1)  # knot i alone
            shifted = Part(last.left, last.right, onto, past.Y)
            last, _ = _stacked(shifted, last, TOLERANCE * self.scale)
        return last.left * max(self.shape[0] - 1, 1), last.X, last.Y

    def _inside_eliminated(self) -> Stretch:
        """The same with everything between the first and the last interval as one part."""
        if len(self.parts) < 4:
            return self
        first, *inner, last = self.parts
        one, determined, freed = _merged(inner, TOLERANCE * self.scale)
        return Stretch(
            (first, one, last),
            absorbed(self.factor, freed),
            self.rows,
            self.determined + determined,
            self.shape,
            self.scale,
        )


def absorbed(factor: Factor, freed: Sequence[Free]) -> Factor:
    """The factor with rows that touch no multiplier any more."""
    rows = [free.Y.reshape(-1, free.Y.shape[-1]) for free in freed if free.Y.size]
    if not rows:
        return factor
    stack = np.concatenate(rows)
    return factor.updated(stack[:, :-1], stack[:, -1])


def _stacked(one: Part, other: Part, tol: float) -> tuple[Part, list[Free]]:
    """Two parts between the same knots as one."""
    X, Y = np.concatenate([one.X, other.X])[None], np.concatenate([one.Y, other.Y])[None]
    R, Y = reflect(X, Y)
    c, place = R.shape[-1], np.array([one.left])
    own = Y[:, :c].copy()
    released, rows = release(R, own, tol)
    free = [Free(place, Y[:, c:]), Free(place[released], rows)]
    return Part(one.left, one.right, R[0], own[0]), free


def _merged(parts: Sequence[Part], tol: float) -> tuple[Part, int, list[Free]]:
    """Parts that follow each other as one: every knot between them eliminated, in a tree."""
    knots = np.array([parts[0].left, *(part.right for part in parts)])
    X, Y = np.stack([part.X for part in parts]), np.stack([part.Y for part in parts])
    freed: list[Free] = []
    determined = 0
    while len(X) > 1:
        level, each, X, Y, free = halve(knots, X, Y, tol)
        knots = np.delete(knots, np.s_[1 : 2 * len(level.mid) : 2])
        determined += int(each.sum())
        freed += free
    return Part(int(knots[0]), int(knots[-1]), X[0], Y[0]), determined, freed
