"""Rows as they come, in triangular factors: one an interval of time and independent coordinate.

Intervals stay few. Without forgetting all grow twice as long when there are too many, neighbours
merged pair by pair, so that they remain equal blocks for the jackknife; with forgetting the two
oldest merge.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from math import floor

import numpy as np

from ident.equations.rows import Rows
from ident.fit.accumulate import LENGTH, Cell
from ident.online.interval import Interval

MOST = 32  # intervals
SLACK = 1.25  # times as many, while pairs of them are merged one after the other
INTERVALS = 8.0  # in a time constant
TOGETHER = 16  # samples whose rows are absorbed at once


class Accumulator:
    """Absorbs rows in bounded memory.

    Args:
        supports: for each coordinate the unknowns that can appear in its rows.
        forget: T, the time constant of forgetting [s]; None: all rows count alike.
        period: time between two rows [s].

    Attributes:
        now: time of the last row [s]; informed: of the last that informs.
    """

    def __init__(self, supports: Sequence[np.ndarray], forget: float | None, period: float) -> None:
        self._supports, self._T = list(supports), forget
        self._length = LENGTH * period if forget is None else forget / INTERVALS
        self._start = 0.0
        self._intervals: list[Interval] = []
        self._open: Interval | None = None
        self._closed: Interval | None = None  # all intervals but the open one, together
        self._waiting: list[Rows] = []
        self.now = -np.inf
        self.informed = -np.inf

    def absorb(self, rows: Rows) -> None:
        """Takes rows, which come in the order of time."""
        if self.now == -np.inf:
            self._start = float(rows.t[0])
        self._waiting.append(rows)
        self.now = float(rows.t[-1])
        if sum(len(each.t) for each in self._waiting) >= TOGETHER:
            self._settle()

    def intervals(self) -> list[Interval]:
        """All intervals, oldest first, with weights that refer to now."""
        self._settle()
        both = [*self._intervals, *([self._open] if self._open else [])]
        return [each.aged(self.now, self._T) for each in both]

    def cells(self) -> list[Cell]:
        """The intervals as a batch's cells, with the number of rows that count."""
        return [
            cell for block, each in enumerate(self.intervals()) for cell in self._cells(block, each)
        ]

    def total(self) -> list[Cell]:
        """One cell a coordinate, of all rows."""
        self._settle()
        parts = [each for each in (self._closed, self._open) if each]
        if not parts:
            return []
        whole = parts[0] if len(parts) == 1 else parts[0].merged(parts[1], self._T)
        return self._cells(0, whole.aged(self.now, self._T))

    def _cells(self, block: int, each: Interval) -> list[Cell]:
        count = np.rint(each.weights).astype(int)
        return [
            Cell(
                0,
                block,
                u,
                replace(each.factors[u], rows=int(count[0, u])),
                replace(each.rest[u], rows=int(count[1, u])),
                support,
                float(each.tau[u]),
                each.span,
            )
            for u, support in enumerate(self._supports)
        ]

    def _settle(self) -> None:
        """Absorbs what waits, interval by interval; merges a pair where there are too many."""
        for rows in _joined(self._waiting):
            number = np.array([self._number(t) for t in rows.t.tolist()])
            for each in np.unique(number):
                self._add(_those(rows, number == each), int(each))
                self._thin()
        self._waiting = []

    def _number(self, t: float) -> int:
        """Of the interval in which t [s] lies, at the length that intervals have now."""
        return floor((t - self._start) / self._length + 1e-9)

    def _add(self, rows: Rows, number: int) -> None:
        old = self._open
        if old is not None and self._of(old) != number:
            self._intervals.append(old)
            self._closed = self._closed.merged(old, self._T) if self._closed else old
            old = None
        if (told := rows.informed.any(axis=1)).any():
            self.informed = float(rows.t[told][-1])
        before = old or Interval.empty(self._supports, float(rows.t[0]))
        self._open = before.updated(rows, self._supports, self._T)

    def _of(self, each: Interval) -> int:
        return self._number((each.span[0] + each.span[1]) / 2)

    def _thin(self) -> None:
        """Merges a pair of intervals where they are too many; more pairs if that is not enough."""
        self._merge()
        while len(self._intervals) > SLACK * MOST:
            self._merge()

    def _merge(self) -> None:
        """Merges the two oldest intervals or, without forgetting, a pair that makes a longer one;
        intervals are twice as long where there is no pair left.
        """
        full = len(self._intervals) >= MOST
        if self._T is not None:
            pair = 0 if full else None
        else:
            if full and not any(self._pairs()):
                self._length *= 2
            pair = next((i for i, same in enumerate(self._pairs()) if same), None)
        if pair is not None:
            both = self._intervals[pair].merged(self._intervals[pair + 1], self._T)
            self._intervals[pair : pair + 2] = [both]

    def _pairs(self) -> Iterator[bool]:
        numbers = [self._of(each) for each in self._intervals]
        yield from (a == b for a, b in pairwise(numbers))


def _joined(waiting: list[Rows]) -> list[Rows]:
    if len(waiting) < 2:
        return waiting
    names = Rows.__dataclass_fields__
    return [Rows(*(np.concatenate([getattr(x, name) for x in waiting]) for name in names))]


def _those(rows: Rows, which: np.ndarray) -> Rows:
    if which.all():
        return rows
    return Rows(*(getattr(rows, name)[which] for name in Rows.__dataclass_fields__))
