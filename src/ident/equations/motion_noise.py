"""Errors in variables: torques and motion weighed against each other, as maximum likelihood asks.

    min over x, c     |U (c − ĉ)|²  +  Σ |b(c) − A(c) x|² / σ²

The smooth motion u = B c may move within what its channels allow (U, ĉ: `motion.spline`) where
that makes the torques agree. Linear in (x, c), these are rows with a band in c, and c is eliminated
as multipliers are: what is left are equations of x alone, whitened by the noise of torques and
motion together.

    torque    A x − F G B (c − ĉ) = b − F G B (c₀ − ĉ)        each over its σ; F: the rows' filter
    motion             U (c − ĉ) = 0
    G_uir = ∂r_u/∂u_i^(r),    r = b − A x,    r = 0, 1, 2 for position, velocity, acceleration
    Var r = G P Gᵀ + σ²       P = (UᵀU)⁻¹ through B, Ḃ, B̈: the covariance of the smooth motion

G is found by differences: everything that a motion enters is in them, closures, effects and
corrections too. At standstill dry friction is open, and no motion is asked to make it otherwise.

Sources: W. Fuller, Measurement Error Models, 1987, sect. 3.2 (functional model); K. Schittkowski,
Numerical Data Fitting in Dynamical Systems, 2002; direct collocation as in L. Biegler, Nonlinear
Programming, 2010, ch. 10, with the equations of motion weighed by the noise of torques in place of
held exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve_banded

from ident.equations.filter import STANDING, Decimator, filtered_windows
from ident.equations.rows import (
    Rows,
    Scene,
    corrected,
    informing,
    largest_transmission,
    residual,
    rows,
)
from ident.equations.terms import Samples
from ident.equations.unknowns import Columns, Point
from ident.information.time_bases import Basis, Chunk, Elimination, eliminate
from ident.mechanism.mechanism import Mechanism
from ident.motion.smoothing import through_motion
from ident.motion.spline import WIDTH, Smooth, Spline, fitted
from ident.motion.state import State

STEP = 1e-6  # numerics: of the spread of a coordinate or its derivative
LOOKED_AT = 60  # work: samples of a log whose motion's noise is looked at
LONGEST = 2000  # work: functions of a run that are looked at
BLOCKS = 40  # work: of time, of a run
FASTER = 2.0  # level: cut-off of the rows over the rate of knots: all that splines resolve
NYQUIST = 0.4  # level: of the log's rate, above which nothing is filtered
PERIOD = 8.0  # numerics: samples of G to a period of the cut-off; between, interpolated


def gain(
    mechanism: Mechanism, e: State, names: tuple[str, ...], point: Point, cutoff: float | None
) -> np.ndarray:
    """G (n, d, coordinates, 3) of all samples of a state, which may be thinned, at a point.

    The joints `names` are moved, others of `e.logged` stay; `cutoff` [Hz] is that of the rows.
    """

    def at(e: State) -> Samples:
        return corrected(Samples(mechanism, e, slice(None), point), cutoff)

    base = residual(at(e))
    G = np.empty((*base.shape, len(names), 3))
    given = names if len(e.logged) > mechanism.degrees_of_freedom else e.logged
    known = e.known(mechanism, given)
    for i, name in enumerate(names):
        for order, start in enumerate(("near", "same", "same")):
            moved = known.copy()
            series = moved[order][:, given.index(name)]
            step = STEP * (float(np.std(series)) or 1.0)
            series += step
            beside = residual(at(e.at(mechanism, moved, given, start=start)))
            G[:, :, i, order] = (beside - base) / step
    whole = Samples(mechanism, e, slice(None), point).reduced(slice(None))
    G[~informing(whole, largest_transmission(e))] = 0.0
    return G


def motion_noise(mechanism: Mechanism, e: State, point: Point, cutoff: float | None) -> np.ndarray:
    """(d,) variance of r that noise of the smooth motion makes in the filtered rows of a log.

    G changes with the motion, slowly beside the filter's taps f_k: F G B c ≈ G Σ f_k B(t_k) c.
    """
    assert e.smooth is not None
    near, passing = np.zeros(len(e), dtype=bool), Decimator.of(cutoff, e.rate)
    for run, spline in e.smooth.runs:
        whole = slice(run.start + passing.half, max(run.stop - passing.half, run.start))
        last = spline.basis.t0 + (LONGEST - WIDTH) * spline.basis.spacing
        near[whole] = e.t[whole] < last - passing.half / e.rate
    usable = np.flatnonzero(e.usable & near)
    if not len(usable):  # no longer than the filter, which leaves no rows
        return np.zeros(e.leverage.shape[2])
    chosen = usable[:: max(1, len(usable) // LOOKED_AT)]
    some = e.at_samples(chosen)
    G = gain(mechanism, some, e.smooth.names, point, cutoff)
    total = np.zeros(G.shape[1])
    for run, spline in e.smooth.runs:
        inside = (chosen >= run.start) & (chosen < run.stop)
        if inside.any():
            P = _spread(spline, e.t[chosen[inside]], passing.taps, 1 / e.rate)
            g = G[inside].reshape(len(P), G.shape[1], -1)
            total += ((g @ P.reshape(len(P), g.shape[2], -1)) * g).sum(axis=(0, 2))
    return total / max(len(chosen), 1)


def torque_noise(mechanism: Mechanism, e: State, cutoff: float | None) -> np.ndarray:
    """(d,) white noise of the measured torques that the rows' filter lets pass [N m | N]."""
    taps = Decimator.of(cutoff, e.rate).taps
    passed = 1.0 if taps is None else float(np.sqrt(taps @ taps))
    squares = np.zeros(e.leverage.shape[2])
    for name in mechanism.driven:
        W = e.leverage[e.usable, mechanism.joint_index[name]]
        squares += e.noise.get(f"tau.{name}", 0.0) ** 2 * (W**2).sum(axis=0)
    return passed * np.asarray(np.sqrt(squares / max(int(e.usable.sum()), 1)))


