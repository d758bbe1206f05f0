"""How far two causes are apart in the rows of a motion: one measure for every planner.

    s = (I − P) C_a θ_a       P onto the columns A of all else
    d = min over C_b of |(I − P_b) s|,   share = d / |s|         P_b onto (I − P) C_b

With rows over the noise d is in standard errors (`information.evidence`: half of it is what blocks
of held-out errors would show in theirs). Without a value θ_a the share is that of its worst
direction, the sine of the least angle between both spans; its cosine is the largest canonical
correlation of both estimates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.information import linear
from ident.information.linear import Array
from ident.information.projection import RANK

NEW_COLUMN = 1e-12  # numerics: of the largest column, below which one is rounding


def without_columns_of(Q: Array, X: Array) -> Array:
    """Return (I − QQᵀ) X, what columns X (M, …) have beside orthonormal ones Q (M, r)."""
    return np.asarray(X - Q @ (Q.T @ X))


def orthonormal(A: Array) -> Array:
    """Return a basis (M, rank) of the columns' span."""
    size = np.linalg.norm(A, axis=0)
    nonzero = size > NEW_COLUMN * size.max(initial=0.0)
    A = A[:, nonzero] / size[nonzero]
    if not A.size:
        return np.zeros((len(A), 0))
    Q, R = np.linalg.qr(A)
    U, s, _ = linear.svd(R)
    return np.asarray(Q @ U[:, s > RANK * s[0]])


def share_apart(a: Array, others: Sequence[Array]) -> float:
    """Return the share of the columns a (M, u), orthonormal, that none of the `others`, orthonormal
    (M, …) each, can do in their place: in the direction in which it is least; 0 of no column.
    """
    if not a.size:
        return 0.0
    shares = (float(linear.svd(without_columns_of(b, a), False)[1].min()) for b in others)
    return min([1.0, *shares])  # rounding makes more of it
