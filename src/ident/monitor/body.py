"""A load that was put on a link or taken off: ten parameters of a body that can exist.

    θ = argmin |C θ − e|²     such that P(θ) ⪰ 0, or P(−θ) ⪰ 0     (the 4 × 4 pseudo-inertia)

Ten free columns explain much that no body does.
"""

from __future__ import annotations

import numpy as np

from ident.errors import FitError
from ident.mechanism.parameters import COUNT, pseudo_inertia
from ident.solve.cone import Limit, nearest, svec

RIDGE = 1e-3  # of unit columns, for what the window does not tell
FELT = 1e-6  # of the largest column
UNITS = np.stack([svec(pseudo_inertia(each)) for each in np.eye(COUNT)], axis=1)


def load(C: np.ndarray, e: np.ndarray) -> np.ndarray:
    """θ (10,) of the likelier of both; zero if the solver finds none.

    Args:
        C: (rows, 10), columns of the link's parameters.
        e: (rows,) what they are to explain.
    """
    size = np.linalg.norm(C, axis=0)
    size = np.where(size > FELT * size.max(), size, size.max())
    A = np.vstack([C / size, RIDGE * np.eye(COUNT)])
    Q, R = np.linalg.qr(A)
    d = Q[: len(e)].T @ e
    found = [np.zeros(COUNT)]
    for sign in (1.0, -1.0):
        body = Limit("a possible body", "psd", sign * UNITS / size, np.zeros(len(UNITS)))
        try:
            found.append(nearest(R, d, [body]).x / size)
        except FitError:  # far from any body, or no number left to tell
            continue
    return min(found, key=lambda theta: float(np.linalg.norm(C @ theta - e)))
