"""One level of the dissection: every other knot eliminated, two intervals made one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.solve.factor import Array
from ident.solve.intervals import Free, Index
from ident.solve.reflect import reflect, release, weak


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


def halve(
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
        own, determined[doubtful], kept, more = _by_singular_values(
            pair[doubtful], side[doubtful], tol
        )
        own_X[doubtful], own_Y[doubtful] = own
        kept_X[doubtful], kept_Y[doubtful] = kept
        free[doubtful] = 0.0
        freed.append(Free(mid[doubtful], more))
    released, more = release(kept_X, kept_Y, tol)
    freed += [Free(mid, free), Free(mid[released], more)]
    level = Level(knots[0 : 2 * n : 2], mid, knots[2 : 2 * n + 1 : 2], own_X, own_Y)
    X, Y = np.concatenate([kept_X, X[2 * n :]]), np.concatenate([kept_Y, Y[2 * n :]])
    return level, determined, X, Y, freed


def _by_singular_values(
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
