"""A log's equations in pieces of any split: multipliers eliminated in each, the pieces merged.

    stretch:   X [a_i; a_j] = Y [p; -1]   for the knots i < j at the ends of each part,   R p = d

Inside a stretch no multiplier is left. At its ends there may be, since a neighbour's rows may touch
them: the first and the last interval are kept as they are, what is between them is one part. To
merge two neighbours is to stack the interval that they share, if they do, and to eliminate the
knots that are inside now. Merging is associative, of neighbours in any bracketing (not of pieces
with another one between them, whose knots would be gone), so that the same few lines are

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
from ident.solve.free import Freed
from ident.solve.halve import halve
from ident.solve.intervals import Free, Index, compress, unite
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
        freed: what is free of multipliers already, by block of time.
        shape: width, m and k of the rows; scale: largest |L|.
    """

    parts: tuple[Part, ...]
    freed: Freed
    shape: tuple[int, int, int]
    scale: float

    @classmethod
    def of(cls, chunk: Chunk, begins: Sequence[int] | Index = ()) -> Stretch:
        """The stretch of a chunk of one row or more.

        Args:
            chunk: its rows, which touch any number of intervals.
            begins: basis functions at which a new block of time begins, ascending.

        Raises:
            FitError: for a chunk without rows.
        """
        if not len(chunk.b):
            raise FitError("a chunk without rows; valid: one or more")
        group, scale = max(chunk.shape[0] - 1, 1), float(np.abs(chunk.L).max(initial=0.0))
        interval = chunk.first // group
        begin = int(interval.min())
        count = int(interval.max()) - begin + 1
        reduced, free = compress(chunk, group, TOLERANCE * scale)
        owner = reduced._replace(interval=reduced.interval - begin)
        X, Y, more = unite([owner], count, TOLERANCE * scale)
        parts = [Part(begin + i, begin + i + 1, X[i + 1], Y[i + 1]) for i in range(count)]
        moved = [Free(each.place + begin, each.Y) for each in more]
        freed = Freed.empty(begins, group, chunk.shape[2]).counting(interval, 1)
        return cls(tuple(parts), freed.with_rows([*free, *moved]), chunk.shape, scale)._closed_up()

    def __add__(self, other: Stretch) -> Stretch:
        """Both stretches; they may share one interval of knots, and a gap between them is none.

        Raises:
            FitError: for other rows' shapes, and for stretches that overlap in more than that.
        """
        if self.shape != other.shape:
            raise FitError(f"(width, m, k) {other.shape} after {self.shape}; valid: all the same")
        first, second = sorted((self, other), key=lambda s: s.span)
        scale = max(self.scale, other.scale)
        before, after = [*first.parts], [*second.parts]
        free: list[Free] = []
        if before[-1].right == after[0].right:  # the same interval of knots
            shared, free = _stacked(before.pop(), after.pop(0), TOLERANCE * scale)
            before.append(shared)
        elif before[-1].right < after[0].left:  # knots between them that nothing weighs
            X, Y = np.zeros_like(after[0].X), np.zeros_like(after[0].Y)
            before.append(Part(before[-1].right, after[0].left, X, Y))
        elif before[-1].right > after[0].left:
            raise FitError(
                f"stretches of the knots {first.span} and {second.span}; valid: neighbours, which "
                "share one interval at most"
            )
        freed = (self.freed + other.freed).with_rows(free)
        return Stretch((*before, *after), freed, self.shape, scale)._closed_up()

    @property
    def span(self) -> tuple[int, int]:
        """The first and the last knot."""
        return self.parts[0].left, self.parts[-1].right

    def closed(self) -> tuple[Factor, ...]:
        """The factors of the parameters by block of time, when no neighbour is to come.

        Their rows are what multipliers leave of the equations.
        """
        left, right = self.span
        zero = np.zeros_like(self.parts[0].X), np.zeros_like(self.parts[0].Y)
        ends = Part(left - 1, left, *zero), Part(right, right + 1, *zero)
        last, freed = self._merged([ends[0], *self.parts, ends[1]])
        return freed.with_rows([Free(np.array([left]), last.Y[None])]).finished()

    def _closed_up(self) -> Stretch:
        """The same with everything between the first and the last interval as one part."""
        if len(self.parts) < 4:
            return self
        first, *inner, last = self.parts
        one, freed = self._merged(inner)
        return Stretch((first, one, last), freed, self.shape, self.scale)

    def _merged(self, parts: Sequence[Part]) -> tuple[Part, Freed]:
        """Parts that follow each other as one, every knot between them eliminated, in a tree; and
        all that is free then.
        """
        knots = np.array([parts[0].left, *(part.right for part in parts)])
        X, Y = np.stack([part.X for part in parts]), np.stack([part.Y for part in parts])
        free: list[Free] = []
        freed = self.freed
        while len(X) > 1:
            level, determined, knots, X, Y, more = halve(knots, X, Y, TOLERANCE * self.scale)
            freed = freed.counting(level.inside[:, 0], -determined)
            free += more
        return Part(int(knots[0]), int(knots[-1]), X[0], Y[0]), freed.with_rows(free)


def _stacked(one: Part, other: Part, tol: float) -> tuple[Part, list[Free]]:
    """Two parts between the same knots as one."""
    X, Y = np.concatenate([one.X, other.X])[None], np.concatenate([one.Y, other.Y])[None]
    R, Y = reflect(X, Y)
    c, place = R.shape[-1], np.array([one.left])
    own = Y[:, :c].copy()
    released, rows = release(R, own, tol)
    free = [Free(place, Y[:, c:]), Free(place[released], rows)]
    return Part(one.left, one.right, R[0], own[0]), free
