"""Time bases, lambda_i(t) = sum_j b_j(t) a_ij on equally spaced knots, and their elimination.

Degree 1 are the hat functions of the paper (eq. 4-5): a_ij is lambda_i at knot j. Degrees 3 and 5
are uniform B-splines (C. de Boor, A Practical Guide to Splines, 1978, ch. IX-X). Their ends are
open simply because functions reach over them: no knot is repeated, all intervals are alike.

Coefficients are eliminated knot by knot, in a time that is linear in samples:

    [A | L] [p; a] = b,   L banded in time  →   triangles of p alone, and a as a function of p

Basis functions are grouped into knots, wide enough for a row to touch two neighbouring knots only:
the band becomes block-bidiagonal whatever the degree or the filter. Knots are eliminated one after
the other: an orthogonal reduction of the rows that touch a knot gives the rows that determine it,
the rows that are carried to the next knot, and rows that are free of multipliers: equations of p.

A direction of the unknowns that no equation weighs (a redundant closure, a gap) shows up as
rounding, 1e-16 instead of 0. Its row must not be used: it takes the residual of the equations
along and hands it back 1e16 times larger; damping by 1e-9 would not help, 1e-16 / 1e-18 is as bad.
So weak pivots are looked at more closely, by singular values.

Sources: paper, eq. 7-8; Å. Björck, Numerical Methods for Least Squares Problems, 1996, sect. 6.2
(banded problems) and 6.3 (bordered and block-angular least squares).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ident.errors import FitError
from ident.information import linear
from ident.information.linear import Array, Index, Triangle

_ROUND = 1e-9  # numerics: of a spacing: times this far outside the span are rounding


@dataclass(frozen=True)
class Basis:
    """`count` uniform B-splines of `degree` on the span [t0, t0 + (count - degree) spacing].

    degree: 0 constant, 1 hat functions, 3 cubic, 5 quintic: any number >= 0.
    t0: [s] where the span begins; spacing: [s] between knots; count: number of functions.
    Function j is nonzero from t0 + (j - degree) spacing over degree + 1 spacings.
    """

    degree: int
    t0: float
    spacing: float
    count: int

    @classmethod
    def spanning(cls, t_start: float, t_end: float, spacing: float, degree: int = 1) -> Basis:
        """Knots every `spacing` [s] from `t_start`; the last one is at `t_end` or just past it."""
        intervals = max(1, int(np.ceil((t_end - t_start) / spacing - _ROUND)))
        return cls(degree, float(t_start), float(spacing), intervals + degree)

    @classmethod
    def with_count(cls, t_start: float, t_end: float, count: int, degree: int = 1) -> Basis:
        """Exactly `count` functions on [t_start, t_end] [s]; the spacing follows."""
        return cls(degree, float(t_start), float(t_end - t_start) / (count - degree), count)

    @property
    def t_end(self) -> float:
        """Where the span ends [s]."""
        return self.t0 + (self.count - self.degree) * self.spacing

    def window(self, t: ArrayLike, order: int = 0) -> tuple[NDArray[np.intp], Array]:
        """The functions that are nonzero at times `t` (n,) [s], or their derivatives of an order.

        Returns first (n,) and values (n, degree + 1), b_{first + r}(t) = values[:, r], of sum 1
        (order 0) or 0.
        Raises `FitError` for a time outside the span.
        """
        t = np.asarray(t, dtype=float)
        position = (t - self.t0) / self.spacing
        intervals = self.count - self.degree
        if not ((position >= -_ROUND) & (position <= intervals + _ROUND)).all():
            raise FitError(
                f"times from {np.min(t)} to {np.max(t)} s; valid: {self.t0} to {self.t_end} s"
            )
        first = np.clip(np.floor(position).astype(np.intp), 0, intervals - 1)
        u = position - first
        # de Boor's recursion on unit knots: b_r^p = ((p-r+u) b_{r-1}^{p-1} + (1-u+r) b_r^{p-1}) / p
        values = np.ones((1, len(u)))  # a function's values at all times stand together
        for p in range(1, self.degree - order + 1):
            r, edge = np.arange(p)[:, None], np.zeros((p + 1, len(u)))
            edge[1:] += (p - 1 - r + u) * values
            edge[:-1] += (1 - u + r) * values
            values = edge / p
        for _ in range(order):  # d/dt b_r^p = (b_{r-1}^{p-1} − b_r^{p-1}) / spacing
            values = np.diff(values, axis=0, prepend=0.0, append=0.0) / -self.spacing
        return first, values.T

    def evaluate(self, a: ArrayLike, t: ArrayLike) -> Array:
        """lambda(t) = B(t) a, (n, m), of coefficients a (count, m) at times t (n,) [s] (eq. 6)."""
        a = np.asarray(a, dtype=float)
        first, values = self.window(t)
        lam = np.zeros((len(first), a.shape[1]))
        for r in range(self.degree + 1):
            lam += values[:, [r]] * a[first + r]
        return lam


TOLERANCE = 1e-9  # numerics: of max|L|: what equations weigh less, they do not determine
CLOSE = 1e3  # numerics: a pivot above this many tolerances hides no singular value below one


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some rows of [A | L] [p; a] = b (paper, eq. 8), in any order, each on a short window of L.

        A p + Σ_w L[:, w] a[first + w] = b

    The width of the window is the basis' degree + 1, or more where rows were filtered in time.
    """

    first: Index  # (r,) the first basis function that a row touches
    L: Array  # (r, width, m) for functions first … first + width − 1, m multipliers each
    A: Array  # (r, k)
    b: Array  # (r,)


