"""The rows of a fit with other right-hand sides, in which torque channels are judged.

    X_u x = known_u + g τ_i(t + l)     row u of the joint that channel i, times g, is taken for

X are the model's columns and the library's linear effects at every driven joint, so that a missing
effect is no fault of the data. Rows are reduced to Gram matrices of blocks of time once; each
hypothesis, and each choice of effects beside the model, is then a least-squares problem in which
nothing impossible is allowed (negative inertia, negative friction): only that tells a torque of the
wrong sign from one of the right.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ident.effects import Effect
from ident.equations.table import Table
from ident.faults.fault import Fault
from ident.information.estimate import Estimate
from ident.information.evidence import BEYOND, EXCESS, EXPLAINED_BELOW
from ident.information.hypotheses import Array, Index
from ident.information.lapack import lapack
from ident.information.linear import nonnegative_least
from ident.mechanism.parameters import kinetic_energies

FAR = 7  # work: shifts round the log by so many parts of it: torques of another time
IN_MEMORY = 30_000_000  # work: numbers of all Gram matrices, a quarter of a gigabyte
AT_ONCE = 3_000_000  # work: the same, with which one pass works
LONGEST = 0.1  # range: s; a torque that is later still is another log's
NODES = 12  # work: shifts on either side, from one sample up to LONGEST
SMALL = 0.01  # tuned: relative error below which no channel is blamed, none is better
# tuned: correlation of what is alike: periods of a motion, torques (URDFs 15 % off: 0.998, a load:
# 0.92)
SAME_SHAPE = 0.98
DOUBT = BEYOND * SMALL  # level: relative error of some torque from which a fit is doubted
SEVERAL = 3  # range: joints from which on torques of another run are told from a missing effect
ROUNDS = 3  # work: in which weights settle
SQUARES_ROUNDING = 1e-12  # numerics: of the largest torque's squares: a smaller torque is none
RIDGE = 1e-10  # numerics: of unit columns' squares: settles what no row determines
ACTIVE = "active"  # key of the limits at which the last solution was, where the next is sought
RIDGE_OF_DUAL = 1e-12  # numerics: of the trace: limits that are alike share a multiplier
POSTURES = 40  # work: samples at which the mean inertia must be positive


class EffectsAndTorques(NamedTuple):
    """Columns of further effects and torques in the rows of a table."""

    columns: list[tuple[Array, Array]]  # (N, c, unknowns) of each effect, and the c coordinates
    torques: Array  # (N, d, …), see `ChannelEquations`
    drive_of_coordinate: tuple[int, ...]  # empty where a coordinate has no drive of its own
    steps: Array  # shifts of the torques [samples]
    near: int  # how many of them can be a delay

    @classmethod
    def of(cls, table: Table, effects: Sequence[Effect], shifts: bool = False) -> EffectsAndTorques:
        """Make them, `shifts`: with torques that are shifted in time."""
        driven, names = table.mechanism.driven, table.motion.independent
        drives = tuple(map(driven.index, names)) if sorted(driven) == sorted(names) else ()
        columns = [table.effect_columns(effect, [{}]) for effect in effects]
        steps, near = _steps(table) if shifts and drives else (np.zeros(1, dtype=int), 1)
        if drives:
            return cls(columns, _torques_of_drives(table, drives, steps), drives, steps, near)
        return cls(columns, _spread_torques(table, driven), drives, steps, near)

    def at(self, rows: Index) -> EffectsAndTorques:
        """Return those in some of the rows."""
        columns = [(C[rows], felt) for C, felt in self.columns]
        return self._replace(columns=columns, torques=self.torques[rows])


@dataclass(frozen=True, eq=False)
class ChannelEquations:
    """Gram matrices of [X | known, torques] by block and coordinate.

    Where each coordinate has a drive of its own, its torques are τ_1 … τ_J and L shifts of its own;
    else they are Zᵀ W_jᵀ τ_i for each joint j and channel i, not shifted.
    """

    driven: tuple[str, ...]  # names of the J driven joints
    # by coordinate its only drive; empty if there are other drives
    drive_of_coordinate: tuple[int, ...]
    # (blocks, d, k + r, k + r) of k columns X and r right-hand sides; where these would not be held
    # in memory, the rows (blocks, d, rows, k + r) of which they are products
    gram: Array
    k: int
    effects: Mapping[str, Array]  # by label, the columns that the model does not have, the last
    rows: Array  # (blocks, d)
    lags: Array  # (1 + L,) [s], first 0
    near: int  # how many of them can be a delay, the others turn the log round
    limits: tuple[Array, Array]  # G (m, k), g (m,) with G x + g ≥ 0 for a machine that can exist
    memo: dict[Any, Any] = field(default_factory=dict)

    @classmethod
    def of(
        cls, estimate: Estimate, table: Table, use: np.ndarray, effects: Sequence[Effect],
        shifts: bool = False, blocks: Array | None = None,
        further: EffectsAndTorques | None = None,
    ) -> ChannelEquations:  # fmt: skip
        """Reduce the rows `use` (N, d) of a table, with further linear effects and what an estimate
        holds at its value; `blocks` (N,) number stretches of time, by default the table's;
        `further`: the effects' columns and unshifted torques in these rows, where they are made.
        """
        names = table.motion.independent
        further = further or EffectsAndTorques.of(table, effects, shifts)
        columns, torques, drive_of_coordinate, steps, near = further
        fixed = estimate.fixed
        rows_in_use = use.any(axis=1)
        blocks = table.blocks if blocks is None else blocks
        numbers, block = np.unique(blocks[rows_in_use], return_inverse=True)
        prior = estimate.solution.x[fixed]
        ends = np.cumsum([int((~fixed).sum()), *(C.shape[2] for C, _ in columns)])
        places = {e.label: np.arange(*x) for e, x in zip(effects, pairwise(ends), strict=True)}
        k, edges = int(ends[-1]), np.searchsorted(block, range(len(numbers) + 1))
        shape, width, most = (len(numbers), len(names)), k + 1 + torques.shape[2], np.diff(edges)
        short = most.max() < width and np.prod(shape) * width**2 > IN_MEMORY
        height = int(most.max())
        gram = np.zeros((*shape, height if short else width, width))
        counted = use[rows_in_use]
        rows = np.add.reduceat(counted, edges[:-1], axis=0, dtype=float)
        place = edges[:-1, None] + np.arange(height)  # of the rows of each block, and of none
        place[place >= edges[1:, None]] = len(counted)
        for u in range(len(names)):
            X = columns_of(table, ~fixed, columns, u)
            known = table.b[:, u] - table.tau[:, u] - table.A[:, u, fixed] @ prior
            stack = np.zeros((len(counted) + 1, width))
            both = np.column_stack([X, known, torques[:, u]])
            np.copyto(stack[:-1], both[rows_in_use], where=counted[:, u, None])
            blocks_of_rows = stack[place]
            if short:
                gram[:, u] = blocks_of_rows
            else:
                np.matmul(blocks_of_rows.transpose(0, 2, 1), blocks_of_rows, out=gram[:, u])
        rate = _rate(table)
        lags = steps / rate if rate else 0.0 * steps
        limits = limits_of_machines(estimate, table, effects, k)
        driven = table.mechanism.driven
        return cls(driven, drive_of_coordinate, gram, k, places, rows, lags, near, limits)

    def with_effects(self, effects: Collection[str]) -> ChannelEquations:
        """Return the same rows with only these effects beside the model, by label."""
        chosen_columns = [at for label, at in self.effects.items() if label in effects]
        model = np.arange(self.k - sum(map(len, self.effects.values())))
        columns = np.concatenate([model, *chosen_columns])
        ends = np.cumsum([len(model), *map(len, chosen_columns)])
        labels = [label for label in self.effects if label in effects]
        G, g = self.limits
        real = G[:, columns].any(axis=1) | ~G.any(axis=1)  # others are of effects left out
        every = np.append(columns, np.arange(self.k, self.gram.shape[3]))
        gram = self.gram[..., every]
        gram = gram if self._by_rows else gram[:, :, every]
        return replace(
            self, gram=gram, k=len(columns), limits=(G[np.ix_(real, columns)], g[real]), memo={},
            effects={n: np.arange(*x) for n, x in zip(labels, pairwise(ends), strict=True)},
        )  # fmt: skip

    @property
    def without_rows(self) -> ChannelEquations:
        """The same without Gram matrices."""
        return replace(self, gram=self.gram[:0].copy(), memo={})

    @property
    def _by_rows(self) -> bool:
        """Whether the rows are held instead of their products."""
        return self.gram.shape[2] != self.gram.shape[3]

    @cached_property
    def total(self) -> Array:
        """Gram matrices (d, …) of all blocks."""
        if not self._by_rows:
            return np.asarray(self.gram.sum(axis=0))
        return np.asarray(sum(grams.sum(axis=0) for _, grams in self._in_memory()))

    def _in_memory(self) -> Iterator[tuple[slice, Array]]:
        """Yield blocks and their Gram matrices (blocks, d, …), some at once."""
        width = self.gram.shape[1] * self.gram.shape[3] ** 2
        most = max(1, AT_ONCE // width)
        for start in range(0, len(self.gram), most):
            part = slice(start, start + most)
            x = self.gram[part]
            yield part, x.swapaxes(2, 3) @ x if self._by_rows else x

    @cached_property
    def torque(self) -> Array:
        """Squares (d,) of the logged torques."""
        return self.squares_of(self.as_logged)[1]

    @property
    def as_logged(self) -> Fault:
        """The log as it is."""
        return Fault.none(self.driven)

    def squares_of(self, cause: Fault) -> tuple[Array, Array]:
        """Combinations (d, r) of the right-hand sides, and squares (d,) of their torques."""
        c = np.zeros((len(self.total), self.total.shape[2] - self.k))
        c[:, 0] = 1.0
        J = len(self.driven)
        for u, j in enumerate(self.drive_of_coordinate):
            shift = cause.shift[j]
            c[u, J + shift if shift else 1 + cause.take[j]] = cause.gain[j]
        for j in range(0 if self.drive_of_coordinate else J):
            c[:, 1 + j * J + cause.take[j]] = cause.gain[j]
        of_channels = self.total[:, self.k + 1 :, self.k + 1 :]
        torque, logged = squares(of_channels, c[:, 1:]), squares(of_channels, np.sign(c[:, 1:]))
        least = torque.max() or 1.0  # of a joint without torque: what it leaves is small beside it
        return c, np.where(logged > SQUARES_ROUNDING * (logged.max() or 1.0), torque, least)

    def errors(self, cause: Fault, noise: Array) -> Array:
        """Squared errors (d,) of all rows as shares of the torque's squares, everything fitted with
        weights for a relative noise (d,).
        """
        c, size = self.squares_of(cause)
        x = np.broadcast_to(self._solved(c, size * noise**2), (len(c), self.k))
        return np.maximum(squares(self.total, np.concatenate([x, -c], axis=1)), 0.0) / size

    def solution(self, cause: Fault, noise: Array) -> Array:
        """The unknowns (k,) of a cause, fitted to all rows."""
        c, size = self.squares_of(cause)
        return self._solved(c, size * noise**2)

    def _solved(self, c: Array, size: Array) -> Array:
        """The unknowns (k,) of right-hand sides c (d, r), with weights 1/size (d,)."""
        if not self.k:  # everything is known
            return np.zeros(0)
        k, key = self.k, tuple(np.round(np.log(size), 2).tolist())
        if key not in self.memo:
            H = np.tensordot(1 / size, self.total[:, :k, :k], 1)
            self.memo[key] = LimitedNormalEquations.of(H, self.limits)
        b = (1 / size) @ (self.total[:, :k, k:] @ c[:, :, None])[:, :, 0]
        x, self.memo[ACTIVE] = self.memo[key].solved(b, self.memo.get(ACTIVE))
        return np.asarray(x)

    def rows_of(self, cause: Fault) -> Array:
        """Which coordinates (d,) feel a cause: those of its torques, or all."""
        every = not self.drive_of_coordinate or cause.state is not None
        drives = self.drive_of_coordinate or self.rows[0]
        return np.array([every or self.driven[j] in cause.places for j in drives])

    def noise(self, cause: Fault, start: Array | None = None) -> Array:
        """Relative errors (d,), each coordinate weighted by its own: a joint with a missing effect
        does not spoil the others.
        """
        start = np.ones(len(self.total)) if start is None else start
        for _ in range(ROUNDS):
            start = np.sqrt(self.errors(cause, start) + SMALL**2)
        return start

    def score(self, cause: Fault, now: Array) -> float:
        """Log density of torques if the cause is all that is wrong; noise of others: `now`."""
        error = self.errors(cause, np.where(self.rows_of(cause), SMALL, now))
        return -0.5 * float(self.rows.sum(axis=0) @ np.log(error + SMALL**2))

    def left_out(self, cause: Fault, noise: Array) -> Array:
        """Log density (blocks, d) of the torques of each block, fitted to the others."""
        c, size = self.squares_of(cause)
        weight, errors = 1 / (size * noise**2), np.empty(self.rows.shape)
        for part, grams in self._in_memory():
            z = np.empty(grams.shape[:3])
            z[:, :, : self.k] = self._solved_without(grams, c, weight)[:, None]
            z[:, :, self.k :] = -c
            errors[part] = squares(grams, z)
        return self.density(np.maximum(errors, 0.0) / size)

    def _solved_without(self, grams: Array, c: Array, weight: Array) -> Array:
        """The unknowns (blocks, k) of right-hand sides c (d, r), fitted to all rows but those of
        Gram matrices (blocks, d, …) each.
        """
        k, z = self.k, np.append(np.zeros((len(c), self.k)), c, axis=1)[:, :, None]
        if not k:
            return np.zeros((len(grams), 0))
        both = self.total, grams
        H, H_block = (
            (weight @ x.reshape(*x.shape[:-2], -1)).reshape(-1, *x.shape[-2:])[:, :k, :k]
            for x in both
        )
        b, b_block = (np.atleast_2d(weight @ (x @ z)[..., :k, 0]) for x in both)
        return solved_within(H - H_block, b - b_block, self.limits, self.memo.get(ACTIVE))

    def density(self, error: Array) -> Array:
        """Log density (blocks, d) of left-out squares (blocks, d), as shares of all the torque."""
        sigma2 = error.sum(axis=0) + SMALL**2
        return -0.5 * (self.rows * np.log(sigma2) + self.rows.sum(axis=0) * error / sigma2)

    def torques_of_another_log(self, noise: Array) -> list[str]:
        """Driven joints of which the torque is explained no better than at another time of the log:
        it is not of this motion, or is noise; `noise` (d,) is that of the log as it is. None, if
        these are not most of several: effects that the library does not have may make a few.
        """
        names, turned = [], range(self.near, len(self.lags))
        several = len(self.drive_of_coordinate) >= SEVERAL and turned
        for u in np.flatnonzero(noise > EXPLAINED_BELOW) if several else ():
            drive = self.drive_of_coordinate[u]
            name = self.driven[drive]
            causes = (self.as_logged.replaced("delay", 0.0, shift={drive: k}) for k in turned)
            if EXCESS * noise[u] > min(self.noise(cause, noise)[u] for cause in causes):
                names.append(name)
        return names if len(names) >= max(SEVERAL, len(self.drive_of_coordinate) / 2) else []

    def refined_delay(self, cause: Fault) -> float:
        """The delay [s] of a cause between the shifts that were tried, by a parabola."""
        order, joints = np.argsort(self.lags), [self.driven.index(name) for name in cause.places]
        shift = cause.shift[joints[0]]
        i = int(np.flatnonzero(order == shift)[0])
        near, noise = order[i - 1 : i + 2], self.noise(cause)
        scores = [
            self.score(cause.replaced("delay", 0.0, shift=dict.fromkeys(joints, int(s))), noise)
            for s in near
        ]
        lag = float(self.lags[shift])
        bend, slope, _ = np.polyfit(self.lags[near] - lag, scores, 2)
        return float(lag - slope / (2 * bend)) if bend < 0 else lag


@dataclass(frozen=True, eq=False)
class LimitedNormalEquations:
    """Normal equations H x = b of unit columns, for x with G x + g ≥ 0."""

    scale: Array  # (k,) of the columns
    R: Array  # (k, k) the Cholesky factor of H
    G: Array  # (m, k)
    g: Array  # (m,)

    @classmethod
    def of(cls, H: Array, limits: tuple[Array, Array]) -> LimitedNormalEquations:
        """Factorise H (k, k) of columns as they are; raises LinAlgError if that fails."""
        scale = np.sqrt(np.where(np.diag(H) > 0, np.diag(H), 1.0))
        R, failed = lapack.dpotrf(H / scale / scale[:, None] + RIDGE * np.eye(len(H)))
        if failed:
            raise np.linalg.LinAlgError("normal equations without a Cholesky factor")
        return cls(scale, R, limits[0] / scale, limits[1])

    @cached_property
    def dual(self) -> tuple[Array, Array]:
        """H⁻¹ Gᵀ (k, m) and G H⁻¹ Gᵀ (m, m)."""
        GH, _ = lapack.dpotrs(self.R, self.G.T)
        return GH, self.G @ GH

    def solved(self, b: Array, start: np.ndarray | None) -> tuple[Array, np.ndarray | None]:
        """Return x (k,) of columns as they are, as b (k,), and the limits (m,) at which it is;
        `start`: limits at which it perhaps is.
        """
        x, _ = lapack.dpotrs(self.R, b / self.scale)
        slack = self.G @ x + self.g
        if (slack < 0).any():
            GH, dual = self.dual
            mu = multipliers(dual, slack, start)
            x, start = x + GH @ mu, mu > 0
        return x / self.scale, start


def solved_within(
    H: Array, b: Array, limits: tuple[Array, Array], start: np.ndarray | None = None
) -> Array:
    """Return x (n, k) of H x = b, H (n, k, k), b (n, k), with limits G (m, k) and g (m,), as
    `LimitedNormalEquations` have it.
    """
    squares_of_columns = np.diagonal(H, axis1=1, axis2=2)
    scale = np.sqrt(np.where(squares_of_columns > 0, squares_of_columns, 1.0))
    unit = H / scale[:, None] / scale[:, :, None] + RIDGE * np.eye(H.shape[1])
    G = limits[0] / scale[:, None]
    right = np.concatenate([(b / scale)[:, :, None], G.swapaxes(1, 2)], axis=2)
    x, GH = np.split(np.linalg.solve(unit, right), [1], axis=2)
    x = x[:, :, 0].copy()
    slack, dual = (G @ x[:, :, None])[:, :, 0] + limits[1], G @ GH
    for i in np.flatnonzero((slack < 0).any(axis=1)):
        x[i] += GH[i] @ multipliers(dual[i], slack[i], start)
    return np.asarray(x / scale)


def multipliers(dual: Array, slack: Array, start: np.ndarray | None) -> Array:
    """Return μ ≥ 0 (m,) of limits G x + g ≥ 0, of least ½ μᵀ G H⁻¹ Gᵀ μ + μᵀ (G H⁻¹ b + g)."""
    ridge = (RIDGE_OF_DUAL * np.trace(dual) or 1.0) * np.eye(len(dual))
    return nonnegative_least(dual + ridge, -slack, start)


def squares(gram: Array, z: Array) -> Array:
    """zᵀ G z (…) of G (…, n, n) and z (…, n)."""
    return np.asarray((z[..., None, :] @ gram @ z[..., None])[..., 0, 0])


def columns_of(
    table: Table, free: np.ndarray, columns: Sequence[tuple[np.ndarray, np.ndarray]], u: int
) -> Array:
    """Columns (N, k) of the free unknowns and of further effects in coordinate u."""
    extra = [
        C[:, list(at).index(u)] if u in at else np.zeros((len(C), C.shape[2])) for C, at in columns
    ]
    return np.column_stack([table.A[:, u, free], *extra])


def _rate(table: Table) -> float:
    """Return the rate of the first log of a motion [Hz]; 0 where all are poses."""
    return next((s.e.rate for s in table.scenes if not s.e.poses), 0.0)


def _steps(table: Table) -> tuple[Array, int]:
    """Shifts of the torques [samples], the first 0, and how many can be a delay; others are far."""
    e = next((s.e for s in table.scenes if not s.e.poses), table.scenes[0].e)
    most = min(LONGEST * e.rate, 0.05 * len(e))
    late = {max(1, round(i * most / NODES)) for i in range(1, NODES + 1)} if e.rate else set()
    near = [0, *sorted(-k for k in late), *sorted(late)]
    return np.array([*near, *(len(e) * k // FAR for k in range(1, FAR))]), len(near)


def _torques_of_drives(table: Table, drive_of_coordinate: tuple[int, ...], steps: Array) -> Array:
    """Filtered torques (N, d, J + L): all channels, and that of the coordinate's drive shifted."""
    pieces = []
    for number, scene in enumerate(table.scenes):
        tau, n = scene.e.tau, len(scene.e)
        shifted = np.arange(n)[:, None] + steps[1:]
        far = np.abs(steps[1:]) > LONGEST * _rate(table) + 1
        if scene.e.poses:  # none of them is late
            shifted = np.where(far, shifted, np.arange(n)[:, None])
        shifted = np.where(far, shifted % n, np.clip(shifted, 0, n - 1))
        every = table.filtered(number, tau)
        shifted_torques = (
            np.hstack([every, table.filtered(number, tau[shifted, j])]) for j in drive_of_coordinate
        )
        # one drive after the other, to take less memory
        pieces.append(np.stack([*shifted_torques], axis=1))
    return np.concatenate(pieces) * table.scale[:, :, None]


