"""Which columns explain what a model leaves, everything else refitted, by blocks of time left out.

Beside a model that is projected out (`projection`, x̃ and L_k as there), columns C change the errors
of blocks that are left out, without a single refit (partial regression: Frisch, Waugh, Lovell):

    S₋k(x, y) = x̃ᵀỹ − x̃_kᵀ L_k ỹ_k          θ₋k = S₋k(C, C)⁻¹ S₋k(C, b)
    e_k = L_k b̃_k − L_k C̃_k θ₋k              D_k = |L_k b̃_k|² − |e_k|²          G = Σ_k D_k

Coordinates have noise of their own: with left-out squares L_u of n_u rows
before and L'_u after, N rows in all, the likelihood ratio of normal errors gives the share

    g = 1 − Π_u (L'_u / L_u)^(n_u / N)

The largest g over all candidates on r_1 … r_B is the null distribution of the largest g on b
(Westfall, Young, Resampling-Based Multiple Testing, 1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ident.information import linear
from ident.information.blocks import places
from ident.information.chance import CONTRIBUTES
from ident.information.linear import Array, Index
from ident.information.projection import VISIBLE, Projection

TOGETHER = 64  # work: columns that are projected at once


@dataclass(frozen=True, eq=False)
class Gains:
    """The changes of the left-out squared error by groups of columns."""

    D: Array  # (groups, blocks) by how much the left-out squares of b fall
    by: Array  # (groups, d) the same by coordinate
    null: Array  # (groups, d, B) fall of the left-out squares of r_1 … r_B by coordinate
    visible: Array  # (groups,) share of the columns that the model does not have

    @property
    def G(self) -> Array:
        """(groups,) total fall."""
        return self.D.sum(axis=1)


@dataclass(frozen=True, eq=False)
class Refit:
    """One group of columns, everything refitted."""

    D: Array  # (blocks,) fall of the left-out squares
    loss: Array  # (blocks, d) left-out squares with the group
    theta: Array  # (u,) coefficients from all rows
    stderr: Array  # (u,) their standard errors at unit noise
    by: Array  # (d,) in-sample fall of the squares in each coordinate
    visible: float  # share of the columns that the model does not have
    direction: Array  # (rows,) of C̃ θ, of unit length

    @property
    def G(self) -> float:
        """Total fall."""
        return float(self.D.sum())

    @property
    def affected_coordinates(self) -> list[int]:
        """Coordinates in which a part of the fall is that is more than a by-product."""
        by = np.maximum(self.by, 0.0)
        return np.flatnonzero(by >= CONTRIBUTES * max(by.sum(), 1e-300)).tolist()


class PartialRegression(Projection):
    """Blocks of rows with a model projected out, and what candidates explain beside it."""

    def gains(self, groups: Sequence[Index]) -> Gains:
        """Return what each group of columns does by itself, everything refitted."""
        B = self.residual[0].shape[1] - 1
        D, by = np.zeros((len(groups), self.blocks)), np.zeros((len(groups), self.d))
        null, visible = np.zeros((len(groups), self.d, B)), np.zeros(len(groups))
        sizes = np.array([len(group) for group in groups])
        for u in np.unique(sizes[sizes > 0]):
            which = np.flatnonzero(sizes == u)
            for chosen in np.array_split(which, -(-len(which) * u // 600)):
                gains = self._gains(np.array([groups[i] for i in chosen]))
                D[chosen], by[chosen] = gains.D, gains.by
                null[chosen], visible[chosen] = gains.null, gains.visible
        return Gains(D, by, null, visible)

    def _gains(self, groups: Index) -> Gains:
        """Gains of groups (n, u) of equal size, those of r_1 … r_B in single precision."""
        n, u = groups.shape
        (G, M), q = self._downdated, self._inside.sum(axis=0)
        G = G.sum(axis=0)
        blocks, rank, B = self.blocks, self.rank, q.shape[2] - 1
        columns = []  # by part, which groups have columns there, and these (m, ·), weighted
        for part in self.parts:
            at = places(part.columns, self.columns)[groups]
            present = np.flatnonzero((at >= 0).any(axis=1))
            X = part.at(at[present].ravel()) * self._factor(part)[groups[present].ravel()]
            columns.append((present, X))
        p = np.zeros((blocks, rank, n * u))
        cc = np.zeros((blocks, n, u, u))
        cy = np.zeros((blocks, n * u, 1))
        cn = np.zeros((blocks, n * u, B), dtype=np.float32)
        for part, Q, Y, (present, X) in zip(
            self.parts, self.Q, self.residual, columns, strict=True
        ):
            place = (present[:, None] * u + np.arange(u)).ravel()
            r, single = Y[:, 1:].astype(np.float32), X.astype(np.float32) if B else X
            where = slice(None) if len(place) == n * u else place  # a view, where it can be
            for k in range(blocks):
                rows = part.block(k)
                x = X[rows]
                p[k][:, where] += Q[rows].T @ x
                cy[k][where] += x.T @ Y[rows, :1]
                if B:
                    cn[k][where] += single[rows].T @ r[rows]
                cc[k, present] += _inner(x, x, u)
        P = p.sum(axis=0)
        small, qn = P.astype(np.float32), q[:, :, 1:].astype(np.float32)
        for k in range(blocks):
            cross = _inner(p[k], P, u)
            GP = G[k] @ P
            p[k] -= GP
            # x̃_kᵀx̃_k = xᵀx − pᵀP − Pᵀp + PᵀGP, p before the projection
            cc[k] += _inner(P, GP, u) - cross - cross.transpose(0, 2, 1)
            cy[k] -= P.T @ q[k, :, :1]
            if B:
                cn[k] -= small.T @ qn[k]
        values, V = np.linalg.eigh(cc.sum(axis=0))
        new = values > VISIBLE**2
        V = V * (new / np.sqrt(np.where(new, values, 1.0)))[:, None, :]
        # from here on columns x V, for which S = I
        turned = V.astype(np.float32)
        p, P = (_turned(V, x) for x in (p, P))
        cc = V.transpose(0, 2, 1) @ cc @ V
        cy = V.transpose(0, 2, 1) @ cy.reshape(blocks, n, u, 1)
        cn = turned.transpose(0, 2, 1) @ cn.reshape(blocks, n, u, B)
        s, sn = cy.sum(axis=0), cn.sum(axis=0)
        idle = np.eye(u) * ~new[:, None, :]
        Z = np.empty((blocks, rank, n * u))  # L c̃ = c − Q Z
        for k in range(blocks):  # cy, cn become θ
            Mp = M[k] @ p[k]
            a1 = cc[k] + _inner(p[k], Mp, u)
            inverse = linear.inverse(np.eye(u) * new[:, None, :] - a1 + idle)
            cy[k] = _theta(s, cy[k], Mp, q[k, :, :1], inverse)
            if B:
                cn[k] = _theta(sn, cn[k], *(x.astype(np.float32) for x in (Mp, qn[k], inverse)))
            Z[k] = P - Mp
        D, by = np.zeros((n, blocks)), np.zeros((n, self.d))
        null = np.zeros((n, self.d, B), dtype=np.float32)
        Z_single = Z.astype(np.float32) if B else Z
        for part, Q, by_block, (present, X) in zip(
            self.parts, self.Q, self._block_terms, columns, strict=True
        ):
            X = _turned(V[present], X)
            single = X.astype(np.float32) if B else X
            for k, (QQ, e, qe, random, q_random) in enumerate(by_block):
                rows = part.block(k)
                x = X[rows]
                a = _inner(Z[k], QQ @ Z[k], u)
                Z_block = Z[k].reshape(rank, n, u)[:, present].reshape(rank, len(present) * u)
                cross = _inner(Q[rows].T @ x, Z_block, u)
                a[present] += _inner(x, x, u) - cross - cross.transpose(0, 2, 1)
                fall = _fall(present, cy[k], x, Z[k], e, qe, a)[:, 0]
                D[:, k] += fall
                by[:, part.coordinate] += fall
                if B:
                    a = a.astype(np.float32)
                    fall = _fall(present, cn[k], single[rows], Z_single[k], random, q_random, a)
                    null[:, part.coordinate] += fall
        return Gains(D, by, null, np.sqrt(np.clip(values.sum(axis=1), 0.0, None) / u))

    @cached_property
    def _block_terms(self) -> list[list[tuple[np.ndarray, ...]]]:
        """By part and block QᵀQ, e = L b̃ and Qᵀe, and of r_1 … r_B in single precision."""
        parts = []
        G, M = self._downdated
        inside = self._inside + G @ (M @ self._inside.sum(axis=0))  # Qᵀe, as L = I + Q M Qᵀ
        for u, (part, E) in enumerate(zip(self.parts, self.errors, strict=True)):
            blocks = list[tuple[np.ndarray, ...]]()
            for k in range(self.blocks):
                e, qe = E[part.block(k)], inside[u, k]
                random, q_random = (y[:, 1:].astype(np.float32) for y in (e, qe))
                blocks.append((G[u, k], e[:, :1], qe[:, :1], random, q_random))
            parts.append(blocks)
        return parts

    def shares(self, groups: Sequence[Index]) -> Array:
        """(groups,) shares g that groups of columns explain."""
        return self.explained(self.gains(groups).by)

    def gain(self, refit: Refit) -> float:
        """Return the share g that a group of columns explains."""
        return float(self.explained((self.losses - refit.loss).sum(axis=0)))

    def refit(self, columns: Index) -> Refit:
        """One group of columns in detail."""
        return self.refits([columns])[0]

    def refits(self, groups: Sequence[Index]) -> list[Refit]:
        """Groups of columns in detail, each by itself."""
        refits, numbers = list[Refit](), [len(group) for group in groups]
        parts = -(-sum(numbers) // TOGETHER) or 1
        for chosen in filter(len, np.array_split(np.arange(len(groups)), parts)):
            flat = np.concatenate([groups[i] for i in chosen])
            C = np.concatenate([self._taken(p, flat) for p in self.parts])
            refits += self._refits(C, self.size[flat], [numbers[i] for i in chosen])
        return refits

    def refit_with(self, C: Sequence[Array]) -> Refit:
        """Columns C (m, u), one array a part, that are not among the candidates'."""
        X = [c * self.weight[p.coordinate] for p, c in zip(self.parts, C, strict=True)]
        size = np.linalg.norm(both := np.concatenate(X), axis=0)
        size = np.where(size > 0, size, 1.0)
        return self._refits(both / size, size, [len(size)])[0]

    def _refits(self, C: Array, size: Array, numbers: Sequence[int]) -> list[Refit]:
        """Columns C (rows, …) side by side, in groups of so many."""
        squares = np.einsum("ij,ij->j", C, C)
        X = self._projected(C)
        LX = self._plus(X, self._Q, self._downdated[1] @ self.by_block(self._Q, X))
        ends = pairwise(np.cumsum([0, *numbers]))
        slices = (np.s_[:, a:b] for a, b in ends)
        return [self._refit(X[g], LX[g], size[g[1]], float(squares[g[1]].sum())) for g in slices]

    def _refit(self, C: Array, LC: Array, size: Array, squares: float) -> Refit:
        """One group of projected columns C (rows, u), with L C; their squares before that."""
        values, V = np.linalg.eigh(C.T @ C)
        new = values > VISIBLE**2
        V = V[:, new] / np.sqrt(values[new])
        C, LC = C @ V, LC @ V
        r, u = self._residual[:, 0], V.shape[1]
        alpha = C.T @ r
        part_of = C @ alpha
        by = self.by_coordinate(2 * r * part_of - part_of**2)
        inside = self.by_block(C, np.column_stack([LC, self._errors[:, 0]]))
        inverse = linear.inverse(np.eye(u) - inside[:, :, :u])
        theta = inverse @ (alpha[:, None] - inside[:, :, u:])  # (blocks, u, 1)
        errors = self._plus(self._errors[:, :1], LC, -theta)[:, 0]
        loss = self.by_coordinate(errors**2)
        return Refit(
            (self.losses - loss).sum(axis=1),
            loss,
            V @ alpha / size,
            np.sqrt((V**2).sum(axis=1)) / size,
            by.sum(axis=0),
            float(np.sqrt(max(values.sum(), 0.0) / max(squares, 1e-300))),
            part_of / max(float(np.linalg.norm(part_of)), 1e-300),
        )