@dataclass(frozen=True, eq=False)
class Elimination:
    """The equations without the multipliers, and the way back to them."""

    factors: tuple[Triangle, ...]  # of p, one a time block; their `rows` sum to rows − rank
    rows: int  # equations
    rank: int  # multiplier coefficients that they determine
    count: int  # basis functions
    m: int  # multipliers
    # by knot, rows (r, 2 w + k + 1) that determine its w coefficients: of them, the next knot, p, b
    knots: tuple[Array, ...]
    w: int

    def back_substitute(self, x: ArrayLike) -> Array:
        """Return the coefficients a (count, m) [N or N m] that fit best with p = x (k,).

        Combinations that the equations leave open are zero. A redundancy that turns with the
        motion is not quite open, but as good as: then λ is noise along it, Jᵀλ is not, and the part
        J_T⁺ J_T λ is what can be reported.
        """
        homogeneous, w = np.append(-np.asarray(x, dtype=float), 1.0), self.w
        a = np.zeros((len(self.knots) + 1, w))
        for i, rows in reversed([*enumerate(self.knots)]):
            rest = rows[:, 2 * w :] @ homogeneous - rows[:, w : 2 * w] @ a[i + 1]
            if len(rows) == w:
                a[i] = np.linalg.solve(rows[:, :w], rest)
            elif len(rows):
                a[i] = linear.lstsq(rows[:, :w], rest)[0]
        return a.reshape(-1, self.m)[: self.count] if w else np.zeros((self.count, 0))


