"""Samples on a uniform clock, numbered: where numbers jump, something is missing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ident.motion.clock import GAP, UNEVEN


@dataclass(frozen=True, eq=False)
class Run:
    """Samples without a gap between them.

    Attributes:
        number: of the first, in steps of the clock; the others follow one by one.
        X: (n, columns), `t` [s] first.
    """

    number: int
    X: np.ndarray

    def __len__(self) -> int:
        return len(self.X)


class Clock:
    """A uniform clock for samples as they come, as `complete` has one for a whole log.

    Samples that are in step are taken as they are; the clock follows them. Others are interpolated
    on it, one sample late. Beyond a gap it begins anew.

    Args:
        rate: of the clock [Hz].
        free: whether nothing needs a uniform clock: then every sample is taken as it is.
    """

    def __init__(self, rate: float, free: bool) -> None:
        self._dt, self._free = 1.0 / rate, free
        self._last: np.ndarray | None = None  # the last sample that came
        self._t, self._number = 0.0, -1  # of the last instant of the clock

    def __call__(self, X: np.ndarray) -> Iterator[Run]:
        """The runs that samples X (n, columns), `t` first, make."""
        t = X[:, 0]
        if self._last is None:
            yield from self._begin(X[:1])
            X, t = X[1:], t[1:]
        if len(X) and not self._free and self._uneven(t):
            yield from _joined(self._resampled(X))
        elif len(X):
            yield self._run(X)

    def _uneven(self, t: np.ndarray) -> bool:
        due = self._t + self._dt * np.arange(1, len(t) + 1)
        drift = (t[-1] - due[-1]) * np.arange(1, len(t) + 1) / len(t)
        return bool(
            abs(drift[-1]) > UNEVEN * self._dt * len(t)
            or np.abs(t - due - drift).max() > UNEVEN * self._dt
        )

    def _begin(self, X: np.ndarray) -> Iterator[Run]:
        """A run that begins with the sample X (1, columns), after whatever was missing."""
        missing = (X[0, 0] - self._t) / self._dt if self._number >= 0 else 1.0
        self._number += max(2, round(missing)) - 1 if self._number >= 0 else 0
        yield self._run(X)

    def _run(self, X: np.ndarray) -> Run:
        run = Run(self._number + 1, X)
        self._last, self._t, self._number = X[-1], float(X[-1, 0]), self._number + len(X)
        return run

    def _resampled(self, X: np.ndarray) -> Iterator[Run]:
        for sample in X:
            assert self._last is not None
            if sample[0] - self._last[0] > GAP * self._dt:
                yield from self._begin(sample[None])
                continue
            count = int((sample[0] - self._t) / self._dt + UNEVEN)
            if count < 1:
                self._last = sample
                continue
            due = self._t + self._dt * np.arange(1, count + 1)
            if count == 1 and abs(sample[0] - due[0]) < UNEVEN * self._dt:
                yield self._run(sample[None])
                continue
            share = np.clip((due - self._last[0]) / (sample[0] - self._last[0]), 0.0, 1.0)
            between = self._last + share[:, None] * (sample - self._last)
            between[:, 0] = due
            yield Run(self._number + 1, between)
            self._last, self._t, self._number = sample, float(due[-1]), self._number + count


def _joined(runs: Iterable[Run]) -> Iterator[Run]:
    """Runs that follow one another as one."""
    waiting: list[Run] = []
    for run in runs:
        if waiting and waiting[-1].number + len(waiting[-1]) != run.number:
            yield Run(waiting[0].number, np.concatenate([each.X for each in waiting]))
            waiting = []
        waiting.append(run)
    if waiting:
        yield Run(waiting[0].number, np.concatenate([each.X for each in waiting]))