def _inner(a: np.ndarray, b: np.ndarray, u: int) -> np.ndarray:
    """aᵀb (n, u, u) of columns (m, n u) of n groups."""
    a, b = (x.reshape(len(x), x.shape[1] // u, u) for x in (a, b))
    return a.transpose(1, 2, 0) @ b.transpose(1, 0, 2)


def _turned(V: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Columns x (…, n u) of n groups times V (n, u, u)."""
    n, u = V.shape[:2]
    groups = np.moveaxis(x.reshape(*x.shape[:-1], n, u), -2, -3)
    return np.moveaxis(groups @ V, -3, -2).reshape(x.shape)


def _theta(
    s: np.ndarray, c: np.ndarray, Mp: np.ndarray, q: np.ndarray, inverse: np.ndarray
) -> np.ndarray:
    """θ₋k (n, u, R) without a block; s, c (n, u, R): C̃ᵀỹ of all blocks, of this one."""
    return inverse @ (s - c - (Mp.T @ q).reshape(c.shape))


def _fall(
    present: Index, theta: np.ndarray, x: np.ndarray, Z: np.ndarray, e: np.ndarray, qe: np.ndarray,
    a: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Fall of a block's left-out squares (n, R) in one coordinate: θᵀ(2 (Lc̃)ᵀe − (Lc̃)ᵀLc̃ θ).

    Groups `mine` have columns x (m, ·) there; of all of them Lc̃ = c − Q Z; `theta` (n, u, R);
    left-out errors e (m, R), `qe` = Qᵀe; a (n, u, u) = (Lc̃)ᵀLc̃.
    """
    c = -(Z.T @ qe).reshape(theta.shape)
    c[present] += (x.T @ e).reshape(len(present), *theta.shape[1:])
    return (theta * (2 * c - a @ theta)).sum(axis=1)