def _spread_torques(table: Table, driven: tuple[str, ...]) -> Array:
    """Filtered torques (N, d, J J): each channel i taken for each joint j, at j J + i."""
    pieces = []
    for number, scene in enumerate(table.scenes):
        s, tau = table.samples[number], scene.e.tau
        out = np.zeros((*s.shape, len(driven) ** 2))
        for j, name in enumerate(driven):
            s.add_torque(out[:, :, j * len(driven) : (j + 1) * len(driven)], name, tau)
        pieces.append(table.filtered(number, out))
    return np.concatenate(pieces) * table.scale[:, :, None]


def limits_of_machines(
    estimate: Estimate, table: Table, effects: Sequence[Effect], k: int
) -> tuple[Array, Array]:
    """G (m, k), g (m,) of what no machine has: the inertia of an independent coordinate,

        u ↦ (Zᵀ Γ(q, 0, Z e_u) x)_u ≥ 0, mean over the log

    and the coefficients of effects that every machine has and that cannot be negative.
    """
    mechanism, columns, independent = table.mechanism, table.columns, table.motion.independent
    d, fixed, x = len(independent), estimate.fixed, estimate.solution.x
    inertia, offset = np.zeros((d, len(columns))), np.zeros(d)
    known = np.setdiff1d(np.arange(len(mechanism.prior)), columns.rigid)
    e, model = table.motion.experiments[0], mechanism.model
    postures = e.at_samples(np.flatnonzero(e.usable)[:: max(1, int(e.usable.sum()) // POSTURES)])
    for u in range(d):
        gamma = 2 * kinetic_energies(model, postures.q, postures.pinv[:, :, u - d]).mean(axis=0)
        inertia[u, : len(columns.rigid)] = gamma[columns.rigid]
        offset[u] = gamma[known] @ mechanism.prior[known] + inertia[u, fixed] @ x[fixed]
    places = {name: i for i, name in enumerate(np.array(columns.names)[~fixed])}
    extra = [name for effect in effects for name in effect.names]
    places |= {name: k - len(extra) + i for i, name in enumerate(extra)}
    G = np.zeros((d, k))
    G[:, : int((~fixed).sum())] = inertia[:, ~fixed]
    positive, given = [], []
    for effect in {e.label: e for e in (*effects, *mechanism.effects)}.values():
        for name, unknown in zip(effect.names, effect.parameters, strict=True):
            if name not in places or not (effect.common and unknown.nonnegative):
                continue
            positive.append(np.eye(k)[places[name]])
            given.append(effect.values.get(unknown.name, 0.0))  # of which the unknown is the change
            if unknown.acts == "inertia" and effect.joints[0] in independent:
                G[independent.index(effect.joints[0]), places[name]] += 1.0
    return np.concatenate([G, *([positive] if positive else [])]), np.concatenate([offset, given])