def noise_floor(
    mechanism: Mechanism, experiments: Sequence[State], point: Point, cutoff: float | None
) -> np.ndarray:
    """(d,) rms of r that noise of the sensors makes, of torques and motion together [N m | N]."""
    squares = [
        torque_noise(mechanism, e, cutoff) ** 2
        + (0.0 if e.smooth is None else motion_noise(mechanism, e, point, cutoff))
        for e in experiments
    ]
    return np.asarray(np.sqrt(np.mean(squares, axis=0)))


def _spread(spline: Spline, t: np.ndarray, taps: np.ndarray | None, step: float) -> np.ndarray:
    """P (n, d, 3, d, 3) of u, u̇, ü at times t (n,), through a filter of taps a step [s] apart."""
    basis, (count, d) = spline.basis, spline.c.shape
    each, n = d // len(spline.factors), len(t)
    size = min(count, LONGEST) * each  # the leading block of N has that of its factor
    taps = np.ones(1) if taps is None else taps
    lags = step * (np.arange(len(taps)) - len(taps) // 2)
    at = np.clip(t[:, None] + lags, basis.t0, basis.t_end)  # (n, taps)
    B = np.zeros((n, each, 3, size))
    row = np.repeat(np.arange(n), len(taps))
    for order in range(3):
        first, values = basis.window(at.ravel(), order)
        values = values * np.tile(taps, n)[:, None]
        for i in range(each):
            for r in range(WIDTH):
                np.add.at(B[:, i, order], (row, (first + r) * each + i), values[:, r])
    P = np.zeros((n, d, 3, d, 3))
    for k, lower in enumerate(spline.factors):
        solved = cho_solve_banded((lower[:, :size], True), B.reshape(-1, size).T).T
        mine = slice(k * each, (k + 1) * each)
        P[:, mine, :, mine] = np.einsum("nirk,njsk->nirjs", B, solved.reshape(B.shape))
    return P


@dataclass(frozen=True, eq=False)
class TorqueRows:
    """The n rows of one run, at c₀, before they are weighed, with w functions in reach."""

    rows: Rows
    first: np.ndarray  # (n,) the first function in reach
    L: np.ndarray  # (n, w, coordinates, d), F G B

    def residual(self, x: np.ndarray) -> np.ndarray:
        """b − A x (n, d), zero where rows do not inform."""
        return np.where(self.rows.informed, self.rows.b - self.rows.A @ x, 0.0)


def weighed(torques: TorqueRows, spline: Spline, c: np.ndarray, sigma: np.ndarray) -> list[Chunk]:
    """The run's rows, made at c (count, coordinates), divided by their noise σ (d,)."""
    w, d = torques.L.shape[1], torques.L.shape[3]
    off = c - spline.c
    known = np.einsum("nwid,nwi->nd", torques.L, off[torques.first[:, None] + np.arange(w)])
    chunks, rows = [], torques.rows
    for u in range(d):
        at = rows.informed[:, u]
        L, A, b = -torques.L[at, :, :, u], rows.A[at, u], (rows.b - known)[at, u]
        chunks.append(Chunk(torques.first[at], L / sigma[u], A / sigma[u], b / sigma[u]))
    # U's windows of WIDTH functions as windows of w
    n, low = len(spline.first), np.minimum(spline.first, spline.basis.count - w)
    wide = np.zeros((n, w, spline.U.shape[2]))
    wide[np.arange(n)[:, None], (spline.first - low)[:, None] + np.arange(WIDTH)] = spline.U
    return [*chunks, Chunk(low, wide, np.zeros((n, rows.A.shape[2])), np.zeros(n))]


@dataclass(frozen=True, eq=False)
class EliminatedRun:
    """One run of samples with its motion, or its multipliers in a time basis, eliminated."""

    experiment: int  # its number
    segment: slice  # its samples
    basis: Basis  # of the motion, or of λ(t)
    elimination: Elimination  # factors of the parameters and the way back to c − ĉ or a

    @classmethod
    def of(cls, number: int, segment: slice, basis: Basis, chunks: list[Chunk]) -> EliminatedRun:
        """Eliminate the coefficients from the rows of a run, parted in blocks of time."""
        blocks = max(1, min(BLOCKS, basis.count // 4))
        return cls(number, segment, basis, eliminate(chunks, basis.count, blocks))


@dataclass(frozen=True, eq=False)
class Linear:
    """The likelihood of one experiment, linear about its present motion."""

    fine: Smooth  # splines with ĉ and U
    c: tuple[np.ndarray, ...]  # by run, (count, coordinates) of the present motion
    torques: tuple[TorqueRows | None, ...]  # rows of each run that has any

    def eliminated(self, number: int, sigma: np.ndarray) -> list[EliminatedRun]:
        """All runs of experiment `number`, for torque rows of noise sigma (d,)."""
        found = []
        for (segment, spline), c, torques in zip(self.fine.runs, self.c, self.torques, strict=True):
            if torques is not None:
                chunks = weighed(torques, spline, c, sigma)
                found.append(EliminatedRun.of(number, segment, spline.basis, chunks))
        return found

    def residual_squares(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(d,) Σ |b − A x|² of the rows that inform, and their number."""
        some = [torques for torques in self.torques if torques is not None]
        squares = sum((torques.residual(x) ** 2).sum(axis=0) for torques in some)
        return np.asarray(squares), np.asarray(sum(each.rows.informed.sum(axis=0) for each in some))

    def loss(self, x: np.ndarray, sigma: np.ndarray) -> float:
        """|U (c − ĉ)|² + Σ |b − A x|² / σ² at the present motion, for x (k,)."""
        total = 0.0
        for (_, spline), c, torques in zip(self.fine.runs, self.c, self.torques, strict=True):
            if torques is None:
                continue
            off = (c - spline.c)[spline.first[:, None] + np.arange(spline.U.shape[1])]
            total += float((np.einsum("nwi,nwi->n", spline.U, off) ** 2).sum())
            total += float(((torques.residual(x) / sigma) ** 2).sum())
        return total

    def moved(self, runs: Sequence[EliminatedRun], x: np.ndarray) -> Smooth:
        """The motion that goes with the parameters x (k,)."""
        steps = {run.segment.start: run.elimination.back_substitute(x) for run in runs}
        found = []
        for (segment, spline), c in zip(self.fine.runs, self.c, strict=True):
            c = spline.c + steps[segment.start] if segment.start in steps else c
            found.append((segment, replace(spline, c=c)))
        return replace(self.fine, runs=tuple(found))


def rows_cutoff(fine: Smooth, rate: float) -> float | None:
    """Cut-off of the likelihood's rows [Hz]: far above the motion, so that reversals stay sharp."""
    cutoff = FASTER / fine.spacing
    return cutoff if cutoff < NYQUIST * rate else None


def linear(
    mechanism: Mechanism,
    columns: Columns,
    e: State,
    fine: Smooth,
    point: Point,
    like: Linear | None = None,
) -> Linear:
    """The likelihood about a smooth motion e, `fine` the splines with what channels say of them.

    Rows inform or not as they do in `like`, about an earlier motion.
    """
    cutoff = rows_cutoff(fine, e.rate)
    every = 1 if cutoff is None else max(1, int(e.rate / (PERIOD * cutoff)))
    some = e.thinned(every)
    G = gain(mechanism, some, fine.names, point, cutoff)
    if every > 1:
        G = _between(e.t, some.t, G)
    decimator = Decimator.of(cutoff, e.rate)
    scene = Scene.of(mechanism, columns, e, point, cutoff)
    pieces = [*rows(scene, cutoff, STANDING)]
    coefficients: list[np.ndarray] = []
    torques: list[TorqueRows | None] = []
    for k, (segment, spline) in enumerate(fine.runs):
        channels = through_motion(mechanism, e, fine.names)
        inside = [channel.within(e.t[segment]) for channel in channels]
        coefficients.append(fitted(spline.basis, inside, fine.names).c)
        mine = [p for p in pieces if segment.start <= p.sample[0] < segment.stop]
        if not mine:
            torques.append(None)
            continue
        run = Rows.joined(mine)
        before = None if like is None else like.torques[k]
        if before is not None and np.array_equal(run.t, before.rows.t):
            run = replace(run, informed=before.rows.informed)
        at = np.clip(e.t[segment], spline.basis.t0, spline.basis.t_end)
        windows = [spline.basis.window(at, order) for order in range(3)]
        values = sum(
            B[:, :, None, None] * G[segment, :, :, order].transpose(0, 2, 1)[:, None]
            for order, (_, B) in enumerate(windows)
        )
        first, L = filtered_windows(
            decimator, spline.basis, e.t[segment], windows[0][0], np.asarray(values),
            run.sample - segment.start,
        )  # fmt: skip
        torques.append(TorqueRows(run, first, L))
    return Linear(fine, tuple(coefficients), tuple(torques))


def _between(t: np.ndarray, at: np.ndarray, G: np.ndarray) -> np.ndarray:
    """G at the times t (n,), linear between the times `at`."""
    right = np.clip(np.searchsorted(at, t), 1, len(at) - 1)
    share = (t - at[right - 1]) / (at[right] - at[right - 1])
    share = np.clip(share, 0.0, 1.0)[:, None, None, None]
    return (1 - share) * G[right - 1] + share * G[right]
