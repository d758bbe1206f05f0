"""One level of the dissection: knots eliminated together, several intervals made one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.solve.factor import Array
from ident.solve.intervals import Free, Index
from ident.solve.reflect import reflect, release, weak

Rows = tuple[Array, Array]  # X (n, r, c), Y (n, r, k + 1)


@dataclass(frozen=True, eq=False)
class Level:
    """Knots eliminated together: R a_inside = d - P p - N [a_left; a_right], R regular.

    begin: number of the first interval that the level made, the empty one before knot 0 being 0.
    left (n,), inside (n, i), right (n,): numbers of knots, w = group m coefficients each.
    X: (n, i w, (i + 2) w) = [R | N]; Y: (n, i w, k + 1) = [P | d]. In the rows of combinations that
        no equation weighs, R has the tolerance and the rest is zero.
    """

    begin: int
    left: Index
    inside: Index
    right: Index
    X: Array
    Y: Array


def halve(
    knots: Index, X: Array, Y: Array, tol: float, by: int = 2
) -> tuple[Level, Index, Index, Array, Array, list[Free]]:
    """Make one interval of two, or of `by`: 0 and 1, 2 and 3, …; what is over stays as it is.

    Returns the level, how many coefficients of each interval's knots are determined, the knots and
    intervals that are left, and the rows that became free.
    """
    n, w = len(X) // by, X.shape[-1] // 2
    each, rest = X[: n * by].reshape(n, by, 2 * w, 2 * w), slice(n * by, None)
    stack = np.zeros((n, by, 2 * w, by + 1, w))  # columns: inside, left, right
    place = [by - 1, *range(by - 1), by]
    for i in range(by):
        stack[:, i, :, place[i]], stack[:, i, :, place[i + 1]] = (
            each[:, i, :, :w],
            each[:, i, :, w:],
        )
    rows = (
        stack.reshape(n, 2 * w * by, (by + 1) * w),
        Y[: n * by].reshape(n, 2 * w * by, Y.shape[-1]),
    )
    around = knots[by * np.arange(n)[:, None] + np.arange(by + 1)]
    level, determined, kept, freed = inside_out(around, rows, reflect(*rows), tol)
    knots = np.concatenate([around[:, 0], knots[rest]])
    X, Y = np.concatenate([kept[0], X[rest]]), np.concatenate([kept[1], Y[rest]])
    return level, determined, knots, X, Y, freed


def inside_out(
    knots: Index, rows: Rows, reduced: Rows, tol: float
) -> tuple[Level, Index, Rows, list[Free]]:
    """Eliminate the knots inside of intervals: all of `knots` (n, i + 2) but their ends.

    rows: with the columns of the knots inside, then of left and right; reduced: by `reflect`.
    Returns the level, how many coefficients are determined, the rows of the ends that are left, and
    those that became free.
    """
    (R, rest), n, i = reduced, len(knots), knots.shape[1] - 2
    w = R.shape[-1] // (i + 2)
    c, left, inside, right = i * w, knots[:, 0], knots[:, 1:-1], knots[:, -1]
    own_X, own_Y = R[:, :c].copy(), rest[:, :c].copy()
    kept_X, kept_Y = R[:, c:, c:].copy(), rest[:, c : c + 2 * w].copy()
    free, determined, freed = rest[:, c + 2 * w :].copy(), np.full(n, c), []
    doubtful = weak(own_X, tol).any(axis=1)
    if doubtful.any():
        X, Y = (part[doubtful] for part in rows)
        own, determined[doubtful], kept, more = _by_singular_values(X, Y, c, tol)
        own_X[doubtful], own_Y[doubtful] = own
        kept_X[doubtful], kept_Y[doubtful] = kept
        free[doubtful] = 0.0
        freed.append(Free(inside[doubtful, 0], more))
    released, more = release(kept_X, kept_Y, tol)
    freed += [Free(inside[:, 0], free), Free(inside[released, 0], more)]
    begin = 0 if left[0] < 0 else 1
    level = Level(begin, left, inside, right, own_X, own_Y)
    return level, determined, (kept_X, kept_Y), freed


def _by_singular_values(X: Array, Y: Array, c: int, tol: float) -> tuple[Rows, Index, Rows, Array]:
    """The same for knots of which the equations may leave combinations open, by singular values."""
    ends = X.shape[-1] - c
    U, s, Vt = np.linalg.svd(X[..., :c])
    seen = (s > tol)[..., None]
    rows = U.swapaxes(1, 2) @ np.concatenate([X[..., c:], Y], axis=2)
    own = np.where(seen, rows[:, :c], 0.0)
    rows[:, :c] -= own
    own_X = np.concatenate([np.where(seen, s[..., None], tol) * Vt, own[..., :ends]], axis=2)
    R, rest = reflect(rows[..., :ends], rows[..., ends:])
    return (own_X, own[..., ends:]), seen.sum(axis=(1, 2)), (R, rest[:, :ends]), rest[:, ends:]
