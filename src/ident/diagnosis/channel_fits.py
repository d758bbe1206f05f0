"""Which arrangement of the torque channels explains a log, by refits of rows kept apart."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import lstsq

from ident.equations.corrections import Scene
from ident.equations.filter import Decimator
from ident.equations.terms import Samples, Terms
from ident.fit import Fit
from ident.motion import State

# --- bounded -------------------------------------------------------------------------------------
# Least squares of smallest norm, free or with inequalities, for columns that may depend.


DEPENDENT = 1e-6  # share of a unit column below which what is new in it is rounding
FIRM = 100.0  # weight of an inequality at its bound, to rows of unit columns
SLACK = 1e-3  # of a unit column's unknown, by which a bound may be passed


def least(X: np.ndarray, b: np.ndarray) -> np.ndarray:
    """argmin ‖X x − b‖ for X (n, k) and b (n,) or (n, r), by a complete orthogonal factorisation.

    The singular values' divide and conquer (`gelsd`) does not always converge on such columns.
    """
    norm = _norm(X)
    x = _solve(X / norm, b, DEPENDENT)
    return x / (norm if b.ndim == 1 else norm[:, None])


def within(X: np.ndarray, b: np.ndarray, G: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Least squares x (k,) with G x + g ≥ 0: what is violated is held at its bound, one by one.

    What was held is not let go again: it is the answer of a full active-set method but where two
    bounds compete, and then an error that is slightly too large.
    """
    norm = _norm(X)
    G = G / norm
    size = np.linalg.norm(G, axis=1)
    known = size > 0
    G, g = G[known] / size[known, None], g[known] / size[known]
    A = X / norm
    active: list[int] = []
    while True:
        stack = np.concatenate([A, FIRM * G[active]])
        x = _solve(stack, np.concatenate([b, -FIRM * g[active]]), DEPENDENT / FIRM)
        slack = G @ x + g
        slack[active] = 0.0
        if len(active) == len(g) or slack.min(initial=0.0) >= -SLACK:
            return x / norm
        active.append(int(slack.argmin()))


def _norm(X: np.ndarray) -> np.ndarray:
    norm = np.linalg.norm(X, axis=0)
    return np.asarray(np.where(norm > 0, norm, 1.0))


