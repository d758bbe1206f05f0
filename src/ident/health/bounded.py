"""Least squares of smallest norm, free or with inequalities, for columns that may depend."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lstsq

DEPENDENT = 1e-6  # share of a unit column below which what is new in it is rounding
FIRM = 100.0  # weight of an inequality at its bound, to rows of unit columns
SLACK = 1e-3  # of a unit column's unknown, by which a bound may be passed


def least(X: np.ndarray, b: np.ndarray) -> np.ndarray:
    """argmin ‖X x − b‖ for X (n, k) and b (n,) or (n, r), by a complete orthogonal factorisation.

    The singular values' divide and conquer (`gelsd`) does not always converge on such columns.
    """
    norm = _norm(X)
    x = _solve(X / norm, b, DEPENDENT)
    return x / (norm if b.ndim == 1 else norm[:, None])


def within(X: np.ndarray, b: np.ndarray, G: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Least squares x (k,) with G x + g ≥ 0: what is violated is held at its bound, one by one.

    What was held is not let go again: it is the answer of a full active-set method but where two
    bounds compete, and then an error that is slightly too large.
    """
    norm = _norm(X)
    G = G / norm
    size = np.linalg.norm(G, axis=1)
    known = size > 0
    G, g = G[known] / size[known, None], g[known] / size[known]
    A = X / norm
    active: list[int] = []
    while True:
        stack = np.concatenate([A, FIRM * G[active]])
        x = _solve(stack, np.concatenate([b, -FIRM * g[active]]), DEPENDENT / FIRM)
        slack = G @ x + g
        slack[active] = 0.0
        if len(active) == len(g) or slack.min(initial=0.0) >= -SLACK:
            return x / norm
        active.append(int(slack.argmin()))


def _norm(X: np.ndarray) -> np.ndarray:
    norm = np.linalg.norm(X, axis=0)
    return np.asarray(np.where(norm > 0, norm, 1.0))


def _solve(A: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    return np.asarray(lstsq(A, b, cond=share, lapack_driver="gelsy", check_finite=False)[0])
