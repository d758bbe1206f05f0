"""What an estimate becomes when blocks of time are left out, without another solve.

With the rows of the base A_I, divided by their coordinates' σ, Q = A_I T orthonormal, e = b − A x,
and of the rows k of one or several blocks

    G = Q_kᵀ Q_k        β without them  =  β − T (I − G)⁻¹ Q_kᵀ e_k            e = b − A x

Everything comes from orthonormal factors: I − G is as well conditioned as the other rows determine
what these do, and AᵀA is never inverted (block downdating: Belsley, Kuh, Welsch, Regression
Diagnostics, 1980).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ident.information import linear
from ident.information.blocks import Information
from ident.information.estimate import Estimate
from ident.information.lapack import lapack
from ident.information.linear import Array

ALONE = 1e10  # numerics: ‖(I − G)⁻¹‖ from which some direction is determined by these blocks alone
TERMS = 60  # work: of a series in G, beyond which eigenvectors are faster


@dataclass(frozen=True, eq=False)
class LeftOut:
    """The orthonormal rows of an estimate by blocks of time, B of them, in n base parameters."""

    times: list[tuple[int, int]]  # (log, block) of each
    T: Array  # (n, n) from Q's coordinates to base parameters
    G: Array  # (B, n, n) Q_kᵀ Q_k
    h: Array  # (B, n) Q_kᵀ e_k
    white: Array  # (n, n) Cov[Σ h] if the residuals of each coordinate were white

    @classmethod
    def of(cls, information: Information, estimate: Estimate, with_prior: bool = False) -> LeftOut:
        """Take the rows that inform, at the estimate, which need not be their own; `with_prior`:
        whether its triangle has further rows.
        """
        base, times = estimate.base.independent, information.times
        n, number = len(base), {time: k for k, time in enumerate(times)}
        place = np.full(information.k, -1)
        place[base] = np.arange(n)
        R = estimate.triangle.restricted(base).R
        T, _ = lapack.dtrtri(R) if n else (R, 0)
        pieces = []  # (block of time, coordinate, rows of Q, e) in the order of coordinates
        for u, blocks in information.by_coordinate.items():
            blocks = [block for block in blocks if block.triangle.rows]
            if not blocks:
                continue
            support, sigma = blocks[0].support, estimate.sigma[u]
            stacks = [block.triangle.stack() for block in blocks]
            rows = np.concatenate(stacks) / sigma
            e = rows[:, -1] - rows[:, :-1] @ estimate.x[support]
            inside = place[support] >= 0
            Q = rows[:, :-1][:, inside] @ T[place[support][inside]]
            of_block = [number[block.log, block.block] for block in blocks]
            pieces.append((u, np.repeat(of_block, [len(s) for s in stacks]), Q, e))
        counts = {
            u: sum(block.triangle.rows for block in blocks)
            for u, blocks in information.by_coordinate.items()
        }
        if not pieces or not n:
            by_block = np.zeros((len(times), n, n)), np.zeros((len(times), n))
            return cls(times, T, *by_block, np.zeros((n, n)))
        Q = np.concatenate([piece[2] for piece in pieces])
        # what rounding leaves of QᵀQ − I goes
        is_whole = n and not with_prior
        turn = np.linalg.inv(np.linalg.cholesky(Q.T @ Q)).T if is_whole else np.eye(n)
        Q, T = Q @ turn, T @ turn
        e, block = (np.concatenate([piece[i] for piece in pieces]) for i in (3, 1))
        order = np.argsort(block, kind="stable")
        edges = np.searchsorted(block[order], np.arange(len(times) + 1))
        Q_sorted, e_sorted = Q[order], e[order]
        cuts = [slice(a, b) for a, b in pairwise(edges.tolist())]
        G = np.array([Q_sorted[cut].T @ Q_sorted[cut] for cut in cuts]).reshape(-1, n, n)
        h = np.array([Q_sorted[cut].T @ e_sorted[cut] for cut in cuts]).reshape(-1, n)
        white, first = np.zeros((n, n)), 0
        for u, _, _, residual in pieces:
            rows_of_u = Q[first : first + len(residual)]
            variance = residual @ residual / max(counts[u], 1)
            white += variance * (rows_of_u.T @ rows_of_u)
            first += len(residual)
            for at_u in information.by_coordinate[u]:  # a few rows at rest may be met exactly
                if at_u.rest_rows is not None and at_u.resting and variance < 1.0:
                    inside = place[at_u.support] >= 0
                    at_rest = at_u.rest_rows.R[:, inside] / estimate.sigma[u]
                    at_rest = at_rest @ T[place[at_u.support][inside]]
                    white += (1.0 - variance) * (at_rest.T @ at_rest)
        return cls(times, T, G, h, white)

    @cached_property
    def without_each(self) -> Array:
        """(I − G)⁻¹ (B, n, n) of each block; directions that it alone determines are left out."""
        return self._downdated(self.G)[0]

    def _downdated(self, G: Array) -> tuple[Array, Array]:
        """(I − G)⁻¹ (…, n, n), and (…,) whether the other rows determine everything."""
        rest = np.eye(G.shape[-1]) - G
        try:
            M = np.linalg.inv(rest)
            good = np.abs(M).max(axis=(-2, -1), initial=0.0) < ALONE
        except np.linalg.LinAlgError:
            M, good = rest, np.zeros(len(rest), dtype=bool)
        if not good.all():
            M = M.copy()
            M[~good] = linear.pinv(rest[~good], rcond=1 / ALONE, hermitian=True)
        return np.asarray(M), np.asarray(good)

    @property
    def deltas(self) -> tuple[Array, Array]:
        """Changes δ (B, n) of the base parameters when each block is left out, and the shares
        (B, n) that each would have in their variance if residuals were white.
        """
        M = self.without_each
        deltas: Array = (M @ self.h[:, :, None])[:, :, 0] @ self.T.T
        W = self.T @ M
        shares = (W @ self.G * W).sum(axis=2)  # diag T M G M Tᵀ
        return deltas, np.maximum(shares, 0.0)

    @property
    def unbiased_changes(self) -> tuple[Array, Array]:
        """Changes T (I − G)^(−1/2) h (B, n) by each block, whose squares have the mean T G Tᵀ if
        rows are white, and the shares (B, n) of each block in it.
        """
        h, term = self.h[:, :, None].copy(), self.h[:, :, None]
        for k in range(1, TERMS + 1):  # (1 − x)^(−1/2) = Σ (2k choose k) (x/4)^k
            term = (1 - 0.5 / k) * (self.G @ term)
            h += term
            small = np.abs(term).max(axis=(1, 2)) <= np.finfo(float).eps * np.abs(h).max(
                axis=(1, 2)
            )
            if small.all():
                break
        if not small.all():
            values, V = np.linalg.eigh(self.G[~small])
            scale = 1 / np.sqrt(np.maximum(1 - values, 1 / ALONE))[:, :, None]
            h[~small] = V @ (scale * (V.transpose(0, 2, 1) @ self.h[~small, :, None]))
        shares = (self.T @ self.G * self.T).sum(axis=2)
        return h[:, :, 0] @ self.T.T, np.maximum(shares, 0.0)

    @property
    def white_covariance(self) -> Array:
        """Covariance (n, n) of the base parameters if residuals were white."""
        return np.asarray(self.T @ self.white @ self.T.T)

    def without(self, groups: Sequence[Sequence[tuple[int, int]]]) -> tuple[Array, Array]:
        """Return the changes (groups, n) of the base parameters when each group of blocks (log,
        block) is left out, and (groups,) whether the other rows determine all of them.
        """
        number = {time: k for k, time in enumerate(self.times)}
        places = [[number[time] for time in group if time in number] for group in groups]
        G, h = (np.array([x[at].sum(axis=0) for at in places]) for x in (self.G, self.h))
        M, good = self._downdated(G)
        rest = self.h.sum(axis=0) - h  # the gradient of the other rows, 0 − h at their own minimum
        return np.asarray((M @ rest[:, :, None])[:, :, 0] @ self.T.T), np.asarray(good)
