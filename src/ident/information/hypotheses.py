"""Which columns explain what a model leaves, everything else refitted, by blocks of time left out.

Rows (or triangles) of blocks of time and coordinates hold X = [A | C] and Y = [b | r_1 … r_B]:
columns of the model and of all candidates, measured torques, and residuals that would be seen if
nothing were missing. With the rows divided by the coordinates' σ,

    Q: orthonormal, spans A          x̃ = x − Q Qᵀx          L_k = (I − Q_k Q_kᵀ)⁻¹ of block k
    S₋k(x, y) = x̃ᵀỹ − x̃_kᵀ L_k ỹ_k          θ₋k = S₋k(C, C)⁻¹ S₋k(C, b)
    e_k = L_k b̃_k − L_k C̃_k θ₋k              D_k = |L_k b̃_k|² − |e_k|²          G = Σ_k D_k

are the errors of blocks that were left out of all refits, without a single refit: partial
regression (Frisch, Waugh, Lovell) with block downdating (Belsley, Kuh, Welsch, Regression
Diagnostics, 1980). Coordinates have noise of their own: with left-out squares L_u of n_u rows
before and L'_u after, N rows in all, the likelihood ratio of normal errors gives the share

    g = 1 − Π_u (L'_u / L_u)^(n_u / N)

The largest g over all candidates on r_1 … r_B is the null distribution of the largest g on b
(Westfall, Young, Resampling-Based Multiple Testing, 1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ident.information import linear
from ident.information.blocks import Information, Part, columns_at, places
from ident.information.linear import Array, Index

RANK = 1e-8  # of the largest singular value of unit columns: below, a direction is rounding
VISIBLE = 1e-4  # share of a column that must be new; squares of less are rounding
TOGETHER = 64  # columns that are projected at once
EXACT = 1e-6  # of the squares that a coordinate's weight expects: what is below is explained


@dataclass(frozen=True, eq=False)
class Gains:
    """The changes of the left-out squared error by groups of columns.

    Attributes:
        D: (groups, blocks) by how much the left-out squares of b fall.
        by: (groups, d) the same by coordinate.
        null: (groups, d, B) fall of the left-out squares of r_1 … r_B by coordinate.
        visible: (groups,) share of the columns that the model does not have.
    """

    D: Array
    by: Array
    null: Array
    visible: Array

    @property
    def G(self) -> Array:
        """(groups,) total fall."""
        return self.D.sum(axis=1)


@dataclass(frozen=True, eq=False)
class Refit:
    """One group of columns, everything refitted.

    Attributes:
        D: (blocks,) fall of the left-out squares.
        loss: (blocks, d) left-out squares with the group.
        theta, stderr: (u,) coefficients from all rows and their standard errors at unit noise.
        by: (d,) in-sample fall of the squares in each coordinate.
        visible: share of the columns that the model does not have.
        direction: (rows,) of C̃ θ, of unit length.
    """

    D: Array
    loss: Array
    theta: Array
    stderr: Array
    by: Array
    visible: float
    direction: Array

    @property
    def G(self) -> float:
        """Total fall."""
        return float(self.D.sum())


@dataclass(frozen=True, eq=False)
class PartialRegression:
    """Blocks of rows with a model projected out.

    Attributes:
        parts: one a coordinate, or several.
        model: (k,) columns of the model.
        weight: (d,) 1/σ of each coordinate.
        count: number of all columns, where the last ones may be zero in all parts.
    """

    parts: tuple[Part, ...]
    model: Index
    weight: Array
    count: int = 0

    @classmethod
    def of(
        cls, information: Information, weight: Array, model: Index, reference: Array | None = None
    ) -> PartialRegression:
        """The question which columns explain some information beside the model's.

        Args:
            information: in all columns, the model's and the candidates'.
            weight: (d,) 1/σ of each coordinate.
            model: columns that are refitted whatever is asked; the others are candidates.
            reference: (k,) values of all columns that are taken off first, as a reference that is
                known: what is left is b − X reference.
        """
        parts = []
        times = information.times
        for u in range(information.d):
            mine = {(b.log, b.block): b for b in information if b.coordinate == u}
            if not mine:
                continue
            support = next(iter(mine.values())).support
            known = np.zeros(information.k) if reference is None else reference
            rows = [
                mine[t].triangle.stack() if t in mine else np.zeros((0, len(support) + 1))
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
        mine = np.flatnonzero(squares > VISIBLE * squares.sum())
        return int(mine[0]) if len(mine) == 1 else self.d

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
        found = np.zeros((self.columns, self.d))
        for part in self.parts:
            found[part.columns, part.coordinate] += np.einsum("ij,ij->j", part.X, part.X)
        return found

    @cached_property
    def size(self) -> Array:
        """(columns,) weighted norms; 1 where a column is zero."""
        size = np.sqrt(self.squares @ self.weight**2)
        return np.where(size > 0, size, 1.0)

    @cached_property
    def Q(self) -> tuple[Array, ...]:
        """Q (m, rank) of every part."""
        k, mine, triangles = len(self.model), [], [np.zeros((0, len(self.model)))]
        for part in self.parts:  # in a tree a coordinate has the columns of few bodies
            own = np.flatnonzero(np.isin(self.model, part.columns))
            A = self._taken(part, self.model[own])
            mine.append((A, own))
            triangles.append(np.zeros((min(A.shape), k)))
            triangles[-1][:, own] = np.linalg.qr(A, mode="r")
        R = np.concatenate(triangles)
        if not k or not R.any():
            return tuple(np.zeros((len(part.X), 0)) for part in self.parts)
        _, s, Vt = linear.svd(np.asarray(np.linalg.qr(R, mode="r")), full_matrices=False)
        good = s > RANK * s[0]
        T = Vt[good].T / s[good]
        Q = [A @ T[own] for A, own in mine]
        for _ in range(2):  # what rounding leaves of QᵀQ − I goes
            T = np.linalg.inv(np.linalg.cholesky(sum(q.T @ q for q in Q))).T
            Q = [q @ T for q in Q]
        return tuple(Q)

    def _factor(self, part: Part) -> Array:
        return self.weight[part.coordinate] / self.size

    def _taken(self, part: Part, columns: Index) -> Array:
        return part.taken(columns) * self._factor(part)[columns]

    @property
    def rank(self) -> int:
        """Rank of the model."""
        return self.Q[0].shape[1]

    @cached_property
    def residual(self) -> tuple[Array, ...]:
        """Ỹ (m, 1 + B) of every part, weighted."""
        Y = [part.Y * self.weight[part.coordinate] for part in self.parts]
        for _ in range(2):
            total = sum(q.T @ y for q, y in zip(self.Q, Y, strict=True))
            Y = [y - q @ total for q, y in zip(self.Q, Y, strict=True)]
        return tuple(Y)

    @cached_property
    def _block(self) -> tuple[Array, ...]:
        """By block G = QᵀQ, M = (I − G)⁻¹ (blocks, rank, rank) and QᵀỸ (blocks, rank, 1 + B)."""
        n, rank = self.blocks, self.rank
        G = np.zeros((n, rank, rank))
        q = np.zeros((n, rank, self.residual[0].shape[1]))
        for part, Q, Y in zip(self.parts, self.Q, self.residual, strict=True):
            for k in range(n):
                rows = part.block(k)
                G[k] += Q[rows].T @ Q[rows]
                q[k] += Q[rows].T @ Y[rows]
        M: Array = linear.pinv(np.eye(rank) - G, rcond=1e-10, hermitian=True)
        return G, M, q

    @cached_property
    def null_losses(self) -> Array:
        """(d, B) left-out squares of r_1 … r_B in each coordinate, all blocks together."""
        _, M, q = self._block
        found = np.zeros((self.d, q.shape[2] - 1))
        for part, Q, Y in zip(self.parts, self.Q, self.residual, strict=True):
            for k in range(self.blocks):
                rows = part.block(k)
                e = Y[rows, 1:] + Q[rows] @ (M[k] @ q[k, :, 1:])
                found[part.coordinate] += np.einsum("ij,ij->j", e, e)
        return found

    def explained(self, fall: Array, before: Array | None = None) -> Array:
        """Return the shares g that falls (…, d) of left-out squares explain.

        Args:
            before: (…, d) squares that fall; without it, those of b.
        """
        before = self.losses.sum(axis=0) if before is None else before
        n, least = self.rows, EXACT * np.maximum(self.rows, 1.0)
        after = np.maximum(before - fall, 0.0)
        return np.asarray(-np.expm1(np.log((after + least) / (before + least)) @ n / n.sum()))

    @cached_property
    def left_out(self) -> Array:
        """L b̃ (rows,), part after part: the errors of blocks that were left out."""
        return np.concatenate(self._left_out([y[:, :1] for y in self.residual]))[:, 0]

    def _left_out(self, X: Sequence[Array]) -> list[Array]:
        """L x̃ of projected columns."""
        M, out = self._block[1], [x.copy() for x in X]
        for k in range(self.blocks):
            rows = [part.block(k) for part in self.parts]
            q = sum(Q[i].T @ x[i] for Q, x, i in zip(self.Q, X, rows, strict=True))
            for Q, x, i in zip(self.Q, out, rows, strict=True):
                x[i] += Q[i] @ (M[k] @ q)
        return out

    @cached_property
    def cells(self) -> Index:
        """(parts, blocks, 2) first and last of the rows of each block, part after part."""
        first = np.cumsum([0, *(len(part.X) for part in self.parts)])
        edges = np.stack([part.edges + a for part, a in zip(self.parts, first, strict=False)])
        return np.stack([edges[:, :-1], edges[:, 1:]], axis=2)

    def by_block(self, x: Array, y: Array) -> Array:
        """Return xᵀy (blocks, u, v) of each block; x, y (rows, …)."""
        found = np.zeros((self.blocks, x.shape[1], y.shape[1]))
        for part in self.cells.tolist():
            for k, (a, b) in enumerate(part):
                found[k] += x[a:b].T @ y[a:b]
        return found

    def by_coordinate(self, x: Array) -> Array:
        """(blocks, d) sums of x (rows,)."""
        first, last = self.cells.reshape(-1, 2).T
        sums = np.add.reduceat(np.append(x, 0.0), first) * (last > first)
        found = np.zeros((self.blocks, self.d))
        for part, own in zip(self.parts, sums.reshape(-1, self.blocks), strict=True):
            found[:, part.coordinate] += own
        return found

    @cached_property
    def rows(self) -> Array:
        """(d,) rows of each coordinate."""
        return self.by_coordinate(np.ones(int(self.cells.max()))).sum(axis=0)

    @cached_property
    def losses(self) -> Array:
        """(blocks, d) left-out squares with the model as it is."""
        return self.by_coordinate(self.left_out**2)

    @property
    def loss(self) -> Array:
        """(blocks,) left-out squares of b with the model as it is."""
        return self.losses.sum(axis=1)

    # --- candidates ----------------------------------------------------------------------------

    def gains(self, groups: Sequence[Index]) -> Gains:
        """Return what each group of columns does by itself, everything refitted."""
        B = self.residual[0].shape[1] - 1
        D, by = np.zeros((len(groups), self.blocks)), np.zeros((len(groups), self.d))
        null, visible = np.zeros((len(groups), self.d, B)), np.zeros(len(groups))
        sizes = np.array([len(group) for group in groups])
        for u in np.unique(sizes[sizes > 0]):
            which = np.flatnonzero(sizes == u)
            for some in np.array_split(which, -(-len(which) * u // 600)):
                found = self._gains(np.array([groups[i] for i in some]))
                D[some], by[some] = found.D, found.by
                null[some], visible[some] = found.null, found.visible
        return Gains(D, by, null, visible)

    def _gains(self, groups: Index) -> Gains:
        """Gains of groups (n, u) of equal size, those of r_1 … r_B in single precision."""
        n, u = groups.shape
        G, M, q = self._block
        blocks, rank, B = self.blocks, self.rank, q.shape[2] - 1
        p = np.zeros((blocks, rank, n * u))
        cc = np.zeros((blocks, n, u, u))
        cy = np.zeros((blocks, n * u, 1))
        cn = np.zeros((blocks, n * u, B), dtype=np.float32)
        for part, Q, Y in zip(self.parts, self.Q, self.residual, strict=True):
            mine, X = self._columns_of(part, groups)
            if not len(mine):
                continue
            place = (mine[:, None] * u + np.arange(u)).ravel()
            r = Y[:, 1:].astype(np.float32)
            where = slice(None) if len(place) == n * u else place  # a view, where it can be
            for k in range(blocks):
                rows = part.block(k)
                x = X[rows]
                p[k][:, where] += Q[rows].T @ x
                cy[k][where] += x.T @ Y[rows, :1]
                if B:
                    cn[k][where] += x.astype(np.float32).T @ r[rows]
                cc[k, mine] += _inner(x, x, u)
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
        for part, Q, Y in zip(self.parts, self.Q, self.residual, strict=True):
            mine, X = self._columns_of(part, groups)
            for k in range(blocks):
                rows = part.block(k)
                e = Y[rows] + Q[rows] @ (M[k] @ q[k])
                x = _turned(V[mine], X[rows])
                GZ = (Q[rows].T @ Q[rows]) @ Z[k]
                a = _inner(Z[k], GZ, u)
                own = Z[k].reshape(rank, n, u)[:, mine].reshape(rank, len(mine) * u)
                cross = _inner(Q[rows].T @ x, own, u)
                a[mine] += _inner(x, x, u) - cross - cross.transpose(0, 2, 1)
                qe = Q[rows].T @ e
                fall = _fall(mine, cy[k], x, Z[k], e[:, :1], qe[:, :1], a)[:, 0]
                D[:, k] += fall
                by[:, part.coordinate] += fall
                if B:
                    single = (cn[k], x, Z[k], e[:, 1:], qe[:, 1:], a)
                    null[:, part.coordinate] += _fall(mine, *(y.astype(np.float32) for y in single))
        return Gains(D, by, null, np.sqrt(np.clip(values.sum(axis=1), 0.0, None) / u))

    def _columns_of(self, part: Part, groups: Index) -> tuple[Index, Array]:
        """Which groups (n, u) have columns in a part, and those (m, ·), weighted."""
        at = places(part.columns, self.columns)[groups]
        mine = np.flatnonzero((at >= 0).any(axis=1))
        return mine, columns_at(part.X, at[mine].ravel()) * self._factor(part)[groups[mine].ravel()]

    def gain(self, refit: Refit) -> float:
        """Return the share g that a group of columns explains."""
        return float(self.explained((self.losses - refit.loss).sum(axis=0)))

    def refit(self, columns: Index) -> Refit:
        """One group of columns in detail."""
        return self.refits([columns])[0]

    def refits(self, groups: Sequence[Index]) -> list[Refit]:
        """Groups of columns in detail, each by itself."""
        found, numbers = list[Refit](), [len(group) for group in groups]
        for some in np.array_split(np.arange(len(groups)), -(-sum(numbers) // TOGETHER) or 1):
            if not len(some):
                continue
            flat = np.concatenate([groups[i] for i in some])
            C = [self._taken(p, flat) for p in self.parts]
            found += self._refits(C, self.size[flat], [numbers[i] for i in some])
        return found

    def refit_with(self, C: Sequence[Array]) -> Refit:
        """Columns C (m, u), one array a part, that are not among the candidates'."""
        C = [c * self.weight[p.coordinate] for p, c in zip(self.parts, C, strict=True)]
        size = np.sqrt(sum((c**2).sum(axis=0) for c in C))
        size = np.where(size > 0, size, 1.0)
        return self._refits([c / size for c in C], size, [len(size)])[0]

    def _refits(self, C: list[Array], size: Array, numbers: Sequence[int]) -> list[Refit]:
        """Columns C side by side, in groups of so many."""
        squares = sum(np.einsum("ij,ij->j", c, c) for c in C)
        for _ in range(2):  # twice: what is left may be tiny
            P = sum(q.T @ c for q, c in zip(self.Q, C, strict=True))
            C = [c - q @ P for q, c in zip(self.Q, C, strict=True)]
        X, LX = np.concatenate(C), np.concatenate(self._left_out(C))
        return [
            self._refit(X[:, a:b], LX[:, a:b], size[a:b], float(squares[a:b].sum()))
            for a, b in pairwise(np.cumsum([0, *numbers]))
        ]

    def _refit(self, C: Array, LC: Array, size: Array, squares: float) -> Refit:
        """One group of projected columns C (rows, u), with L C; their squares before that."""
        values, V = np.linalg.eigh(C.T @ C)
        new = values > VISIBLE**2
        V = V[:, new] / np.sqrt(values[new])
        C, LC = C @ V, LC @ V
        r, u = np.concatenate([y[:, 0] for y in self.residual]), V.shape[1]
        alpha = C.T @ r
        part_of = C @ alpha
        by = self.by_coordinate(2 * r * part_of - part_of**2)
        inside = self.by_block(C, np.column_stack([LC, self.left_out]))
        inverse = linear.inverse(np.eye(u) - inside[:, :, :u])
        theta = inverse @ (alpha[:, None] - inside[:, :, u:])  # (blocks, u, 1)
        errors = self.left_out.copy()
        for part in self.cells.tolist():
            for k, (a, b) in enumerate(part):
                errors[a:b] -= LC[a:b] @ theta[k, :, 0]
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

    def extended(self, columns: Index) -> PartialRegression:
        """The same rows with further columns in the model."""
        return replace(self, model=np.append(self.model, columns))

    def without(self, columns: Index) -> PartialRegression:
        """The same rows without some of the model's columns."""
        return replace(self, model=self.model[~np.isin(self.model, columns)])

    def weighted(self, weight: Array) -> PartialRegression:
        """The same rows with other weights."""
        return replace(self, weight=np.asarray(weight, dtype=float))

    def judging(self, Y: Sequence[Array]) -> PartialRegression:
        """The same rows with other right-hand sides Y (m, 1 + B), one a part."""
        parts = zip(self.parts, Y, strict=True)
        return replace(self, parts=tuple(replace(part, Y=y) for part, y in parts))

    @property
    def solved(self) -> tuple[Array, Array]:
        """θ (k,) of the model's columns and (XᵀX)⁻¹ (k, k), weighted; of the smallest norm."""
        A = np.concatenate([self._taken(p, self.model) for p in self.parts])
        b = np.concatenate([p.Y[:, 0] * self.weight[p.coordinate] for p in self.parts])
        inverse = linear.pinv(A.T @ A, rcond=RANK, hermitian=True)
        size = self.size[self.model]
        return (inverse @ (A.T @ b)) / size, inverse / size[:, None] / size


