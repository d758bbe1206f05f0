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

G is found by differences of r between neighbouring states (`motion.neighbours`): everything that a
motion enters is in them, closures, effects and corrections too. At standstill dry friction is open,
and no motion is asked to make it otherwise.

Sources: W. Fuller, Measurement Error Models, 1987, sect. 3.2 (functional model); K. Schittkowski,
Numerical Data Fitting in Dynamical Systems, 2002; direct collocation as in L. Biegler, Nonlinear
Programming, 2010, ch. 10, with the equations of motion weighed by the noise of torques in place of
held exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.equations.filter import STANDING, Decimator, filtered_windows
from ident.equations.nearby import linearized
from ident.equations.rows import Rows, Scene, corrected, informing, largest_transmission, rows
from ident.equations.terms import Samples, residual
from ident.equations.unknowns import Columns, Point
from ident.information.lapack import solve_cholesky_banded
from ident.information.time_bases import Basis, Chunk, Elimination, eliminate
from ident.mechanism.mechanism import Mechanism
from ident.motion.neighbours import Neighbours
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

    now = at(e)
    base = residual(now)
    G = np.empty((*base.shape, len(names), 3))
    given = names if len(e.logged) > mechanism.degrees_of_freedom else e.logged
    known, neighbours = e.known(mechanism, given), Neighbours(mechanism, e, given)
    for i, name in enumerate(names):
        for order in range(3):
            step = STEP * (float(np.std(known[order][:, given.index(name)])) or 1.0)
            if mechanism.closures:
                shifted_state = neighbours.shifted(name, order, step)
            else:
                shifted = known.copy()
                shifted[order][:, given.index(name)] += step
                shifted_state = e.at(mechanism, shifted, given)
            G[:, :, i, order] = (residual(linearized(at(shifted_state), now)) - base) / step
    samples = Samples(mechanism, e, slice(None), point).reduced(slice(None))
    G[~informing(samples, largest_transmission(e))] = 0.0
    return G