def _solve(A: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    return np.asarray(lstsq(A, b, cond=share, lapack_driver="gelsy", check_finite=False)[0])


# --- evidence ------------------------------------------------------------------------------------
# Rows in memory, in which the torque channels stand apart: any exchange of them is a sum.
#
#     X x = known + Σ_{j,i} c_ji Z W_jᵀ τ_i + Σ_{j,l} c_jl Z W_jᵀ τ_j(t + l dt)
#
# c_ji is how much of channel i is taken for the torque of joint j (as logged: 1 for i = j). X are
# the model's columns and, at every driven joint, v, sign(v), 1, q and a: friction, offset, spring
# and rotor inertia that the model may lack are no fault of the data.


MOST = 6000  # rows a coordinate; a share that is to be told to 10 % needs no more
STICKING = 0.2  # share of a filtered row that may come from samples at standstill
USUAL = 5  # v, sign(v), 1, q, a
LONGEST = 0.1  # s; a longer delay is a wrong clock
NODES = 12  # shifts on either side, from one to two samples up to LONGEST


@dataclass(frozen=True, eq=False)
class ChannelRows:
    """Rows of all experiments, with J driven joints, d coordinates, k unknowns and L shifts.

    Attributes:
        X: (n, d, k + 5 J); B: (n, d, 1 + J J + J L): known, τ_i at joint j, τ_j shifted.
        informed: (n, d), false at standstill.
        t: (n,) [s]; experiment: (n,) its number.
        lags: (L,) shifts of the torques [s], positive: taken from later.
        dt: step of the clock [s].
    """

    X: np.ndarray
    B: np.ndarray
    informed: np.ndarray
    t: np.ndarray
    experiment: np.ndarray
    lags: np.ndarray
    dt: float


def gather(
    fit: Fit, experiments: Sequence[State] | None = None, most: int = MOST, shifts: bool = True
) -> ChannelRows:
    """The rows of a fit's motion, or of other experiments of its mechanism.

    Args:
        fit: whose mechanism, columns and filter are taken.
        experiments: default: the fit's own.
        most: rows a coordinate that are kept.
        shifts: whether torques shifted in time are wanted.
    """
    experiments = fit.motion.experiments if experiments is None else experiments
    dt = 1 / experiments[0].rate
    most_steps = min(LONGEST / dt, 0.05 * len(experiments[0]))
    steps = sorted({1, 2, *(max(1, round(i * most_steps / NODES)) for i in range(1, NODES + 1))})
    lags = np.array([*(-k for k in reversed(steps)), *steps] if shifts else [], dtype=int)
    total = sum(int(e.usable.sum()) for e in experiments)
    found: list[tuple[np.ndarray, ...]] = []
    for number, bare in enumerate(experiments):
        cutoff = fit.motion.band.cutoff
        scene = Scene.of(fit.mechanism, fit.columns, bare, fit.point, cutoff)
        e, decimator = scene.e, Decimator.of(cutoff, bare.rate)
        every = max(1, -(-total // decimator.factor // most))
        decimator = replace(decimator, factor=decimator.factor * every)

        def make(part: slice, scene: Scene = scene) -> tuple[np.ndarray, ...]:
            return _columns(fit, scene, part, lags)

        for segment in e.segments():
            for sample, (X, B, told) in decimator.filtered(segment, make, STICKING):
                found.append((X, B, told, e.t[sample], np.full(len(sample), number)))
    X, B, informed, t, experiment = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return ChannelRows(X, B, informed, t, experiment, lags * dt, dt)


def _columns(
    fit: Fit, scene: Scene, part: slice, lags: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """X, B and informed of some samples, unfiltered."""
    e, s = scene.e, scene.samples(part)
    driven, (n, d) = fit.mechanism.driven, s.shape
    found = scene.terms(part)
    k, J, L = len(fit.columns), len(driven), len(lags)
    X = np.zeros((n, d, k + USUAL * J))
    X[:, :, :k] = found.A
    held = fit.estimate.held
    known = found.b - found.tau - found.A[:, :, held] @ fit.estimate.solution.x[held]
    X[:, :, :k][:, :, held] = 0.0
    B = np.zeros((n, d, 1 + J * J + J * L))
    B[:, :, 0] = known
    informed = np.ones((n, d), dtype=bool)
    for _, told in found.informative:
        informed &= told[:, None] | (e.loop is None)
    tau = e.tau[part]
    for j, name in enumerate(driven):
        rows, W = s.lever(name)
        x = s.signals((name,))
        q, v, a = x.q[:, 0], x.v[:, 0], x.a[:, 0]
        usual = np.stack([v, np.clip(v / x.still, -1, 1), np.ones(n), q, a], axis=-1)
        W = W[:, :, None]
        X[:, rows, k + USUAL * j : k + USUAL * (j + 1)] = W * usual[:, None]
        B[:, rows, 1 + J * j : 1 + J * (j + 1)] = W * tau[:, None]
        shifted = e.tau[np.clip(np.arange(len(e))[part, None] + lags, 0, len(e) - 1), j]
        B[:, rows, 1 + J * J + L * j : 1 + J * J + L * (j + 1)] = W * shifted[:, None]
        informed[:, rows] &= (np.abs(v) >= x.still)[:, None]
    return X, B, informed


# --- possible ------------------------------------------------------------------------------------
# What no machine can have, as inequalities on the unknowns: G x + g ≥ 0.
#
#     inertia of an independent coordinate      u ↦ (Zᵀ Γ(q, 0, Z e_u) x)_u ≥ 0, mean over the log
#     viscous and dry friction of a joint       Fv, Fc ≥ 0
#
# A free fit to a torque with the wrong sign turns all of a joint's parameters over and is as good
# as the right one; only that they cannot be negative tells the two apart.


LOOKED_AT = 40  # samples at which the inertia is evaluated, over all experiments
POSITIVE = {"viscous": ("Fv",), "coulomb": ("Fc",)}  # and their place among the usual columns


def possible(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """G (d + 2 J, k + 5 J) and g (d + 2 J,)."""
    driven, k = fit.mechanism.driven, len(fit.columns)
    width = k + USUAL * len(driven)
    inertia, offset = _inertia(fit, width)
    friction = np.zeros((2 * len(driven), width))
    for j, joint in enumerate(driven):
        for i, (kind, (word,)) in enumerate(POSITIVE.items()):
            row = friction[2 * j + i]
            row[k + USUAL * j + i] = 1.0
            name = f"{kind}.{joint}.{word}"
            if name in fit.columns.index:
                row[fit.columns.index[name]] = 1.0
    return np.concatenate([inertia, friction]), np.concatenate([offset, np.zeros(len(friction))])


def _inertia(fit: Fit, width: int) -> tuple[np.ndarray, np.ndarray]:
    mechanism, k = fit.mechanism, len(fit.columns)
    d = len(fit.motion.independent)
    total, offset, count = np.zeros((d, width)), np.zeros(d), 0
    for e in fit.motion.experiments:
        share = LOOKED_AT // len(fit.motion.experiments)
        some = e.at_samples(
            np.flatnonzero(e.usable)[:: max(1, int(e.usable.sum()) // max(share, 4))]
        )
        still = replace(some, v=0 * some.v, yd=0 * some.yd, a=0 * some.a, ydd=0 * some.ydd)
        rest = _terms(fit, still)
        for u in range(d):
            a, ydd = some.pinv[:, :, -d + u], some.leverage[:, :, u]
            moved = _terms(fit, replace(still, a=a, ydd=ydd))
            total[u, :k] += (moved.A - rest.A)[:, u].sum(axis=0)
            offset[u] -= float((moved.b - rest.b)[:, u].sum())
            for j, name in enumerate(mechanism.driven):
                lever = ydd[:, mechanism.joint_index[name]]
                total[u, k + USUAL * j + USUAL - 1] += float(lever @ lever)
        count += len(still)
    held = fit.estimate.held
    offset += total[:, :k][:, held] @ fit.estimate.solution.x[held]
    total[:, :k][:, held] = 0.0
    return total / count, offset / count


def _terms(fit: Fit, e: State) -> Terms:
    """Of samples that are no course of time, so without what corrects the data."""
    scene = Scene(Samples(fit.mechanism, e, slice(None), fit.point), fit.columns)
    return scene.terms(slice(0, len(e)))


# --- trial ---------------------------------------------------------------------------------------
# What would be left if the torque channels were others: refits from small triangles.
#
# Each coordinate's rows [X | B] are reduced to a triangle once; every arrangement c of the torque
# channels is then one small least-squares problem with all parameters free,
#
#     min_x Σ_u ‖R_u x − S_u c‖² / σ_u(c)²          [R_u | S_u] = Qᵀ [X_u | B_u]
#
# with σ_u(c) the rms of the torque that c makes of coordinate u: relative errors weigh alike.


@dataclass(frozen=True, eq=False)
class Result:
    """x (k + 5 J,) of a refit, and each coordinate's relative error (d,)."""

    x: np.ndarray
    relative: np.ndarray

    @property
    def score(self) -> float:
        """Root mean square of the relative errors."""
        return float(np.sqrt(np.mean(np.minimum(self.relative, 1e3) ** 2)))


@dataclass(frozen=True, eq=False)
class ChannelTrial:
    """Triangles of all rows of a fit.

    Attributes:
        driven: names of the J driven joints; own: for each coordinate the place among them, or −1.
        triangles: for each coordinate [R_u | S_u]; width: columns of R_u; rows: (d,).
        lags: (L,) [s]; dt: [s].
    """

    driven: tuple[str, ...]
    own: tuple[int, ...]
    triangles: tuple[np.ndarray, ...]
    width: int
    rows: np.ndarray
    lags: np.ndarray
    dt: float
    limits: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, fit: Fit, experiments: Sequence[State] | None = None) -> ChannelTrial:
        """The triangles of a fit's rows; of other experiments: few rows, without shifts."""
        rows = gather(fit) if experiments is None else gather(fit, experiments, 1500, False)
        return cls.of_rows(fit, rows)

    @classmethod
    def of_rows(cls, fit: Fit, rows: ChannelRows) -> ChannelTrial:
        """The triangles of rows that are at hand."""
        found, counts = [], []
        for u in range(rows.X.shape[1]):
            told = rows.informed[:, u]
            stack = np.concatenate([rows.X[told, u], rows.B[told, u]], axis=1)
            there = stack.any(axis=0)
            R = np.linalg.qr(stack[:, there], mode="r")
            triangle = np.zeros((len(R), stack.shape[1]))
            triangle[:, there] = R
            found.append(triangle)
            counts.append(int(told.sum()))
        driven = fit.mechanism.driven
        own = tuple(driven.index(n) if n in driven else -1 for n in fit.motion.independent)
        return cls(
            driven, own, tuple(found), rows.X.shape[2], np.array(counts), rows.lags, rows.dt,
            possible(fit),
        )  # fmt: skip

    @property
    def square(self) -> bool:
        """Whether each coordinate has one drive, so that its rows are that joint's torque."""
        return sorted(self.own) == list(range(len(self.driven)))

    def arrangement(self, take: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """c where joint j is given gain[j] times channel take[j]."""
        J, L = len(self.driven), len(self.lags)
        c = np.zeros(1 + J * J + J * L)
        c[0] = 1.0
        c[1 + J * np.arange(J) + take] = gain
        return c

    @cached_property
    def as_logged(self) -> np.ndarray:
        """c of the log as it is."""
        J = len(self.driven)
        return self.arrangement(np.arange(J), np.ones(J))

    def torque(self, c: np.ndarray) -> np.ndarray:
        """Norm (d,) of the torques that c makes."""
        only = np.concatenate([[0.0], c[1:]])
        return np.array([np.linalg.norm(T[:, self.width :] @ only) for T in self.triangles])

    def refit(self, c: np.ndarray) -> Result:
        """All parameters refitted to the torques that c makes."""
        size = self.torque(c)
        scale = np.where(size > 0, size, max(size.max(), 1e-300))
        X = np.concatenate(
            [T[:, : self.width] / s for T, s in zip(self.triangles, scale, strict=True)]
        )
        b = np.concatenate(
            [T[:, self.width :] @ c / s for T, s in zip(self.triangles, scale, strict=True)]
        )
        x = within(X, b, *self.limits)
        left, at = [], 0
        for T in self.triangles:
            part = slice(at, at + len(T))
            left.append(float(np.linalg.norm(X[part] @ x - b[part])))
            at += len(T)
        return Result(x, np.array(left))

    @cached_property
    def now(self) -> Result:
        """The log as it is."""
        return self.refit(self.as_logged)


# --- arrange -------------------------------------------------------------------------------------
# Which exchange of torque channels explains the log clearly better: swaps, signs, gains.
#
# Hypotheses are tried one by one, the best is kept, and the search goes on from there, so that two
# wrong channels are found one after the other. A hypothesis has all parameters refitted, with what
# no machine can have (negative inertia or friction) excluded: a missing effect rarely makes another
# arrangement of the channels fit, a wrong one leaves several times the error of the right.


MATERIAL = 0.02  # error left by the log as it is, below which no channel can be badly wrong
CLEAR = 0.45  # of the error may be left: right arrangements leave 0.05 to 0.44, others more
JOINT = 0.7  # and each joint concerned must gain
POOR = 0.2  # error of a joint from which it is judged by itself
WORSE = 1.1  # times its error, by which no other joint may then become worse
ALIKE = 1.3  # times the best hypothesis' error: a rival
GROSS = np.sqrt(2.0)  # a gain nearer to 1 is the effect torque_gain
LARGER = {("scale", 1): 1.2, ("sign", 2): 1.2}  # claims, which must do better than a smaller one
GAINS = (1e-3, 1e-2, 0.1, 0.25, 0.5, 0.7, 1.4, 2.0, 4.0, 10.0, 100.0, 1e3)
REFINED = 6  # steps of golden section, each 0.62 of the interval between two gains


@dataclass(frozen=True, eq=False)
class Change:
    """One exchange: `kind` is `swapped`, `sign` or `scale`.

    Attributes:
        joints: places among the driven joints; factor: by which the channel is multiplied.
        take, gain: (J,) the arrangement that it leads to.
        before, after: relative error of the joints concerned, root mean square.
        score: error of all coordinates after it.
        rivals: other changes that are nearly as good.
    """

    kind: str
    joints: tuple[int, ...]
    factor: float
    take: np.ndarray
    gain: np.ndarray
    before: float = np.nan
    after: float = np.nan
    score: float = np.nan
    rivals: tuple[Change, ...] = ()


def changes(trial: ChannelTrial) -> list[Change]:
    """All exchanges of torque channels that explain the log clearly better, best first."""
    J = len(trial.driven)
    take, gain = np.arange(J), np.ones(J)
    found: list[Change] = []
    for _ in range(J):
        now = trial.refit(trial.arrangement(take, gain))
        if now.score < MATERIAL:
            break
        tried = []
        for change in _hypotheses(trial, take, gain):
            result = trial.refit(trial.arrangement(change.take, change.gain))
            own = np.array([each in change.joints for each in trial.own])
            if _better(change.kind, now, result, own):
                before, after = (
                    _rms(r.relative[own] if own.any() else r.relative) for r in (now, result)
                )
                tried.append(replace(change, before=before, after=after, score=result.score))
        if not tried:
            break
        tried.sort(key=lambda c: c.score * LARGER.get((c.kind, len(c.joints)), 1.0))
        best, *others = tried
        rivals = tuple(c for c in others if c.score < ALIKE * best.score)
        found.append(replace(best, rivals=rivals))
        take, gain = best.take, best.gain
    return found


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _better(kind: str, now: Result, then: Result, own: np.ndarray) -> bool:
    """Whether all joints together, or the joints concerned alone, do clearly better.

    Joints that a missing effect spoils hide what becomes of the others in the sum; then those
    concerned must have been poor, and no other may become worse. A gain is told by the
    rows of the other joints alone, so where these are spoilt it is not told.
    """
    if not (then.relative[own] < JOINT * now.relative[own]).all():
        return False
    if then.score < CLEAR * now.score:
        return True
    if kind == "scale" or not own.any() or (then.relative[~own] > WORSE * now.relative[~own]).any():
        return False
    before, after = now.relative[own], then.relative[own]
    return bool((before > POOR).all() and (after < CLEAR * before).all())


def _hypotheses(trial: ChannelTrial, take: np.ndarray, gain: np.ndarray) -> Iterator[Change]:
    J = len(take)
    for j in range(J):
        turned = gain.copy()
        turned[j] *= -1
        yield Change("sign", (j,), -1.0, take, turned)
        for i in range(j):
            other = take.copy()
            other[i], other[j] = take[j], take[i]
            yield Change("swapped", (i, j), 1.0, other, gain)
            both = turned.copy()
            both[i] *= -1
            yield Change("sign", (i, j), -1.0, take, both)
        factor = _gain(trial, take, gain, j)
        if max(factor, 1 / factor) > GROSS:
            scaled = gain.copy()
            scaled[j] *= factor
            yield Change("scale", (j,), factor, take, scaled)


def _gain(trial: ChannelTrial, take: np.ndarray, gain: np.ndarray, j: int) -> float:
    """The factor on joint j's torque that leaves the least error; 1 if none is better."""

    def score(log_factor: float) -> float:
        scaled = gain.copy()
        scaled[j] *= np.exp(log_factor)
        return trial.refit(trial.arrangement(take, scaled)).score

    grid = np.log([*GAINS[:6], 1.0, *GAINS[6:]])
    values = [score(x) for x in grid]
    best = int(np.argmin(values))
    if best == 6:
        return 1.0
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    golden = (np.sqrt(5) - 1) / 2
    a, b = high - golden * (high - low), low + golden * (high - low)
    at_a, at_b = score(a), score(b)
    for _ in range(REFINED):
        if at_a < at_b:
            high, b, at_b = b, a, at_a
            a = high - golden * (high - low)
            at_a = score(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + golden * (high - low)
            at_b = score(b)
    return float(np.exp(a if at_a < at_b else b))
