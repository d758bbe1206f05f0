"""Rows of blocks of time and coordinates with a model projected out, and errors of blocks left out.

X are the columns of the model and of all candidates, Y = [b | r_1 … r_B] measured torques, and
residuals that would be seen if nothing were missing. With the rows divided by the coordinates' σ,

    Q: orthonormal, spans the model's columns         Ỹ = Y − Q QᵀY
    L_k = (I − Q_k Q_kᵀ)⁻¹ of block k                   e_k = L_k Ỹ_k

e are the errors of blocks that were left out of all refits, without a single refit (block
downdating: Belsley, Kuh, Welsch, Regression Diagnostics, 1980).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Self

import numpy as np

from ident.information import linear
from ident.information.blocks import Information, Part
from ident.information.linear import Array, Index

RANK = 1e-8  # numerics: of unit columns' largest singular value: below, it is rounding
VISIBLE = 1e-4  # numerics: share of a column that must be new; squares of less are rounding
SURE = 1e-6  # numerics: of 1: where more is left of all directions, formulas in blocks are exact
ALONE = 1e-10  # numerics: of 1: less is left of a direction that one block alone determines
EXACT = 1e-6  # numerics: of the squares that a weight expects: what is below is explained


@dataclass(frozen=True, eq=False)
class Projection:
    """Blocks of rows with a model projected out."""

    parts: tuple[Part, ...]  # one a coordinate, or several
    model: Index  # (k,) columns of the model
    weight: Array  # (d,) 1/σ of each coordinate
    count: int = 0  # number of all columns, where the last ones may be zero in all parts

    @classmethod
    def of(
        cls, information: Information, weight: Array, model: Index, reference: Array | None = None
    ) -> Self:
        """Return the rows of some information, with a model projected out; all columns that are not
        the model's are candidates. Values `reference` (k,) of all columns are taken off first.
        """
        parts, times = [], information.times
        known = np.zeros(information.k) if reference is None else reference
        for u in range(information.d):
            of_coordinate = {(b.log, b.block): b for b in information if b.coordinate == u}
            if not of_coordinate:
                continue
            support = next(iter(of_coordinate.values())).support
            rows = [
                of_coordinate[t].triangle.stack()
                if t in of_coordinate
                else np.zeros((0, len(support) + 1))
                for t in times
            ]
            edges = np.cumsum([0, *map(len, rows)])
            both = np.concatenate(rows)
            y = both[:, -1] - both[:, :-1] @ known[support]
            parts.append(Part(u, support, both[:, :-1], y[:, None], edges))
        model, weight = np.asarray(model, dtype=np.intp), np.asarray(weight, dtype=float)
        return cls(tuple(parts), model, weight, information.k)

    @property
    def d(self) -> int:
        """Coordinates."""
        return len(self.weight)

    def place(self, columns: Index) -> int:
        """The coordinate in which some columns are; d if they are in several."""
        squares = self.squares[columns].sum(axis=0) * self.weight**2
        coordinates = np.flatnonzero(squares > VISIBLE * squares.sum())
        return int(coordinates[0]) if len(coordinates) == 1 else self.d

    @property
    def blocks(self) -> int:
        """Blocks of time."""
        return len(self.parts[0].edges) - 1

    @cached_property
    def columns(self) -> int:
        """All columns, the model's and the candidates'."""
        return max(self.count, *(1 + int(part.columns.max(initial=-1)) for part in self.parts))

    @cached_property
    def squares(self) -> Array:
        """(columns, d) squares of each column in each coordinate, unweighted."""
        sums = np.zeros((self.columns, self.d))
        for part in self.parts:
            sums[part.columns, part.coordinate] += part.squares
        return sums

    @cached_property
    def size(self) -> Array:
        """(columns,) weighted norms; 1 where a column is zero."""
        size = np.sqrt(self.squares @ self.weight**2)
        return np.where(size > 0, size, 1.0)

    @cached_property
    def _Q(self) -> Array:
        """Q (rows, rank), part after part."""
        k, pieces, triangles = len(self.model), [], [np.zeros((0, len(self.model)))]
        for part in self.parts:  # in a tree a coordinate has the columns of few bodies
            present = np.flatnonzero(np.isin(self.model, part.columns))
            A = self._taken(part, self.model[present])
            pieces.append((A, present))
            triangles.append(np.zeros((min(A.shape), k)))
            triangles[-1][:, present] = np.linalg.qr(A, mode="r")
        R = np.concatenate(triangles)
        if not k or not R.any():
            return np.zeros((int(self.cells.max()), 0))
        _, s, Vt = linear.svd(np.asarray(np.linalg.qr(R, mode="r")), full_matrices=False)
        good = s > RANK * s[0]
        T = Vt[good].T / s[good]
        Q = np.concatenate([A @ T[present] for A, present in pieces])
        for _ in range(2):  # what rounding leaves of QᵀQ − I goes
            Q = Q @ np.linalg.inv(np.linalg.cholesky(Q.T @ Q)).T
        return Q

    @property
    def Q(self) -> tuple[Array, ...]:
        """Q (m, rank) of every part."""
        return self._parted(self._Q)

    def _parted(self, x: Array) -> tuple[Array, ...]:
        return tuple(np.split(x, self.cells[1:, 0, 0]))

    def _factor(self, part: Part) -> Array:
        return self.weight[part.coordinate] / self.size

    def _taken(self, part: Part, columns: Index) -> Array:
        return part.taken(columns) * self._factor(part)[columns]

    @cached_property
    def _factors(self) -> Array:
        """K (rank, k) of the model's columns, weighted and of unit size, Q K."""
        columns = ((Q, self._taken(p, self.model)) for p, Q in zip(self.parts, self.Q, strict=True))
        return np.asarray(sum(Q.T @ A for Q, A in columns))

    @property
    def rank(self) -> int:
        """Rank of the model."""
        return self._Q.shape[1]

    def _projected(self, x: Array) -> Array:
        for _ in range(2):  # twice: what is left may be tiny
            x = x - self._Q @ (self._Q.T @ x)
        return x

    @cached_property
    def _residual(self) -> Array:
        """Ỹ (rows, 1 + B), weighted, part after part."""
        Y = np.concatenate([part.Y * self.weight[part.coordinate] for part in self.parts])
        b = self._projected(Y[:, :1])
        Y -= self._Q @ (self._Q.T @ Y)
        return np.hstack([b, Y[:, 1:]])

    @property
    def residual(self) -> tuple[Array, ...]:
        """Ỹ (m, 1 + B) of every part, weighted."""
        return self._parted(self._residual)

    @cached_property
    def _downdated(self) -> tuple[Array, Array]:
        """QᵀQ (parts, blocks, rank, rank), and by block M = (I − G)⁻¹, G = QᵀQ of all parts."""
        G = self.by_part(self._Q, self._Q)
        return G, linear.inverse(np.eye(self.rank) - G.sum(axis=0), ALONE)

    @cached_property
    def _inside(self) -> Array:
        """QᵀỸ (parts, blocks, rank, 1 + B)."""
        return self.by_part(self._Q, self._residual)

    @cached_property
    def _errors(self) -> Array:
        """L Ỹ (rows, 1 + B): the errors of blocks that were left out."""
        if not self.sets[1:]:
            w = self._downdated[1] @ self._inside.sum(axis=0)
            return self._plus(self._residual, self._Q, w)
        errors = np.empty_like(self._residual)
        for alone, rows in (self.of_sets((number,)) for number in self.sets):
            errors[rows] = alone._errors
        return errors

    @property
    def errors(self) -> tuple[Array, ...]:
        """L Ỹ (m, 1 + B) of every part."""
        return self._parted(self._errors)

    @cached_property
    def _set_of_coordinate(self) -> Index:
        """(d,) the first of the coordinates that share a column of the model with each, or with one
        that does: rows of other sets have nothing to do with its own.
        """
        first = np.arange(self.d)
        for felt in np.unique(self.squares[self.model] > 0, axis=0):
            same = np.isin(first, first[felt])
            first[same] = first[same].min(initial=self.d)
        return first

    @cached_property
    def sets(self) -> tuple[int, ...]:
        """The sets of coordinates that have rows."""
        return self.sets_of(np.array([part.coordinate for part in self.parts]))

    def sets_of(self, coordinates: Index) -> tuple[int, ...]:
        """Return the sets to which some coordinates belong."""
        return tuple(np.unique(self._set_of_coordinate[coordinates]).tolist())

    @cached_property
    def _by_sets(self) -> dict[tuple[int, ...], tuple[Self, np.ndarray]]:
        """What `of_sets` has returned."""
        return {}

    def of_sets(self, sets: tuple[int, ...]) -> tuple[Self, np.ndarray]:
        """Return the rows of some sets of coordinates by themselves, with what is projected out
        there, and which of all rows (rows,) they are.
        """
        if sets not in self._by_sets:
            within = np.isin(self._set_of_coordinate, sets)
            inside = np.array([within[part.coordinate] for part in self.parts])
            rows = np.repeat(inside, [len(part.X) for part in self.parts])
            present = (self.squares[self.model][:, within] > 0).any(axis=1)
            parts = tuple(part for part, chosen in zip(self.parts, inside, strict=True) if chosen)
            alone, Q = replace(self, parts=parts, model=self.model[present]), self._Q[rows]
            values, V = np.linalg.eigh(Q.T @ Q)  # ones, and zeros of other sets
            vars(alone).update(_Q=Q @ V[:, values > 0.5], _residual=self._residual[rows])
            vars(alone).update(squares=self.squares, size=self.size, columns=self.columns)
            self._by_sets[sets] = alone, rows
        return self._by_sets[sets]

    def _plus(self, x: Array, A: Array, w: Array) -> Array:
        """x + A w (rows, …), with w (blocks, …) of each block."""
        out = x.copy()
        for part in self.cells.tolist():
            for k, (a, b) in enumerate(part):
                out[a:b] += A[a:b] @ w[k]
        return out

    @cached_property
    def null_losses(self) -> Array:
        """(d, B) left-out squares of r_1 … r_B in each coordinate, all blocks together."""
        sums = np.zeros((self.d, self._errors.shape[1] - 1))
        for part, e in zip(self.parts, self.errors, strict=True):
            sums[part.coordinate] += np.einsum("ij,ij->j", e[:, 1:], e[:, 1:])
        return sums

    def explained(self, fall: Array, before: Array | None = None) -> Array:
        """Return the shares g that falls (…, d) of left-out squares `before` explain, or of b's."""
        before = self.losses.sum(axis=0) if before is None else before
        n, least = self.rows, EXACT * np.maximum(self.rows, 1.0)
        after = np.maximum(before - fall, 0.0)
        return np.asarray(-np.expm1(np.log((after + least) / (before + least)) @ n / n.sum()))

    def explained_by_coordinate(self, fall: Array, before: Array | None = None) -> Array:
        """Return the shares (…, d) of each coordinate; see `explained`."""
        before = self.losses.sum(axis=0) if before is None else before
        least = EXACT * np.maximum(self.rows, 1.0)
        return np.asarray(1 - (np.maximum(before - fall, 0.0) + least) / (before + least))

    @cached_property
    def cells(self) -> Index:
        """(parts, blocks, 2) first and last of the rows of each block, part after part."""
        first = np.cumsum([0, *(len(part.X) for part in self.parts)])
        edges = np.stack([part.edges + a for part, a in zip(self.parts, first, strict=False)])
        return np.stack([edges[:, :-1], edges[:, 1:]], axis=2)

    def by_part(self, x: Array, y: Array) -> Array:
        """Return xᵀy (parts, blocks, u, v) of each block of each part; x, y (rows, …)."""
        cells = self.cells.tolist()
        return np.array([[x[a:b].T @ y[a:b] for a, b in part] for part in cells])

    def by_block(self, x: Array, y: Array) -> Array:
        """Return xᵀy (blocks, u, v) of each block; x, y (rows, …)."""
        return np.asarray(self.by_part(x, y).sum(axis=0))

    def by_coordinate(self, x: Array) -> Array:
        """(blocks, d) sums of x (rows,)."""
        first, last = self.cells.reshape(-1, 2).T
        sums = np.add.reduceat(np.append(x, 0.0), first) * (last > first)
        table = np.zeros((self.blocks, self.d))
        for part, of_part in zip(self.parts, sums.reshape(-1, self.blocks), strict=True):
            table[:, part.coordinate] += of_part
        return table

    @cached_property
    def rows(self) -> Array:
        """(d,) rows of each coordinate."""
        return self.by_coordinate(np.ones(int(self.cells.max()))).sum(axis=0)

    @cached_property
    def losses(self) -> Array:
        """(blocks, d) left-out squares with the model as it is."""
        return self.by_coordinate(self._errors[:, 0] ** 2)

    @property
    def loss(self) -> Array:
        """(blocks,) left-out squares of b with the model as it is."""
        return self.losses.sum(axis=1)

    def extended(self, columns: Index) -> Self:
        """The same rows with further columns in the model.

        What is projected already stays: with q orthonormal, spanning what the columns C have that
        the model does not, Q' = [Q q] and Ỹ' = Ỹ − q qᵀỸ.
        """
        extended = replace(self, model=np.append(self.model, columns))
        if "_residual" not in vars(self):
            return extended
        taken = np.concatenate([self._taken(part, columns) for part in self.parts])
        q, R = np.linalg.qr(self._projected(taken))
        U, s, _ = linear.svd(R)
        q = np.linalg.qr(self._projected(q @ U[:, s > RANK * np.sqrt(len(extended.model))]))[0]
        residual = self._residual - q @ (q.T @ self._residual)
        if "_factors" in vars(self):
            below = np.zeros((q.shape[1], len(self.model)))
            K = np.block([[self._factors, self._Q.T @ taken], [below, q.T @ taken]])
            vars(extended).update(_factors=K)
        return extended._with(np.hstack([self._Q, q]), residual, self, columns)

    def without(self, columns: Index) -> Self:
        """The same rows without some of the model's columns A.

        What is projected already stays: the left singular vectors U of Qᵀ times the columns that
        are left turn Q into Q' and the removed column q, so that Ỹ' = Ỹ + q qᵀY.
        """
        stays = ~np.isin(self.model, columns)
        reduced = replace(self, model=self.model[stays])
        if "_residual" not in vars(self):
            return reduced
        K = self._factors[:, stays]
        U, rank = _left_vectors(K)
        U, V = U[:, :rank], U[:, rank:]
        q = self._Q @ V
        both = zip(self.parts, self._parted(q), strict=True)
        qY = np.sum([self.weight[p.coordinate] * q_part.T @ p.Y for p, q_part in both], axis=0)
        vars(reduced).update(_factors=U.T @ K)
        return reduced._with(self._Q @ U, self._residual + q @ qY, self, columns)

    def losses_without(self, columns: Index) -> Array:
        """Return the left-out squares (blocks, d) without some of the model's columns.

        With q (rows, u) what these alone span, c = qᵀY, and θ_k = (I + q_kᵀL_k q_k)⁻¹ q_kᵀL_k r'_k,

            r' = r + q c        L'_k r'_k = L_k r'_k − L_k q_k θ_k        (Sherman, Morrison)
        """
        if not self._sure:
            return self.without(columns).losses
        M, q = self._downdated[1], self._Q @ self._spanned_by(columns)
        w = M @ self.by_block(self._Q, q)
        Lq, y = self._plus(q, self._Q, w), self._targets
        e = self._errors[:, :1] + Lq @ (q.T @ y)
        both = self.by_block(q, np.hstack([Lq, e]))
        D, h = both[:, :, :-1], both[:, :, -1:]
        theta = linear.inverse(np.eye(q.shape[1]) + D, 0.0) @ h
        return self.by_coordinate(self._plus(e, Lq, -theta)[:, 0] ** 2)

    @cached_property
    def _sure(self) -> bool:
        """Whether no block alone determines a direction of the model."""
        G = self._downdated[0].sum(axis=0)
        try:
            np.linalg.cholesky((1 - SURE) * np.eye(self.rank) - G)
        except np.linalg.LinAlgError:
            return False
        return True

    @cached_property
    def _targets(self) -> Array:
        """b (rows, 1), weighted."""
        return np.concatenate([p.Y[:, :1] * self.weight[p.coordinate] for p in self.parts])

    def _spanned_by(self, columns: Index) -> Array:
        """Return V (rank, u), orthonormal: Q V spans what only some of the model's columns do."""
        key = columns.tobytes()
        if key not in self._spans:
            U, rank = _left_vectors(self._factors[:, ~np.isin(self.model, columns)])
            self._spans[key] = U[:, rank:]
        return self._spans[key]

    @cached_property
    def _spans(self) -> dict[bytes, Array]:
        """What `_spanned_by` has returned, by columns; of the same rows in any order."""
        return {}

    def _with(self, Q: Array, residual: Array, rows: Self, changed: Index) -> Self:
        """The same with what is projected, and with what only the rows decide, and the sets of
        coordinates that do not have the columns in which both models differ.
        """
        vars(self).update(_Q=Q, _residual=residual, cells=rows.cells, size=rows.size)
        vars(self).update(squares=rows.squares, columns=rows.columns)
        other = {*rows.sets_of(np.flatnonzero(rows.squares[changed].any(axis=0)))}
        same = {sets: x for sets, x in rows._by_sets.items() if not other & {*sets}}
        vars(self).update(_by_sets=same)
        return self

    def added(self, C: Sequence[Array]) -> tuple[Self, Index]:
        """The same rows with further candidates C (m, u), one array a part, and which they are."""
        new = self.columns + np.arange(C[0].shape[1])
        felt = [c.any(axis=0) for c in C]  # most of many act on one coordinate
        pairs = zip(self.parts, C, felt, strict=True)
        parts = (part.added(c if at.all() else c[:, at], new[at]) for part, c, at in pairs)
        return self.with_candidates(tuple(parts), int(new[-1]) + 1), new

    def with_candidates(self, parts: tuple[Part, ...], count: int) -> Self:
        """The same rows in `parts` with further candidates, `count` columns in all."""
        added = replace(self, parts=parts, count=count)
        recomputed = {"columns", "squares", "size", "_by_sets"}
        recomputed |= {field.name for field in fields(self)}
        vars(added).update({name: x for name, x in vars(self).items() if name not in recomputed})
        return added

    def weighted(self, weight: Array) -> Self:
        """The same rows with other weights."""
        return replace(self, weight=np.asarray(weight, dtype=float))

    def with_targets(self, Y: Sequence[Array]) -> Self:
        """The same rows with other right-hand sides Y (m, 1 + B), one a part."""
        parts = zip(self.parts, Y, strict=True)
        replaced = replace(self, parts=tuple(replace(part, Y=y) for part, y in parts))
        vars(replaced).update(_Q=self._Q, squares=self.squares, cells=self.cells)  # of X
        of_columns = ("_downdated", "_factors")
        vars(replaced).update({name: x for name, x in vars(self).items() if name in of_columns})
        return replaced

    def in_order(self, parts: Sequence[Part], order: Index) -> Self:
        """Return the rows of b in another `order` (rows,), in `parts` without columns, which have
        blocks of their own; the model is as it is projected.
        """
        ordered = replace(self, parts=tuple(parts), count=self.columns)
        vars(ordered).update(_Q=self._Q[order], _residual=self._residual[order, :1])
        vars(ordered).update(_factors=self._factors, squares=self.squares, size=self.size)
        vars(ordered).update(_spans=self._spans)
        return ordered

    @property
    def bare(self) -> Self:
        """The same rows without r_1 … r_B."""
        return self.with_targets([part.Y[:, :1] for part in self.parts])

    @property
    def solved(self) -> tuple[Array, Array]:
        """θ (k,) of the model's columns and (XᵀX)⁻¹ (k, k), weighted; of the smallest norm."""
        b = np.concatenate([p.Y[:, 0] * self.weight[p.coordinate] for p in self.parts])
        # of a factor, not of normal equations: no variance is negative then
        root = linear.pinv(self._factors, rcond=RANK**0.5) / self.size[self.model][:, None]
        return root @ (self._Q.T @ b), root @ root.T


def _left_vectors(K: Array) -> tuple[Array, int]:
    """Return the left singular vectors (rank, rank) of K (rank, k), those of its own rank first,
    and this rank.
    """
    R = np.asarray(np.linalg.qr(K.T, mode="r"))
    U, s, _ = linear.svd(R.T)  # that has no more columns than rows
    return U, int((s > RANK * s.max(initial=0.0)).sum())