def eliminate(chunks: Iterable[Chunk], count: int, blocks: int = 1) -> Elimination:
    """Eliminate the multipliers from [A | L] [p; a] = b, given in chunks of the same shapes.

    Combinations of a knot's coefficients that the equations weigh less than TOLERANCE max|L| are
    undetermined (redundant closures, gaps) and set to zero; nothing else depends on it. `count`
    basis functions; equations of p belong to that of `blocks` equal blocks of time in which they
    become free of multipliers.

    Raises:
        FitError: for no equations, or a number that is not finite.
    """
    begins = np.arange(1, blocks) * count // blocks
    chunks = [chunk for chunk in chunks if len(chunk.b)]
    if not chunks:
        raise FitError("no equations; valid: at least one chunk with rows")
    (_, width, m), k = chunks[0].L.shape, chunks[0].A.shape[1]
    tol = TOLERANCE * (max(float(np.abs(c.L).max(initial=0.0)) for c in chunks) or 1.0)
    group = max(width - 1, 1)
    w, carried, knots = group * m, np.zeros((0, group * m + k + 1)), []
    block = np.searchsorted(-(-begins // group), np.arange(count // group + 2), side="right")
    free: list[list[Array]] = [[] for _ in range(len(begins) + 1)]
    balance = np.zeros(len(free), dtype=int)  # equations less unknowns
    for number, rows in enumerate(_intervals(chunks, group, (count - width) // group + 1)):
        balance[block[number]] += len(rows)
        before = np.hstack([carried[:, :w], np.zeros((len(carried), w)), carried[:, w:]])
        solved, rest = _parted(np.concatenate([before, rows]), w, tol)
        carried, done = _parted(rest[:, w:], w, tol)
        knots.append(solved)
        balance[block[number]] -= len(solved)
        free[block[number]].append(done[:, w:])
    sums = np.maximum.accumulate(np.maximum(np.cumsum(balance), 0))
    # a block that is short of equations owes them to the next ones
    shares = np.diff(np.minimum(sums, max(int(balance.sum()), 0)), prepend=0)
    factors = []
    for parts, n in zip(free, shares, strict=True):
        rows = np.concatenate([np.zeros((0, k + 1)), *parts])
        factors.append(replace(Triangle.of(rows[:, :-1], rows[:, -1]), rows=int(n)))
    total = sum(len(chunk.b) for chunk in chunks)
    return Elimination(tuple(factors), total, total - int(shares.sum()), count, m, tuple(knots), w)


def _intervals(chunks: Sequence[Chunk], group: int, intervals: int) -> Iterator[Array]:
    """Yield rows (r, 2 w + k + 1) of every interval, on its two knots, p and b; at last none."""
    (_, width, m), k = chunks[0].L.shape, chunks[0].A.shape[1]
    number = [chunk.first // group for chunk in chunks]
    order = [np.argsort(number_of, kind="stable") for number_of in number]
    ends = [
        np.searchsorted(number_of[at], np.arange(intervals + 1))
        for number_of, at in zip(number, order, strict=True)
    ]
    starts = np.array(ends)
    for i in range(intervals):
        parts = [np.zeros((0, 2 * group * m + k + 1))]
        for c in np.flatnonzero(starts[:, i + 1] > starts[:, i]).tolist():
            chunk, at = chunks[c], order[c][starts[c, i] : starts[c, i + 1]]
            L = np.zeros((len(at), 2 * group, m))
            first, L_own = chunk.first[at] - i * group, chunk.L[at]
            for r in range(width):
                L[np.arange(len(at)), first + r] = L_own[:, r]
            parts.append(np.hstack([L.reshape(len(at), -1), chunk.A[at], chunk.b[at, None]]))
        yield np.concatenate(parts)
    yield parts[0]


def _parted(rows: Array, c: int, tol: float) -> tuple[Array, Array]:
    """Part rows into as many as determine their first c unknowns, and others, free of these.

    Combinations that the rows weigh less than `tol` are left open: they count as zero.
    """
    R = np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) else rows
    leading, rest = R[:c], R[c:]
    if (len(leading) == c and (np.abs(leading.diagonal()) > CLOSE * tol).all()) or not c:
        return leading, rest
    U, s, Vt = linear.svd(leading[:, :c], full_matrices=True)
    turned = U.T @ leading
    turned[:, :c] = 0.0
    turned[: len(s), :c] = s[:, None] * Vt[: len(s)]
    known = np.append(s > tol, np.zeros(len(leading) - len(s), dtype=bool))
    turned[~known, :c] = 0.0
    return turned[known], np.concatenate([rest, turned[~known]])
