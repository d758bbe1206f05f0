"""How sure the multipliers are: the variance of lambda_i(t), by the way back through the levels.

Given p, the coefficients of a level follow from R a_mid = d - P p - N a_around with unit noise on
the equations, so with Σ = Cov[a_left; a_right], conditional on p,

    Cov[a_mid] = R^-1 (1 + N Σ N^T) R^-T,   Cov[a_mid, a_around] = -R^-1 N Σ

and G_mid = -R^-1 (P + N G), where G = ∂a/∂p adds G C G^T for the covariance C of p. Covariances
are formed of neighbours only: the selected inverse of a sparse factor (G. Golub and R. Plemmons,
Linear Algebra Appl. 34, 1980).
"""

from __future__ import annotations

import numpy as np

from ident.errors import FitError
from ident.solve.eliminate import Elimination
from ident.solve.factor import Array
from ident.solve.intervals import Index

_PIECE = 4096  # times evaluated at once


def multiplier_variance(elimination: Elimination, C: Array, first: Index, values: Array) -> Array:
    """Variance of lambda_i(t), (n, m) [N² or (N m)²] for equations of unit noise.

    C: (k, k) covariance of the parameters; zeros where p is known or keeps its prior.
    first (n,), values (n, width): the basis at the times t, `Basis.window`.
    Infinite where the equations leave lambda_i(t) open. Multiply by the noise variance, and say
    what it rests on: the basis (a rough lambda under smooth functions looks surer than it is).
    """
    if C.shape != (elimination.factors[0].k,) * 2:
        raise FitError(f"C {C.shape}; valid: {(elimination.factors[0].k,) * 2}")
    conditional, gain = _backward(elimination)
    m, group = elimination.m, elimination.group
    variance = np.empty((len(first), m))
    for start in range(0, len(first), _PIECE):
        part = slice(start, start + _PIECE)
        knot, offset = np.divmod(first[part], group)
        weight = np.zeros((len(knot), 2 * group))
        np.put_along_axis(
            weight, offset[:, None] + np.arange(values.shape[1]), values[part], axis=1
        )
        inner = conditional[knot + 1].reshape(len(knot), 2 * group, m, 2 * group, m)
        slope = np.concatenate([gain[knot], gain[knot + 1]], axis=1)
        slope = np.einsum("ta,taik->tik", weight, slope.reshape(len(knot), 2 * group, m, -1))
        variance[part] = np.einsum("ta,taibi,tb->ti", weight, inner, weight)
        variance[part] += np.einsum("tik,kl,til->ti", slope, C, slope)
    return np.where(variance < 1 / elimination.seen**2, variance, np.inf)


def _backward(elimination: Elimination) -> tuple[Array, Array]:
    """Cov given p of every interval's two knots (S + 2, 2 w, 2 w), and the gain G (knots, w, k)."""
    levels = elimination.levels
    w, k = levels[0].X.shape[1], levels[0].Y.shape[2] - 1
    gain = np.zeros((levels[-1].right[-1] + 2, w, k))
    around = np.zeros((1, 2 * w, 2 * w))  # the outermost knots are empty
    for level in reversed(levels):
        n, R, N = len(level.mid), level.X[..., :w], level.X[..., w:]
        beside = np.concatenate([gain[level.left], gain[level.right]], axis=1)
        eye = np.broadcast_to(np.eye(w), R.shape)
        solved = np.linalg.solve(
            R, np.concatenate([eye, N, level.Y[..., :-1] + N @ beside], axis=2)
        )
        inverse, M, gain[level.mid] = solved[..., :w], solved[..., w : 3 * w], -solved[..., 3 * w :]
        outer, odd = around[:n], around[n:]
        cross = -M @ outer
        mid = inverse @ inverse.swapaxes(1, 2) - cross @ M.swapaxes(1, 2)
        L, H = slice(0, w), slice(w, 2 * w)
        joint = np.block(
            [
                [outer[:, L, L], cross[..., L].swapaxes(1, 2), outer[:, L, H]],
                [cross[..., L], mid, cross[..., H]],
                [outer[:, H, L], cross[..., H].swapaxes(1, 2), outer[:, H, H]],
            ]
        )
        pair = np.stack([joint[:, : 2 * w, : 2 * w], joint[:, w:, w:]], axis=1)
        around = np.concatenate([pair.reshape(2 * n, 2 * w, 2 * w), odd])
    return around, gain
