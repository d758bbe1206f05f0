"""One Gauss-Newton step of the likelihood: equations of x alone, and the way back to the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.equations.columns import Columns
from ident.equations.filter import Decimator
from ident.equations.point import Point
from ident.equations.rows import Rows, rows
from ident.equations.scene import Scene
from ident.likelihood.collocate import Torques, joined, reach, weighed
from ident.likelihood.gain import gain
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment
from ident.motion.fuse import through_motion
from ident.motion.smooth import Smooth, fitted
from ident.solve.basis import Basis
from ident.solve.eliminate import Elimination, eliminate

BLOCKS = 40
FASTER = 2.0  # cut-off of the rows over the rate of the motion's knots: all that splines resolve
NYQUIST = 0.4  # of the log's rate, above which nothing is filtered
STICKING = 0.01  # share of a row that may come from standstill, where friction jumps
PERIOD = 8.0  # samples of G to a period of the rows' cut-off; between them it is interpolated


@dataclass(frozen=True, eq=False)
class Run:
    """One run of samples with its motion eliminated.

    Attributes:
        experiment: its number; segment: its samples.
        basis: of the motion; elimination: factors of the parameters and the way back to c − ĉ.
    """

    experiment: int
    segment: slice
    basis: Basis
    elimination: Elimination


@dataclass(frozen=True, eq=False)
class Linear:
    """The likelihood of one experiment, linear about its present motion.

    Attributes:
        fine: splines with ĉ and U; c: by run, (count, coordinates) of the present motion.
        torques: rows of each run that has any.
    """

    fine: Smooth
    c: tuple[np.ndarray, ...]
    torques: tuple[Torques | None, ...]

    def eliminated(self, number: int, sigma: np.ndarray) -> list[Run]:
        """All runs of experiment `number`, for torque rows of noise sigma (d,)."""
        found = []
        for (segment, spline), c, torques in zip(self.fine.runs, self.c, self.torques, strict=True):
            if torques is not None:
                count = spline.basis.count
                blocks = max(1, min(BLOCKS, count // 4))
                chunks = weighed(torques, spline, c, sigma)
                found.append(Run(number, segment, spline.basis, eliminate(chunks, count, blocks)))
        return found

    def left(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(d,) Σ |b − A x|² of the rows that inform, and their number."""
        squares, count = 0.0, 0.0
        for torques in self.torques:
            if torques is not None:
                r = np.where(torques.informed, torques.b - torques.A @ x, 0.0)
                squares, count = squares + (r**2).sum(axis=0), count + torques.informed.sum(axis=0)
        return np.asarray(squares), np.asarray(count)

    def loss(self, x: np.ndarray, sigma: np.ndarray) -> float:
        """|U (c − ĉ)|² + Σ |b − A x|² / σ² at the present motion, for x (k,)."""
        total = 0.0
        for (_, spline), c, torques in zip(self.fine.runs, self.c, self.torques, strict=True):
            if torques is None:
                continue
            off = (c - spline.c)[spline.first[:, None] + np.arange(spline.U.shape[1])]
            total += float((np.einsum("nwi,nwi->n", spline.U, off) ** 2).sum())
            r = (torques.b - torques.A @ x) / sigma
            total += float((r[torques.informed] ** 2).sum())
        return total

    def between(self, other: Linear) -> Smooth:
        """The motion halfway to another one."""
        found = tuple(
            (segment, replace(spline, c=0.5 * (a + b)))
            for (segment, spline), a, b in zip(self.fine.runs, self.c, other.c, strict=True)
        )
        return Smooth(self.fine.names, self.fine.spacing, found, self.fine.channels)

    def moved(self, runs: Sequence[Run], x: np.ndarray) -> Smooth:
        """The motion that goes with the parameters x (k,)."""
        by_segment = {run.segment.start: run for run in runs}
        found = []
        for (segment, spline), c in zip(self.fine.runs, self.c, strict=True):
            if segment.start in by_segment:
                step = by_segment[segment.start].elimination.back_substitute(x)
                c = spline.c + step
            found.append((segment, replace(spline, c=c)))
        return Smooth(self.fine.names, self.fine.spacing, tuple(found), self.fine.channels)


def rows_cutoff(fine: Smooth, rate: float) -> float | None:
    """Of the likelihood's rows [Hz]: well above the motion, so that little is lost at reversals."""
    cutoff = FASTER / fine.spacing
    return cutoff if cutoff < NYQUIST * rate else None


def linear(
    mechanism: Mechanism,
    columns: Columns,
    e: Experiment,
    fine: Smooth,
    point: Point,
    like: Linear | None = None,
) -> Linear:
    """The likelihood about an experiment's motion.

    Args:
        mechanism, columns: the model and its unknowns.
        e: the experiment, on a smooth motion.
        fine: the splines of the likelihood, with what the channels say of them.
        point: values of all parameters.
        like: about an earlier motion, whose rows inform or not as they did there.
    """
    cutoff = rows_cutoff(fine, e.rate)
    every = 1 if cutoff is None else max(1, int(e.rate / (PERIOD * cutoff)))
    some = e.thinned(every)
    G = gain(mechanism, some, fine.names, point, cutoff)
    if every > 1:
        G = _between(e.t, some.t, G)
    decimator = Decimator.of(cutoff, e.rate)
    pieces: list[Rows] = list(
        rows(Scene.of(mechanism, columns, e, point, cutoff), cutoff, STICKING)
    )
    coefficients: list[np.ndarray] = []
    torques: list[Torques | None] = []
    for segment, spline in fine.runs:
        t = e.t[segment]
        coefficients.append(_coefficients(spline.basis, e, segment, fine.names, mechanism))
        mine = []
        for piece in pieces:
            inside = (piece.sample >= segment.start) & (piece.sample < segment.stop)
            if inside.any():
                sample = piece.sample[inside] - segment.start
                first, L = reach(spline.basis, t, G[segment], decimator, sample)
                A, b, told = (x[inside] for x in (piece.A, piece.b, piece.informed))
                mine.append(Torques(A, b, told, first, L, piece.t[inside]))
        torques.append(joined(mine) if mine else None)
    if like is not None:
        torques = [
            now if now is None or before is None else now.informed_as(before)
            for now, before in zip(torques, like.torques, strict=True)
        ]
    return Linear(fine, tuple(coefficients), tuple(torques))


def _coefficients(
    basis: Basis, e: Experiment, segment: slice, names: tuple[str, ...], mechanism: Mechanism
) -> np.ndarray:
    """Of the experiment's motion (count, coordinates), which is a coarser spline or the same."""
    inside = [channel.within(e.t[segment]) for channel in through_motion(mechanism, e, names)]
    return fitted(basis, inside, names).c


def _between(t: np.ndarray, at: np.ndarray, G: np.ndarray) -> np.ndarray:
    """G at the times t (n,), linear between the times `at`."""
    right = np.clip(np.searchsorted(at, t), 1, len(at) - 1)
    share = (t - at[right - 1]) / (at[right] - at[right - 1])
    share = np.clip(share, 0.0, 1.0)[:, None, None, None]
    return (1 - share) * G[right - 1] + share * G[right]
