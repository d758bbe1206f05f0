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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ident.information import linear
from ident.information.blocks import places
from ident.information.evidence import PARSIMONY
from ident.information.linear import Array, Index
from ident.information.projection import VISIBLE, Projection

AT_ONCE = 150  # work: columns of candidates whose gains are found at once, in a processor's cache
TOGETHER = 64  # work: columns that are projected at once
FEW = 2  # work: columns of a group of which all products are made
NUMBERS = 100_000  # work: of random series, by group and block, that are in memory at once


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
        return np.flatnonzero(by >= PARSIMONY * max(by.sum(), 1e-300)).tolist()


class PartialRegression(Projection):
    """Blocks of rows with a model projected out, and what candidates explain beside it."""

    def gains(self, groups: Sequence[Index]) -> Gains:
        """Return what each group of columns does by itself, everything refitted."""
        B = self.residual[0].shape[1] - 1
        D, by = np.zeros((len(groups), self.blocks)), np.zeros((len(groups), self.d))
        null, visible = np.zeros((len(groups), self.d, B)), np.zeros(len(groups))
        sizes = np.array([len(group) for group in groups])
        for alone, _, of_sets in self._parted_by_sets(groups):
            for u in np.unique(sizes[of_sets]):
                which = of_sets[sizes[of_sets] == u]
                for chosen in np.array_split(which, -(-len(which) * u // AT_ONCE)):
                    gains = alone._gains(np.array([groups[i] for i in chosen]))
                    D[chosen], by[chosen] = gains.D, gains.by
                    null[chosen], visible[chosen] = gains.null, gains.visible
        return Gains(D, by, null, visible)

    def visible(self, groups: Sequence[Index]) -> Array:
        """Return the shares (groups,) of the columns that the model does not have."""
        flat = np.concatenate(groups)
        inside, squares = np.zeros((self.rank, len(flat))), np.zeros(len(flat))
        for part, Q in zip(self.parts, self.Q, strict=True):
            present = np.flatnonzero(np.isin(flat, part.columns))
            X = self._taken(part, flat[present])
            inside[:, present] += Q.T @ X
            squares[present] += np.einsum("ij,ij->j", X, X)
        rest = squares - (inside**2).sum(axis=0)
        parts = np.split(rest, np.cumsum([len(group) for group in groups])[:-1])
        return np.sqrt(np.maximum([part.mean() for part in parts], 0.0))

    def _parted_by_sets(
        self, groups: Sequence[Index]
    ) -> Iterator[tuple[PartialRegression, np.ndarray, Index]]:
        """Yield the rows of some sets of coordinates by themselves, which of all rows they are, and
        the numbers of the groups that have any columns, all of them there.
        """
        present, by_sets = self.squares > 0, dict[tuple[int, ...], list[int]]()
        for i, group in enumerate(groups):
            if len(group):
                felt = np.flatnonzero(present[group].any(axis=0)) if self.sets[1:] else group[:0]
                by_sets.setdefault(self.sets_of(felt) or self.sets[:1], []).append(i)
        every = np.ones(len(self._Q), dtype=bool)
        for sets, numbers in by_sets.items():
            alone, rows = (self, every) if sets == self.sets else self.of_sets(sets)
            yield alone, rows, np.array(numbers)

    def _gains(self, groups: Index) -> Gains:
        """Return the gains of groups (n, u) of equal size, those of r_1 … r_B in single precision.

        Each block of each part meets its columns in one product with [Q ỹ e]. With p_k = Q_kᵀc_k,
        P = Σ p_k, G_k = Q_kᵀQ_k and M_k = (I − G_k)⁻¹, on columns for which C̃ᵀC̃ = I,

            L c̃_k = c_k − Q_k Z_k        Z_k = P − M_k (p_k − G_k P)
            θ₋k = (I − C̃ᵀL C̃ of block k)⁻¹ (s − c_kᵀỹ_k + Z_kᵀ Q_kᵀỹ_k)        s = C̃ᵀỹ
        """
        n, u = groups.shape
        G, M = self._downdated
        q, qe = self._inside_of_all, self._left_out_inside
        blocks, rank, B = self.blocks, self.rank, q.shape[2] - 1
        p, cc = np.zeros((blocks, n * u, rank)), np.zeros((blocks, n, u, u))
        cy, cn = np.zeros((blocks, n * u)), np.zeros((blocks, n * u, B), dtype=np.float32)
        terms = [self._terms(i, groups, p, cc, cy, cn) for i in range(len(self.parts))]
        P = p.sum(axis=0)
        GP = P @ G.sum(axis=0)
        # x̃_kᵀx̃_k = xᵀx − pᵀP − Pᵀp + PᵀGP
        cross = _inner(p, P[None], u)
        cc += _inner(GP, P[None], u) - cross - cross.swapaxes(-1, -2)
        p -= GP
        S = cc.sum(axis=0)
        values, V = (S[:, :, 0], np.ones_like(S)) if u == 1 else np.linalg.eigh(S)
        new = values > VISIBLE**2
        V = V * (new / np.sqrt(np.where(new, values, 1.0)))[:, None, :]
        # from here on columns x V, for which S = I
        single, Vt = V.astype(np.float32), V.swapaxes(-1, -2)
        p, P, cy = _combined(V, p), _combined(V, P[None])[0], _combined(V, cy[:, :, None])[:, :, 0]
        cn = _combined(single, cn)
        Mp = p @ M
        Z = P - Mp
        a1 = Vt @ cc @ V + _inner(p, Mp, u)
        idle = np.eye(u) * ~new[:, None, :]
        inverse = linear.inverse(np.eye(u) * new[:, None, :] - a1 + idle)
        # of b
        s = cy.sum(axis=0) - P @ q[:, :, 0].sum(axis=0)
        c = s - cy + (Z @ q[:, :, :1])[:, :, 0]
        theta = (inverse @ c.reshape(blocks, n, u, 1))[..., 0]
        D, by = np.zeros((n, blocks)), np.zeros((n, self.d))
        quadratic = np.empty((len(self.parts), blocks, n, u, u), dtype=np.float32)
        for i, (part, (present, x)) in enumerate(zip(self.parts, terms, strict=True)):
            a = _inner(Z @ G[i], Z, u)
            c = -(Z @ qe[i, :, :, :1]).reshape(blocks, n, u)
            if len(present):
                W = V[present]
                at = (present[:, None] * u + np.arange(u)).ravel()
                cross = _inner(_combined(W, x.p), Z[:, at], u)
                a[:, present] += W.swapaxes(-1, -2) @ x.squares @ W - cross - cross.swapaxes(-1, -2)
                c[:, present] += _combined(W, x.e[:, :, None]).reshape(blocks, len(present), u)
            fall = (theta * (2 * c - (a @ theta[..., None])[..., 0])).sum(axis=2)
            D += fall.T
            by[:, part.coordinate] += fall.sum(axis=0)
            quadratic[i] = a
        null = np.zeros((n, self.d, B), dtype=np.float32)
        if B:
            s = cn.sum(axis=0) - P.astype(np.float32) @ q[:, :, 1:].sum(axis=0).astype(np.float32)
            Z, inverse = Z.astype(np.float32), inverse.astype(np.float32)
            theta = np.empty((blocks, n, u, B), dtype=np.float32)
            fall = np.zeros((n, len(self.parts), B), dtype=np.float32)  # Σ_k θᵀ(2 c − a θ)
            step = max(1, NUMBERS // (n * u * (1 + len(self.parts)) * B))
            for first in range(0, blocks, step):
                k = slice(first, min(first + step, blocks))
                QZ = Z[k] @ self._random_inside[k]
                QZ = QZ.reshape(len(QZ), n, u, 1 + len(self.parts), B)
                theta[k] = _times(inverse[k], (s - cn[k]).reshape(-1, n, u, B) + QZ[..., 0, :])
                fall += np.einsum("knupb,knub->npb", QZ[..., 1:, :], theta[k])
            fall -= _quadratic(quadratic, theta)
            for i, (part, (present, x)) in enumerate(zip(self.parts, terms, strict=True)):
                c = _combined(single[present], x.random).reshape(blocks, len(present), u, B)
                fall[present, i] += np.einsum("knub,knub->nb", c, theta[:, present])
                null[:, part.coordinate] += fall[:, i]
        return Gains(D, by, null, np.sqrt(np.clip(values.sum(axis=1), 0.0, None) / u))

    def _terms(
        self, i: int, groups: Index, p: Array, cc: Array, cy: Array, cn: np.ndarray
    ) -> tuple[Index, BlockTerms]:
        """Return which groups (n, u) have columns in a part, and their products with its rows; p
        (blocks, n u, rank), cc (blocks, n, u, u), cy and cn (blocks, n u, …) grow by them.
        """
        part, blocks, (n, u) = self.parts[i], self.blocks, groups.shape
        at = places(part.columns, self.columns)[groups]
        present = np.flatnonzero((at >= 0).any(axis=1))
        X = part.at(at[present].ravel()) * self._factor(part)[groups[present].ravel()]
        columns = (present[:, None] * u + np.arange(u)).ravel()
        exact, random = self._sides[i]
        B = random.shape[1] // 2
        products = np.empty((blocks, len(columns), self.rank + 2))
        draws = np.empty((blocks, len(columns), 2 * B), dtype=np.float32)
        squares = np.empty((blocks, len(present), u, u))
        X_single = X.astype(np.float32) if B else X
        for k in range(blocks):
            rows = part.block(k)
            np.matmul(X[rows].T, exact[rows], out=products[k])
            if B:
                np.matmul(X_single[rows].T, random[rows], out=draws[k])
            x = X[rows].reshape(rows.stop - rows.start, len(present), u)
            squares[k] = (
                np.einsum("mn,mn->n", x[:, :, 0], x[:, :, 0])[:, None, None]
                if u == 1
                else x.transpose(1, 2, 0) @ x.transpose(1, 0, 2)
            )
        where = slice(None) if len(present) == n else columns  # a view, where it can be
        p[:, where] += products[:, :, :-2]
        cy[:, where] += products[:, :, -2]
        cn[:, where] += draws[:, :, :B]
        cc[:, present] += squares
        return present, BlockTerms(
            products[:, :, :-2], squares, products[:, :, -1], draws[:, :, B:]
        )

    @cached_property
    def _sides(self) -> list[tuple[Array, np.ndarray]]:
        """By part [Q ỹ e] of b, and [ỹ 2e] of r_1 … r_B in single precision."""
        sides = []
        for Q, Y, E in zip(self.Q, self.residual, self.errors, strict=True):
            random = np.hstack([Y[:, 1:], 2 * E[:, 1:]]).astype(np.float32)
            sides.append((np.hstack([Q, Y[:, :1], E[:, :1]]), random))
        return sides

    @cached_property
    def _left_out_inside(self) -> Array:
        """Qᵀe (parts, blocks, rank, 1 + B), as L = I + Q M Qᵀ."""
        G, M = self._downdated
        return np.asarray(self._inside + G @ (M @ self._inside_of_all))

    @cached_property
    def _inside_of_all(self) -> Array:
        """Qᵀỹ of all parts (blocks, rank, 1 + B)."""
        return np.asarray(self._inside.sum(axis=0))

    @cached_property
    def _random_inside(self) -> np.ndarray:
        """Qᵀỹ of all parts, then −2 Qᵀe of each (blocks, rank, (1 + parts) B), of r_1 … r_B."""
        both = np.concatenate([self._inside_of_all[None], -2 * self._left_out_inside])
        random = both[:, :, :, 1:].astype(np.float32).transpose(1, 2, 0, 3)
        return random.reshape(self.blocks, self.rank, random.shape[2] * random.shape[3])

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
        refits, numbers = dict[int, Refit](), [len(group) for group in groups]
        for alone, rows, of_sets in self._parted_by_sets(groups):
            parts = -(-sum(numbers[i] for i in of_sets) // TOGETHER)
            for chosen in np.array_split(of_sets, parts):
                flat = np.concatenate([groups[i] for i in chosen])
                C = np.concatenate([alone._taken(p, flat) for p in alone.parts])
                separate = alone._refits(C, self.size[flat], [numbers[i] for i in chosen])
                complete = [self._with_other_coordinates(x, alone, rows) for x in separate]
                refits |= zip(chosen.tolist(), complete, strict=True)
        return [refits[i] for i in range(len(groups))]

    def _with_other_coordinates(
        self, refit: Refit, alone: PartialRegression, rows: np.ndarray
    ) -> Refit:
        """Return a refit in some rows as one in all."""
        if alone is self:
            return refit
        direction = np.zeros(len(rows))
        direction[rows] = refit.direction
        return replace(refit, loss=self.losses - alone.losses + refit.loss, direction=direction)

    def refit_with(self, C: Sequence[Array]) -> Refit:
        """Columns C (m, u), one array a part, that are not among the candidates'."""
        X = [c * self.weight[p.coordinate] for p, c in zip(self.parts, C, strict=True)]
        size = np.linalg.norm(both := np.concatenate(X), axis=0)
        size = np.where(size > 0, size, 1.0)
        felt = [p.coordinate for p, c in zip(self.parts, C, strict=True) if c.any()]
        sets = self.sets_of(np.array(felt, dtype=np.intp)) or self.sets
        if sets == self.sets:
            return self._refits(both / size, size, [len(size)])[0]
        alone, rows = self.of_sets(sets)
        return self._with_other_coordinates(
            alone._refits(both[rows] / size, size, [len(size)])[0], alone, rows
        )

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


class BlockTerms(NamedTuple):
    """Products of the columns of some groups, N in all, with the rows of each block of a part."""

    p: Array  # (blocks, N, rank) with Q
    squares: Array  # (blocks, groups, u, u) with each other
    e: Array  # (blocks, N) with the left-out errors of b
    random: np.ndarray  # (blocks, N, B) twice those with the errors of r_1 … r_B


def _inner(a: np.ndarray, b: np.ndarray, u: int) -> np.ndarray:
    """Return a bᵀ (blocks, n, u, u) of n groups of rows a, b (blocks, n u, m)."""
    if u == 1:
        return np.einsum("knm,knm->kn", *np.broadcast_arrays(a, b))[:, :, None, None]
    a, b = (x.reshape(len(x), x.shape[1] // u, u, x.shape[2]) for x in (a, b))
    return np.asarray(a @ b.swapaxes(-1, -2))


def _combined(V: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return Vᵀx of rows x (blocks, n u, m) of n groups, V (n, u, u)."""
    n, u = V.shape[:2]
    if u == 1:
        return x * V[:, 0]
    groups = x.reshape(len(x), n, u, x.shape[2])
    return np.asarray((V.swapaxes(-1, -2) @ groups).reshape(x.shape))


def _quadratic(a: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return Σ_k xᵀa x (n, parts, B) of a (parts, k, n, u, u) and x (k, n, u, B)."""
    blocks, n, u, B = x.shape
    if u > FEW:
        return np.stack([np.einsum("knub,knub->nb", _times(A, x), x) for A in a], axis=1)
    products = x[:, :, :, None] * x[:, :, None]  # of all pairs
    by_group = products.transpose(1, 0, 2, 3, 4).reshape(n, blocks * u * u, B)
    return np.asarray(a.transpose(2, 0, 1, 3, 4).reshape(n, len(a), -1) @ by_group)


def _times(a: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return a x (…, u, B) of matrices a (…, u, u)."""
    return np.asarray(a * x if a.shape[-1] == 1 else a @ x)
