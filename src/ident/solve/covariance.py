"""How sure the multipliers are: the variance of lambda(t), by the way back through the levels.

Given p, a level's coefficients follow from R a_mid = d - P p - N a_around + noise of unit variance.
So if Cov[a_around | p] = S S^T, the three knots of an interval that was made of two have the root

    [a_left; a_mid; a_right]  ~  [S_left  0;  -R^-1 N S  R^-1;  S_right  0]

and each half of it is made square again by a QR. G_mid = -R^-1 (P + N G), where G = ∂a/∂p adds
G C G^T for the covariance C of p. Only neighbours' covariances are formed: the selected inverse of
a sparse factor (G. Golub and R. Plemmons, Linear Algebra Appl. 34, 1980), in square-root form since
variances of open and of sure combinations may be 16 digits apart.
"""

from __future__ import annotations

import numpy as np

from ident.errors import FitError
from ident.solve.eliminate import Elimination
from ident.solve.factor import Array
from ident.solve.intervals import Index

_PIECE = 4096  # times evaluated at once


def multiplier_variance(
    elimination: Elimination,
    C: Array,
    first: Index,
    values: Array,
    directions: Array | None = None,
) -> Array:
    """Variance of lambda_i(t), (n, m) [N² or (N m)²] for equations of unit noise.

    C: (k, k) covariance of the parameters; zeros where p is known or keeps its prior.
    first (n,), values (n, width): the basis at the times t, `Basis.window`.
    directions: (n, q, m), for the variance (n, q) of directions @ lambda(t) instead: with the
        projector J_T^+ J_T of redundant closures, of the part of lambda that moves anything.
    Infinite where the equations leave a combination open. Multiply by the noise variance, and say
    what it rests on: the basis (a rough lambda under smooth functions looks surer than it is).
    """
    k, m, group = elimination.factors[0].k, elimination.m, elimination.group
    if C.shape != (k, k):
        raise FitError(f"C {C.shape}; valid: {(k, k)}")
    if directions is None:
        directions = np.broadcast_to(np.eye(m), (len(first), m, m))
    root, gain = _backward(elimination)
    variance = np.empty(directions.shape[:2])
    for start in range(0, len(first), _PIECE):
        part = slice(start, start + _PIECE)
        knot, offset = np.divmod(first[part], group)
        weight = np.zeros((len(knot), 2 * group))
        np.put_along_axis(
            weight, offset[:, None] + np.arange(values.shape[1]), values[part], axis=1
        )
        row = weight[:, None, :, None] * directions[part][:, :, None, :]
        row = row.reshape(*directions[part].shape[:2], 2 * group * m)
        own = row @ root[knot + 1]
        slope = row @ np.concatenate([gain[knot], gain[knot + 1]], axis=1)
        variance[part] = (own**2).sum(axis=2) + ((slope @ C) * slope).sum(axis=2)
    return np.where(variance * elimination.sure**2 < 1, variance, np.inf)


def _backward(elimination: Elimination) -> tuple[Array, Array]:
    """Roots of all intervals' two knots given p, (S + 2, 2 w, 2 w), and the gain (knots, w, k)."""
    levels, w = elimination.levels, elimination.group * elimination.m
    k = elimination.factors[0].k
    gain = np.zeros((levels[-1].right[-1] + 2, w, k))
    root = np.zeros((1, 2 * w, 2 * w))  # the outermost knots are empty
    for level in reversed(levels):
        (n, i), c = level.inside.shape, level.X.shape[1]
        R, N, made = level.X[..., :c], level.X[..., c:], slice(level.begin, level.begin + n)
        beside = np.concatenate([gain[level.left], gain[level.right]], axis=1)
        eye = np.broadcast_to(np.eye(c), R.shape)
        right = np.concatenate([eye, N @ root[made], level.Y[..., :-1] + N @ beside], axis=2)
        solved = np.linalg.solve(R, right)
        gain[level.inside] = -solved[..., c + 2 * w :].reshape(n, i, w, k)
        knots = np.zeros((n, i + 2, w, 2 * w + c))  # the root of all knots of an interval
        knots[:, 0, :, : 2 * w], knots[:, -1, :, : 2 * w] = root[made, :w], root[made, w:]
        knots[:, 1:-1, :, : 2 * w] = -solved[..., c : c + 2 * w].reshape(n, i, w, 2 * w)
        knots[:, 1:-1, :, 2 * w :] = solved[..., :c].reshape(n, i, w, c)
        parts = np.concatenate([knots[:, :-1], knots[:, 1:]], axis=2)  # of each two neighbours
        tall = parts.reshape(n * (i + 1), 2 * w, 2 * w + c).swapaxes(1, 2)
        square = np.asarray(np.linalg.qr(tall, mode="r")).swapaxes(1, 2)
        root = np.concatenate([root[: level.begin], square, root[made.stop :]])
    return root, gain