def _inner(a: np.ndarray, b: np.ndarray, u: int) -> np.ndarray:
    """aᵀb (n, u, u) of columns (m, n u) of n groups."""
    a, b = (x.reshape(len(x), x.shape[1] // u, u) for x in (a, b))
    return a.transpose(1, 2, 0) @ b.transpose(1, 0, 2)


def _turned(V: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Columns x (…, n u) of n groups times V (n, u, u)."""
    n, u = V.shape[:2]
    three = x.reshape(*x.shape[:-1], n, u)
    return np.ascontiguousarray(np.einsum("...ni,nij->...nj", three, V)).reshape(x.shape)


def _theta(
    s: np.ndarray, c: np.ndarray, Mp: np.ndarray, q: np.ndarray, inverse: np.ndarray
) -> np.ndarray:
    """θ₋k (n, u, R) without a block; s, c (n, u, R): C̃ᵀỹ of all blocks, of this one."""
    return inverse @ (s - c - (Mp.T @ q).reshape(c.shape))


def _fall(
    mine: Index, theta: np.ndarray, x: np.ndarray, Z: np.ndarray, e: np.ndarray, qe: np.ndarray,
    a: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Fall of a block's left-out squares (n, R) in one coordinate: θᵀ(2 (Lc̃)ᵀe − (Lc̃)ᵀLc̃ θ).

    Args:
        mine: groups that have columns x (m, ·) there; Z: of all of them, Lc̃ = c − Q Z.
        theta: (n, u, R).
        e: (m, R) left-out errors; qe: Qᵀe.
        a: (n, u, u) of (Lc̃)ᵀLc̃.
    """
    c = -(Z.T @ qe).reshape(theta.shape)
    c[mine] += (x.T @ e).reshape(len(mine), *theta.shape[1:])
    return (theta * (2 * c - a @ theta)).sum(axis=1)
