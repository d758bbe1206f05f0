"""Judging columns against a residual, everything else refitted, blocks of time left out.

    Q: orthonormal, spans the model's weighted columns      r = (I − QQᵀ) b,  C̃ = (I − QQᵀ) C
    held out in block B, fitted to the others:  L z = z̃_B + Q_B (I − Q_BᵀQ_B)⁻¹ Q_Bᵀ z̃_B
    θ₋B = S₋B(C, C)⁻¹ S₋B(C, r),   S₋B(x, y) = x̃ᵀỹ − x̃_Bᵀ (L y)_B,   e_B = (L r)_B − (L C)_B θ₋B

Leave-block-out errors of all refits without a single refit (partial regression: Frisch, Waugh,
Lovell; block downdating: Belsley, Kuh, Welsch, Regression Diagnostics, 1980).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ident.fit.table import Table

BLOCKS = 20
HIDDEN = 1e-4  # share of a column below which a search does not look at it
RANK = 1e-8  # of the largest singular value of the scaled columns
NULL = 1e-12  # of the model's largest column: what is smaller is rounding
NEW = 1e-9  # share of unit columns below which nothing in them is new, and only rounding is left


@dataclass(frozen=True, eq=False)
class Judgement:
    """What columns C (M, k) would do.

    Attributes:
        loss: (blocks, d) held-out weighted squares with them, everything refitted.
        theta: (k,) coefficients from all rows.
        fall: in-sample fall of the weighted sum of squares.
        visible: share of C that nothing else in the model explains.
        by: (d,) in-sample fall in each coordinate's rows.
    """

    loss: np.ndarray
    theta: np.ndarray
    fall: float
    visible: float
    by: np.ndarray


@dataclass(frozen=True, eq=False)
class Screen:
    """The weighted rows (M,) that decide, sorted by block, with the model projected out.

    Attributes:
        row, coordinate: (M,) which of the table's rows.
        edges: (blocks + 1,) where blocks begin.
        weight: (d,) 1/σ of each coordinate.
        Q: (M, rank); r, Lr: (M,) residual, and the held-out one.
        inverse: (blocks, rank, rank) (I − Q_BᵀQ_B)⁻¹.
    """

    row: np.ndarray
    coordinate: np.ndarray
    edges: np.ndarray
    weight: np.ndarray
    Q: np.ndarray
    r: np.ndarray
    Lr: np.ndarray
    inverse: np.ndarray
    d: int

    @classmethod
    def of(cls, table: Table, use: np.ndarray, sigma: np.ndarray, held: np.ndarray) -> Screen:
        """The rows `use` (N, d), divided by sigma (d,); `held` (k,) unknowns are no columns."""
        block = blocks_of(table)
        row, coordinate = np.nonzero(use)
        order = np.argsort(block[row], kind="stable")
        row, coordinate = row[order], coordinate[order]
        edges = np.searchsorted(block[row], np.arange(block.max() + 2))
        full = np.flatnonzero(np.diff(edges) > 0)
        edges = np.append(edges[full], edges[-1])
        return cls._of(table, row, coordinate, edges, 1.0 / sigma, held)

    @classmethod
    def same_rows(cls, other: Screen, table: Table, held: np.ndarray) -> Screen:
        """The rows and weights of another screen, without the columns of `held` (k,) unknowns."""
        return cls._of(table, other.row, other.coordinate, other.edges, other.weight, held)

    @classmethod
    def _of(
        cls,
        table: Table,
        row: np.ndarray,
        coordinate: np.ndarray,
        edges: np.ndarray,
        weight: np.ndarray,
        held: np.ndarray,
    ) -> Screen:
        A = table.A[row, coordinate][:, ~held] * weight[coordinate][:, None]
        b = table.b[row, coordinate] - table.A[row, coordinate][:, held] @ _stay(table, held)
        b = b * weight[coordinate]
        Q = orthonormal(A)
        G = [Q[i:j].T @ Q[i:j] for i, j in pairwise(edges)]
        inverse = np.linalg.pinv(np.eye(Q.shape[1]) - np.array(G), rcond=1e-10, hermitian=True)
        r = b - Q @ (Q.T @ b)
        bare = cls(row, coordinate, edges, weight, Q, r, r, inverse, table.b.shape[1])
        return replace(bare, Lr=bare.left_out(r[:, None])[:, 0])

    def taken(self, x: np.ndarray, felt: np.ndarray | None = None) -> np.ndarray:
        """Columns (N, c, k) of the table, in the coordinates `felt`, as weighted rows (M, k)."""
        if felt is None or len(felt) == self.d:
            return x[self.row, self.coordinate] * self.weight[self.coordinate][:, None]
        found = np.zeros((len(self.row), x.shape[2]))
        for c, u in enumerate(felt):
            mine = self.coordinate == u
            found[mine] = x[self.row[mine], c] * self.weight[u]
        return found

    def projected(self, X: np.ndarray) -> np.ndarray:
        """(I − QQᵀ) X (M, k)."""
        return X - self.Q @ (self.Q.T @ X)

    def left_out(self, X: np.ndarray) -> np.ndarray:
        """L X (M, k) of projected columns X̃."""
        out = np.empty_like(X)
        for block, (i, j) in enumerate(pairwise(self.edges)):
            Q = self.Q[i:j]
            out[i:j] = X[i:j] + Q @ (self.inverse[block] @ (Q.T @ X[i:j]))
        return out

    def sums(self, x: np.ndarray) -> np.ndarray:
        """(blocks, d) sums of x (M,) over the rows of each block and coordinate."""
        blocks = np.repeat(np.arange(len(self.edges) - 1), np.diff(self.edges))
        flat = np.bincount(blocks * self.d + self.coordinate, x, (len(self.edges) - 1) * self.d)
        return flat.reshape(-1, self.d)

    @property
    def loss(self) -> np.ndarray:
        """(blocks, d) held-out weighted squares of the model as it is."""
        return self.sums(self.Lr**2)

    @property
    def rows(self) -> np.ndarray:
        """(d,) rows of each coordinate."""
        return np.bincount(self.coordinate, minlength=self.d)

    def judge(self, C: np.ndarray) -> Judgement:
        """What further columns C (M, k), not yet projected, would do to the residual."""
        r = self.r
        size = np.linalg.norm(C, axis=0)
        C = C / np.where(size > 0, size, 1.0)
        X = self.projected(C)
        X = X - self.Q @ (self.Q.T @ X)  # twice: what is left may be tiny
        visible = float(np.linalg.norm(X) / max(float(np.linalg.norm(C)), 1e-300))
        LX, Lr = self.left_out(X), self.Lr
        U, s, Vt = np.linalg.svd(X, full_matrices=False)
        good = s > NEW * max(s.max(initial=0.0), 1.0)
        theta = Vt[good].T @ ((U[:, good].T @ r) / s[good])
        X, LX = U[:, good], LX @ Vt[good].T / s[good]  # what is new, and no more
        after = r - X @ (X.T @ r)
        by = np.bincount(self.coordinate, r**2 - after**2, self.d)
        XX, Xr = X.T @ X, X.T @ r
        errors = np.empty(len(r))
        for i, j in pairwise(self.edges):
            S = XX - X[i:j].T @ LX[i:j]
            g = Xr - X[i:j].T @ Lr[i:j]
            errors[i:j] = Lr[i:j] - LX[i:j] @ np.linalg.lstsq(S, g, rcond=1e-10)[0]
        theta = theta / np.where(size > 0, size, 1.0)
        fall = float(r @ r - after @ after)
        return Judgement(self.sums(errors**2), theta, fall, visible, by)

    def falls(self, x: np.ndarray, felt: np.ndarray, u: int, R: np.ndarray) -> np.ndarray:
        """In-sample falls (groups, residuals) of groups of u neighbouring columns of the table,
        x (N, c, u·groups), against projected residuals R (M, residuals).

        X̃ᵀX̃ = XᵀX − (QᵀX)ᵀ(QᵀX),  X̃ᵀR = XᵀR: only the rows in which X is not zero are touched.
        """
        some = np.flatnonzero(np.isin(self.coordinate, felt))
        place = np.searchsorted(felt, self.coordinate[some])
        X = x[self.row[some], place] * self.weight[self.coordinate[some]][:, None]
        size = np.linalg.norm(X, axis=0)
        X = X / np.where(size > 0, size, 1.0)
        P = self.Q[some].T @ X
        groups = X.shape[1] // u
        parts = X.reshape(len(X), groups, u)
        inner = np.einsum("mgi,mgj->gij", parts, parts, optimize=True)
        outer = P.reshape(len(P), groups, u)
        gram = inner - np.einsum("mgi,mgj->gij", outer, outer, optimize=True)
        cross = (X.T @ R[some]).reshape(groups, u, R.shape[1])
        values, vectors = np.linalg.eigh(gram)
        good = values > HIDDEN**2 * u
        solved = np.einsum("gij,gir->gjr", vectors, cross)
        return np.einsum("gj,gjr->gr", good / np.where(good, values, 1.0), solved**2)


def _stay(table: Table, held: np.ndarray) -> np.ndarray:
    """Values at which held unknowns stay: bodies' at the prior, effects' at nothing, shapes' where
    they are.
    """
    return table.columns.prior_at(table.point.values)[held]


def blocks_of(table: Table) -> np.ndarray:
    """(N,) contiguous stretches of time, about BLOCKS in all, none over two experiments."""
    each = max(2, -(-BLOCKS // len(table.scenes)))
    found = np.empty(len(table.t), dtype=int)
    for number in range(len(table.scenes)):
        mine = table.experiment == number
        rank = np.arange(mine.sum()) * each // max(mine.sum(), 1)
        found[mine] = number * each + rank
    return found


def orthonormal(A: np.ndarray) -> np.ndarray:
    """A basis (M, rank) of the columns' span."""
    size = np.linalg.norm(A, axis=0)
    seen = size > NULL * size.max(initial=0.0)
    A = A[:, seen] / size[seen]
    if not A.size:
        return np.zeros((len(A), 0))
    Q, R = np.linalg.qr(A)
    U, s, _ = np.linalg.svd(R)
    return Q @ U[:, s > RANK * s[0]]
