"""Samples of a stream that are kept, and the error budget in their equations.

    stretches of L samples:   0 1 2 3 …  all, while they are few;   0 2 4 …,   0 4 8 …

A budget needs rows with columns of causes, which the triangles of a stream do not have; long logs
have it of an excerpt as well (`fit.calibration_rows`). With forgetting the last 2T are kept, and
count alike: as many equations tell as much as all with the weights exp(−age/T).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.equations.problem import Problem
from ident.equations.table import SMOOTH, Table
from ident.fit.calibration import Budget, budget_of
from ident.fit.calibration_rows import SAMPLES, STRETCHES, FitRows, ReducedRows
from ident.information.blocks import Information
from ident.information.estimate import Estimate
from ident.information.linear import Array
from ident.mechanism.causes import CalibrationError
from ident.motion import Motion
from ident.motion.signals import GAP
from ident.motion.state import State
from ident.streams.stream import TOGETHER, Stream

LASTING = 2.0  # level: time constants of forgetting: (Σ w)²/Σ w² equations, w = exp(−age/T)
NEW = 0.2  # work: share of the equations, from which a budget is made anew: noise is 10 % less


class SampleExcerpt:
    """Samples (n, columns), `t` first, as they come, in bounded memory: evenly over the time."""

    def __init__(self, rate: float, cutoff: float | None, forget: float | None) -> None:
        step = max(1, int(rate / (SMOOTH * cutoff))) if cutoff else 1
        self._length = max(1, SAMPLES * step // STRETCHES)  # samples of a stretch
        self._span = LASTING * forget if forget else np.inf  # [s] that are kept
        self._longest_step = GAP / rate  # [s] between two samples of a run
        self._every, self._begun = 1, 0  # of so many stretches one is kept; how many began
        self._room = 0  # samples that the present stretch still takes
        self._stretches: list[tuple[int, list[Array]]] = []  # number, and its samples
        self._waiting, self._count = list[Array](), 0  # samples that are in no stretch yet

    def add(self, X: Array) -> None:
        """Take further samples."""
        self._waiting.append(X)
        self._count += len(X)
        if self._count >= TOGETHER:
            self._take()

    def _take(self) -> None:
        """Put samples that wait into stretches."""
        X, self._waiting, self._count = np.concatenate(self._waiting), [], 0
        while len(X):
            if not self._room:
                self._begin(float(X[0, 0]))
            number, parts = self._begun - 1, self._stretches[-1][1] if self._stretches else []
            if not number % self._every:
                parts.append(X[: self._room])
            X, self._room = X[self._room :], max(0, self._room - len(X))

    def _begin(self, t: float) -> None:
        """Begin a stretch at a time [s]: leave out old ones, and of too many every second."""
        stretches = self._stretches
        while stretches and stretches[0][1] and float(stretches[0][1][-1][-1, 0]) < t - self._span:
            del stretches[0]
        if len(stretches) >= 2 * STRETCHES:
            self._every *= 2
            stretches[:] = [(k, parts) for k, parts in stretches if not k % self._every]
        for i, (k, parts) in enumerate(stretches[-1:], start=len(stretches) - 1):
            stretches[i] = k, [np.concatenate(parts)]
        if not self._begun % self._every:
            stretches.append((self._begun, []))
        self._begun, self._room = self._begun + 1, self._length

    @property
    def runs(self) -> Iterator[Array]:
        """Samples (n, columns) that follow each other without a gap."""
        if self._waiting:
            self._take()
        stretches = [np.concatenate(parts) for _, parts in self._stretches if parts]
        if not stretches:
            return
        X = np.concatenate(stretches)
        X = X[X[:, 0] >= X[-1, 0] - self._span]
        yield from np.split(X, np.flatnonzero(np.diff(X[:, 0]) > self._longest_step) + 1)

    def states(self, stream: Stream) -> tuple[State, ...]:
        """Return the states of a stream's machine in these samples."""
        every = (stream.state_of(X) for X in self.runs)
        return tuple(e for e in every if e is not None and e.usable.any())


@dataclass(frozen=True, eq=False)
class StreamRows(ReducedRows):
    """Rows of the kept samples, of an estimate by all rows of the stream."""

    def excerpt(self) -> FitRows:
        """Return these."""
        return self

    def corrected(self, x: Array, causes: Sequence[CalibrationError], values: Array) -> FitRows:
        """Return the rows of corrected samples and mechanism."""
        corrected = super().corrected(x, causes, values)
        (table,) = corrected.tables
        return replace(self, table=table)


def budget_of_samples(
    stream: Stream,
    motion: Motion,
    excerpt: SampleExcerpt,
    information: Information,
    fitted: Estimate,
) -> Budget | None:
    """Return the error budget of an estimate by all rows of a stream, in the rows of the samples
    that were kept; `motion`: whose decisions these have in common. None where nothing may be wrong.
    """
    mechanism, columns, states = stream.mechanism, stream.columns, excerpt.states(stream)
    if mechanism.calibration.exact or mechanism.covariance is not None or not states:
        return None
    motion = replace(motion, experiments=states)
    point = stream.point.at(mechanism, columns, fitted.x)
    problem = Problem(mechanism, motion, stream.point, columns, information)
    return budget_of(StreamRows(problem, Table.of(mechanism, columns, motion, point)), fitted)