def motion_noise(mechanism: Mechanism, e: State, point: Point, cutoff: float | None) -> np.ndarray:
    """(d,) variance of r that noise of the smooth motion makes in the filtered rows of a log.

    G changes with the motion, slowly beside the filter's taps f_k: F G B c ≈ G Σ f_k B(t_k) c.
    """
    assert e.smooth is not None
    near, passing = np.zeros(len(e), dtype=bool), Decimator.of(cutoff, e.rate)
    for run, spline in e.smooth.runs:
        inner = slice(run.start + passing.half, max(run.stop - passing.half, run.start))
        last = spline.basis.t0 + (LONGEST - WIDTH) * spline.basis.spacing
        near[inner] = e.t[inner] < last - passing.half / e.rate
    usable = np.flatnonzero(e.usable & near)
    if not len(usable):  # no longer than the filter, which leaves no rows
        return np.zeros(e.leverage.shape[2])
    chosen = usable[:: max(1, len(usable) // LOOKED_AT)]
    looked_at = e.at_samples(chosen)
    G = gain(mechanism, looked_at, e.smooth.names, point, cutoff)
    total = np.zeros(G.shape[1])
    for run, spline in e.smooth.runs:
        inside = (chosen >= run.start) & (chosen < run.stop)
        if inside.any():
            P = _spread(spline, e.t[chosen[inside]], passing.taps, 1 / e.rate)
            g = G[inside].reshape(len(P), G.shape[1], -1)
            total += ((g @ P.reshape(len(P), g.shape[2], -1)) * g).sum(axis=(0, 2))
    return total / max(len(chosen), 1)


def torque_noise(mechanism: Mechanism, e: State, cutoff: float | None, point: Point) -> np.ndarray:
    """(d,) white noise of the measured torques that the rows' filter lets pass [N m | N], and of
    forces at places that depend on logged inputs.
    """
    taps = Decimator.of(cutoff, e.rate).taps
    passed = 1.0 if taps is None else float(np.sqrt(taps @ taps))
    squares, rows, times = np.zeros(e.leverage.shape[2]), e.usable, 1
    if e.loop is None:  # of all samples the same
        rows, times = np.arange(len(e)) < 1, int(np.count_nonzero(e.usable))
    for name in mechanism.driven:
        W = e.leverage[rows, mechanism.joint_index[name]]
        squares += e.noise.get(f"tau.{name}", 0.0) ** 2 * times * (W**2).sum(axis=0)
    base = Samples(mechanism, e, slice(None), point).reduced(slice(None))
    for effect in mechanism.effects:
        c, shape = point.of(effect)
        for column in effect.reads() if effect.site == "frame" else ():
            noisy = {**e.extra, column: e.extra[column] + e.noise.get(column, 0.0)}
            both = np.zeros((2, *base.shape))
            for out, extra in zip(both, (e.extra, noisy), strict=True):
                replace(base, e=replace(e, extra=extra)).add_effect(out, effect, c, shape)
            squares += (np.diff(both, axis=0)[0, e.usable] ** 2).sum(axis=0)
    return passed * np.asarray(np.sqrt(squares / max(int(e.usable.sum()), 1)))


def noise_floor(
    mechanism: Mechanism, experiments: Sequence[State], point: Point, cutoff: float | None
) -> np.ndarray:
    """(d,) rms of r that noise of the sensors makes, of torques and motion together [N m | N]."""
    squares = [
        torque_noise(mechanism, e, cutoff, point) ** 2
        + (0.0 if e.smooth is None else motion_noise(mechanism, e, point, cutoff))
        for e in experiments
    ]
    return np.asarray(np.sqrt(np.mean(squares, axis=0)))


def _spread(spline: Spline, t: np.ndarray, taps: np.ndarray | None, step: float) -> np.ndarray:
    """P (n, d, 3, d, 3) of u, u̇, ü at times t (n,), through a filter of taps a step [s] apart."""
    basis, (count, d) = spline.basis, spline.c.shape
    per_factor, n = d // len(spline.factors), len(t)
    size = min(count, LONGEST) * per_factor  # the leading block of N has that of its factor
    taps = np.ones(1) if taps is None else taps
    lags = step * (np.arange(len(taps)) - len(taps) // 2)
    at = np.clip(t[:, None] + lags, basis.t0, basis.t_end)  # (n, taps)
    B = np.zeros((n, per_factor, 3, size))
    row = np.repeat(np.arange(n), len(taps))
    for order in range(3):
        first, values = basis.window(at.ravel(), order)
        values = values * np.tile(taps, n)[:, None]
        for i in range(per_factor):
            for r in range(WIDTH):
                np.add.at(B[:, i, order], (row, (first + r) * per_factor + i), values[:, r])
    P = np.zeros((n, d, 3, d, 3))
    for k, lower in enumerate(spline.factors):
        solved = solve_cholesky_banded(lower[:, :size], B.reshape(-1, size).T).T
        columns = slice(k * per_factor, (k + 1) * per_factor)
        P[:, columns, :, columns] = np.einsum("nirk,njsk->nirjs", B, solved.reshape(B.shape))
    return P


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
class LinearRun:
    """The likelihood of a run of n torque rows, linear about its motion; w functions a row."""

    experiment: int  # its number
    segment: slice  # its samples
    spline: Spline  # ĉ and U
    c: np.ndarray  # (count, coordinates) of the present motion
    rows: Rows  # at c, before they are weighed
    first: np.ndarray  # (n,) the first function in reach
    L: np.ndarray  # (n, w, coordinates, d), F G B
    independent: float = 1.0  # share of the rows that white noise of the torques leaves independent

    def residual(self, x: np.ndarray) -> np.ndarray:
        """b − A x (n, d), zero where rows do not inform."""
        return np.where(self.rows.informed, self.rows.b - self.rows.A @ x, 0.0)

    def loss(self, x: np.ndarray, sigma: np.ndarray) -> float:
        """|U (c − ĉ)|² + Σ |b − A x|² / σ² at the present motion, for x (k,)."""
        spline = self.spline
        off = (self.c - spline.c)[spline.first[:, None] + np.arange(WIDTH)]
        parts = np.einsum("nwi,nwi->n", spline.U, off), self.residual(x) / self.density(sigma)
        return sum(float((part**2).sum()) for part in parts)

    def density(self, sigma: np.ndarray) -> np.ndarray:
        """(d,) noise of independent rows that says as much as σ (d,) of the filtered ones does.

        Rows are several to a period of the cut-off, and their noise hangs together: n rows say no
        more than the `independent` share of them, each with the noise σ.
        """
        return np.asarray(sigma / np.sqrt(self.independent))

    def eliminated(self, sigma: np.ndarray) -> EliminatedRun:
        """The run without its motion, from torque rows divided by their noise σ (d,)."""
        spline, rows, w = self.spline, self.rows, self.L.shape[1]
        off = self.c - spline.c
        known = np.einsum("nwid,nwi->nd", self.L, off[self.first[:, None] + np.arange(w)])
        chunks = []
        for u, noise in enumerate(self.density(sigma)):
            at = rows.informed[:, u]
            L, A, b = -self.L[at, :, :, u], rows.A[at, u], (rows.b - known)[at, u]
            chunks.append(Chunk(self.first[at], L / noise, A / noise, b / noise))
        # U's windows of WIDTH functions as windows of w
        n, low = len(spline.first), np.minimum(spline.first, spline.basis.count - w)
        wide = np.zeros((n, w, spline.U.shape[2]))
        wide[np.arange(n)[:, None], (spline.first - low)[:, None] + np.arange(WIDTH)] = spline.U
        chunks.append(Chunk(low, wide, np.zeros((n, rows.A.shape[2])), np.zeros(n)))
        return EliminatedRun.of(self.experiment, self.segment, spline.basis, chunks)


def rows_cutoff(fine: Smooth, rate: float) -> float | None:
    """Cut-off of the likelihood's rows [Hz]: far above the motion, so that reversals stay sharp."""
    cutoff = FASTER / fine.spacing
    return cutoff if cutoff < NYQUIST * rate else None


def linear_runs(
    mechanism: Mechanism,
    columns: Columns,
    experiment: tuple[int, State],
    fine: Smooth,
    point: Point,
    like: Sequence[LinearRun] = (),
) -> list[LinearRun]:
    """The runs that have rows of an experiment (number, state), on splines with what channels say
    of them (`fine`). Rows inform or not as they do in `like`, about an earlier motion.
    """
    number, e = experiment
    cutoff = rows_cutoff(fine, e.rate)
    every = 1 if cutoff is None else max(1, int(e.rate / (PERIOD * cutoff)))
    coarse = e.thinned(every)
    G = gain(mechanism, coarse, fine.names, point, cutoff)
    if every > 1:
        from scipy.interpolate import make_interp_spline  # takes 0.2 s to import

        G = make_interp_spline(coarse.t, G, k=1)(np.minimum(e.t, coarse.t[-1]))
    decimator, channels = Decimator.of(cutoff, e.rate), through_motion(mechanism, e, fine.names)
    pieces = [*rows(Scene.of(mechanism, columns, e, point, cutoff), cutoff, STANDING)]
    informed = {
        previous.segment.start: previous.rows for previous in like if previous.experiment == number
    }
    runs = []
    for segment, spline in fine.runs:
        inside = [p for p in pieces if segment.start <= p.sample[0] < segment.stop]
        if not inside:
            continue
        t, basis, run = e.t[segment], spline.basis, Rows.concatenated(inside)
        c = fitted(basis, [channel.within(t) for channel in channels], fine.names).c
        before = informed.get(segment.start)
        if before is not None and np.array_equal(run.t, before.t):
            run = replace(run, informed=before.informed)
        at = np.clip(t, basis.t0, basis.t_end)
        windows = [basis.window(at, order) for order in range(3)]
        values = sum(
            B[:, :, None, None] * G[segment, :, :, order].transpose(0, 2, 1)[:, None]
            for order, (_, B) in enumerate(windows)
        )
        first, L = filtered_windows(
            decimator, basis, t, windows[0][0], np.asarray(values), run.sample - segment.start
        )
        runs.append(LinearRun(number, segment, spline, c, run, first, L, decimator.independent))
    return runs
