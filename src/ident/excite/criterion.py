"""The criterion that is maximised: log-determinants of the information of some unknowns.

    W = A_I / σ     M = WᵀW     J = Σ w_j log det M_j − w log κ
    d log det M = Σ G ∘ dW,  G = 2 Q R⁻ᵀ

D-optimality:  J = log det M / 2r: −J is the mean logarithm of the standard errors. It hardly cares
for the condition number κ of W with unit columns, which costs little to lower: hence w log κ.
Separation:    J = (log det S_a / r_a + log det S_b / r_b) / 4, S_a the information on a where all
else, b too, is refitted: det S_a = det M / det M without a. −J is the same mean, over a and b.

D-optimality: Swevers et al. 1997 (see `trajectory.Fourier`); partial (D_s) optimality: Atkinson,
Donev, Optimum Experimental Designs, 1992, sect. 10.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular, subspace_angles

from ident.information import linear

TINY = 1e-13  # of R's diagonal: below, the columns do not determine some unknown


@dataclass(frozen=True, eq=False)
class Criterion:
    """J as weighted log-determinants of groups of columns of W."""

    parts: tuple[tuple[float, np.ndarray], ...]  # (weight, columns) each
    balance: float = 0.0  # w, the weight of the condition number

    @classmethod
    def of_all(cls, r: int, balance: float) -> Criterion:
        """D-optimality of r unknowns, with a weight of the condition number."""
        return cls(((0.5 / r, np.arange(r)),), balance)

    @classmethod
    def of_pair(cls, r: int, a: Sequence[int], b: Sequence[int]) -> Criterion:
        """Separation of two rivals' columns a and b among r."""
        wa, wb = 0.25 / len(a), 0.25 / len(b)
        every = np.arange(r)
        return cls(((wa + wb, every), (-wa, np.setdiff1d(every, a)), (-wb, np.setdiff1d(every, b))))

    def at(self, W: np.ndarray) -> tuple[float, np.ndarray] | None:
        """Return J and G (N, r) of rows W (N, r); None where W does not determine all unknowns."""
        value, slope = 0.0, np.zeros_like(W)
        for weight, columns in self.parts:
            Q, R = np.linalg.qr(W[:, columns])
            size = np.abs(R.diagonal())
            if not size.min(initial=1.0) > TINY * size.max(initial=1.0):
                return None
            value += 2 * weight * float(np.log(size).sum())
            slope[:, columns] += 2 * weight * solve_triangular(R, Q.T, lower=False).T
        if self.balance:
            worse, steeper = log_condition(W)
            value, slope = value - self.balance * worse, slope - self.balance * steeper
        return value, slope


def log_condition(W: np.ndarray) -> tuple[float, np.ndarray]:
    """Return log κ of W (N, r) with columns of unit norm, and its slope by W.

    d log σ = uᵀ dN v / σ of a singular value of N = W / |W_j|;  dN_j = (I − N_j N_jᵀ) dW_j / |W_j|.
    """
    size = np.linalg.norm(W, axis=0)
    N = W / size
    U, s, Vt = linear.svd(N, full_matrices=False)
    G = np.outer(U[:, 0], Vt[0]) / s[0] - np.outer(U[:, -1], Vt[-1]) / s[-1]
    return float(np.log(s[0] / s[-1])), (G - N * (N * G).sum(axis=0)) / size


def cosine_and_shares(
    W: np.ndarray, a: Sequence[int], b: Sequence[int]
) -> tuple[float, tuple[float, float]]:
    """Return (cosine, shares) of the columns a and b of W (N, r) beside the others."""
    rest = np.setdiff1d(np.arange(W.shape[1]), [*a, *b])
    angles = subspace_angles(*(_beside(W[:, rest], W[:, list(own)]) for own in (a, b)))
    shares = [
        float(np.linalg.norm(_beside(W[:, [*rest, *other]], C)) / np.linalg.norm(C))
        for C, other in ((W[:, list(a)], b), (W[:, list(b)], a))
    ]
    return float(np.cos(angles.min())), (shares[0], shares[1])


def _beside(A: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Return the part of C orthogonal to the columns of A, which may depend on each other."""
    size = np.linalg.norm(A, axis=0)
    A = A / np.where(size > 0, size, 1.0)
    for _ in range(2):  # twice is enough against rounding
        C = C - A @ linear.lstsq(A, C, rcond=1e-10)[0]
    return C
