"""What residuals do to a loop's multipliers.

    least squares on all rows with p known:  λ̂ = (Jᵀ)⁺ (τ − Γ p − E c),   λ_ref = λ̂ at r = 0
    λ̂ − λ_ref = G r,    G = (Jᵀ)⁺ W_uᵀ          r: the residual in the independent coordinates u

Free multipliers are no further sensors: their error is the torques' error, seen through the loop,
large where it is near a dead centre.
"""

from __future__ import annotations

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.motion.close import Closer

REDUNDANT = 1e-6  # of the largest singular value of J


def lift(mechanism: Mechanism, independent: tuple[str, ...], q: np.ndarray) -> np.ndarray:
    """G (n, m, d) at configurations.

    Args:
        mechanism: with m closure equations; none for a tree.
        independent: names of the d joints in whose coordinates errors are compared.
        q: (n, nq).
    """
    if not mechanism.closures:
        return np.zeros((len(q), 0, len(independent)))
    J = mechanism.kinematics.closure_rows(q).rate
    W = Closer(mechanism, independent).coordinates(q).rate
    return np.linalg.pinv(J.transpose(0, 2, 1), rcond=REDUNDANT) @ W.transpose(0, 2, 1)
