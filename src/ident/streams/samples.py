"""Samples as they come: renamed, checked and scaled; what cannot be right is left out.

`DataWatch`: what the channels show: dead, clipped, held, frozen, …, window by window.

The checks are those of a whole log (`faults/channel_checks.py`), on the last seconds. A joint that
rests in a window is not judged: its torque may well be constant or noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

import numpy as np

from ident.errors import LogError, MotionError, one_of
from ident.faults.channel_checks import log_findings
from ident.finding import Finding
from ident.fit.residual_maps import MOVING
from ident.log import Column, Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.signals import LARGEST, LONE, NO_MEASUREMENT, is_signal
from ident.motion.state import State

Sample = Mapping[str, Any] | Log
"""One sample, or a block of them, by column: numbers, or arrays (n,)."""


def log_of(name: str, columns: Sequence[str], X: np.ndarray) -> Log:
    """Return the log of samples X (n, columns), of which `t` is the first."""
    return Log.from_arrays(name, X[:, 0], dict(zip(columns[1:], X.T[1:], strict=True)))


class SampleParser:
    """Takes samples under this robot's own names or ident's, checks them and scales them to SI.

    A time far ahead of the last one waits for its successor: if that comes before it, the time that
    jumped was wrong, and not all that follow.
    """

    def __init__(
        self,
        name: str,
        mapping: Mapping[str, Column],
        columns: Sequence[str] | None = None,
        reads: Sequence[str] = (),
        gap: float = np.inf,
        usual: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        self._name, self._mapping, self._reads = name, dict(mapping), {"t", *reads}
        self._any, self._gap = columns is None, gap  # [s] by which a time is far ahead
        # columns of the arrays that it makes, `t` first; empty before the first sample
        self.columns: tuple[str, ...] = () if columns is None else ("t", *columns)
        self.last = -np.inf  # time of the last sample [s]
        self._ahead: np.ndarray | None = None  # the sample that waits
        ranges = [(usual or {}).get(name, (0.0, np.inf)) for name in self.columns]
        self._centre, self._range = np.array(ranges).reshape(-1, 2).T
        self._names: frozenset[str] = frozenset()  # of the last sample that came alone
        # of such a sample its values by column, if it needs no look; [log]'s scale and offset, and
        # between which values, as they come, none is absurd
        self._values: Callable[[Mapping[str, Any]], tuple[Any, ...]] | None = None
        self._scale = self._offset = self._low = self._high = np.zeros(0)
        self._scaled = False
        self._absurd = 0  # samples in a row that are no measurements
        # (row, why) of samples of the last call; of one that waited since before, row −1
        self.left_out: list[tuple[int, str]] = []

    def __call__(self, sample: Sample) -> np.ndarray:
        """Return the samples (n, columns) that are whole, in order and no absurd numbers.

        Refuses one sample that would be left out, and other columns than before.
        """
        if (X := self._usual(sample)) is not None:
            return X
        given = self._renamed(sample)
        names = self.columns or tuple(dict.fromkeys(("t", *given)))
        if lacking := [name for name in (("t",) if self._any else names) if name not in given]:
            source = self._mapping.get(lacking[0])
            mapped = source if source and source.required else None  # else q_elbow for q.elbow
            wanted = f"{mapped.column!r}, which [log] makes " if mapped else ""
            raise MotionError(
                f"{self._name}: a sample has no column {wanted}{lacking[0]!r}; "
                f"{one_of(lacking[0], given)}"
            )
        if self._any and (off := {*names} ^ {*given}):
            raise LogError(
                f"{self._name}: a sample has other columns than those before "
                f"({', '.join(sorted(off))}); every sample needs the same"
            )
        values = [given[name] for name in names]
        try:
            X = np.array(values, dtype=float).reshape(len(values), -1).T
        except (TypeError, ValueError):
            raise LogError(
                f"{self._name}: a sample is neither numbers nor arrays of equal length; give one "
                "number a column, or one array (n,) a column"
            ) from None
        self.columns, self.left_out, count = names, [], len(X)
        bad = ~(np.abs(X) < LARGEST)
        if self._any:
            bad &= np.array([n in self._reads or is_signal(n) for n in names])
        why = "every column needs a finite number in every sample"
        X, row = self._without(bad, X, np.arange(count), why)
        if self._ahead is not None and len(X):
            X, row = np.concatenate([self._ahead[None], X]), np.append(-1, row)
            self._ahead = None
        good = self._ordered(X[:, 0], row)
        X, row = X[good], row[good]
        before = X[-2, 0] if len(X) > 1 else self.last
        if len(X) and np.isfinite(before) and X[-1, 0] - before > self._gap:
            X, row, self._ahead = X[:-1], row[:-1], X[-1]
        self.last = float(X[-1, 0]) if len(X) else self.last
        if not self._any:
            X, _ = self._without(self._absurd_cells(X), X, row, f"it {NO_MEASUREMENT}")
        if count == 1 and self.left_out and self.left_out[-1][0] == 0:
            raise LogError(self.left_out[-1][1])
        return X

    def _usual(self, sample: Sample) -> np.ndarray | None:
        """Return one sample (1, columns) in which nothing is to be looked at; None for others."""
        if self._any or self._ahead is not None or isinstance(sample, Log):
            return None
        if sample.keys() != self._names:
            self._look_at(sample)
        if self._values is None:
            return None
        try:
            x = np.array(self._values(sample), dtype=float)
        except (KeyError, TypeError, ValueError):
            return None
        if x.ndim != 1 or not np.logical_and.reduce((self._low < x) & (x < self._high)):
            return None
        x = self._scale * x + self._offset if self._scaled else x
        t = float(x[0])
        if not (self.last < t and not (self.last > -np.inf and t - self.last > self._gap)):
            return None
        self.last, self._absurd, self.left_out = t, 0, []
        return x[None]

    def _look_at(self, sample: Mapping[str, Any]) -> None:
        """Note where the columns stand in a sample: under this robot's names, or ident's."""
        self._names, logged = frozenset(sample), [self._mapping.get(name) for name in self.columns]
        sources = [source if source and source.column in sample else None for source in logged]
        both = zip(self.columns, sources, strict=True)
        keys = [source.column if source else name for name, source in both]
        self._values = itemgetter(*keys) if len(keys) > 1 else None
        robots = {source.column for source in self._mapping.values()}
        if any(name in robots for name, x in zip(self.columns, sources, strict=True) if x is None):
            self._values = None  # a name that the robot has for another column
        self._scale = np.array([source.scale if source else 1.0 for source in sources])
        self._offset = np.array([source.offset if source else 0.0 for source in sources])
        self._scaled = bool((self._scale != 1).any() or self._offset.any())
        middle, half = self._centre - self._offset, (1 - ROUNDING) * self._range
        with np.errstate(divide="ignore", invalid="ignore"):  # a scale of zero: look at each
            ends = np.sort([(middle - half) / self._scale, (middle + half) / self._scale], axis=0)
        self._low, self._high = np.clip(ends, -LARGEST, LARGEST)

    def _ordered(self, t: np.ndarray, row: np.ndarray) -> np.ndarray:
        """(n,) samples whose times increase."""
        good = np.ones(len(t), dtype=bool)
        times = np.append(self.last, t)
        if (np.diff(times) > 0).all():
            return good
        before, follows = self.last, np.append(t[1:], np.inf)
        for i in range(len(t)):
            if t[i] > before and t[i] - before > self._gap and before < follows[i] <= t[i]:
                good[i], why = False, f"comes before one at {follows[i]:.6g} s"
            elif t[i] <= before:
                good[i], why = False, f"comes after one at {before:.6g} s"
            else:
                before = t[i]
                continue
            text = f"{self._name}: a sample at t = {t[i]:.6g} s {why}; times must increase"
            self.left_out.append((int(row[i]), text))
        return good

    def _absurd_cells(self, X: np.ndarray) -> np.ndarray:
        """(n, columns) cells far from what is usual, unless several samples with some follow."""
        far = np.abs(X - self._centre) > self._range
        for cells, odd in zip(far, far.any(axis=1), strict=True):
            self._absurd = self._absurd + 1 if odd else 0
            cells &= self._absurd < LONE
        return far

    def _without(
        self, bad: np.ndarray, X: np.ndarray, row: np.ndarray, why: str
    ) -> tuple[np.ndarray, np.ndarray]:
        """Leave out the samples X (n, columns) of some rows (n,) with cells `bad` (n, columns)."""
        out = bad.any(axis=1)
        for x, i, at in zip(X[out], row[out], bad[out].argmax(axis=1), strict=True):
            cell = f"{self.columns[at]} = {x[at]:.4g} in the sample at t = {x[0]:.6g} s"
            self.left_out.append((int(i), f"{self._name}: {cell}; {why}"))
        return X[~out], row[~out]

    def _renamed(self, sample: Sample) -> Mapping[str, Any]:
        """Return the columns of a sample under ident's names, in SI."""
        if isinstance(sample, Log):
            return {"t": sample.t, **sample.columns}
        logged_names = {source.column for source in self._mapping.values()}
        given = {name: x for name, x in sample.items() if name not in logged_names}
        for name, source in self._mapping.items():
            if source.column in sample and (self._any or name in self.columns):
                x = sample[source.column]
                x = x if np.ndim(x) == 0 else np.asarray(x)
                given[name] = source.scale * x + source.offset
        return given


ROUNDING = 1e-9  # numerics: of a range, at whose ends a sample is looked at
SECONDS = 10.0  # range: [s] of a window
FEWEST = 400  # work: samples of a window
REPORTED = 100  # shown: kinds of findings, after which no other is reported


@dataclass(frozen=True)
class Since:
    """A finding, and the window in which it was first made."""

    finding: Finding
    t: float  # beginning of the window [s]

    def __str__(self) -> str:
        return f"since t = {self.t:.4g} s or later: {self.finding}"


class DataWatch:
    """Looks at windows of a stream; every kind of finding is reported once a channel."""

    def __init__(self, mechanism: Mechanism, like: Motion, columns: tuple[str, ...]) -> None:
        self._mechanism, self._columns = mechanism, columns  # of the samples, `t` first
        self._like = Motion((), like.independent, like.band, 0.0)
        self._samples: list[np.ndarray] = []
        self._states: list[State] = []
        self._count = 0  # samples of these states
        self.known: dict[tuple[str, tuple[str, ...]], Since] = {}  # all so far

    def add(self, X: np.ndarray, states: list[State], ended: bool = False) -> list[Since]:
        """Add samples (n, columns) and states; return what is new. `ended`: no more come."""
        self._samples += [X] if len(X) else []
        if not (states or ended):
            return []
        self._states += [e for e in states if len(e)]
        self._count += sum(map(len, states))
        if self._count < FEWEST:
            return []
        start, end = float(self._states[0].t[0]), float(self._states[-1].t[-1])
        if (end - start < SECONDS and not ended) or len(self.known) >= REPORTED:
            return []
        t, yd, ydd = (
            np.concatenate([getattr(e, name) for e in self._states]) for name in ("t", "yd", "ydd")
        )
        still, self._states, self._count = self._states[-1].still, [], 0
        X = np.concatenate(self._samples)
        inside, after = (X[:, 0] >= start) & (X[:, 0] <= end), X[:, 0] > end
        self._samples = [X[after]] if after.any() else []
        index = self._mechanism.joint_index
        moving = (np.abs(yd) > still).mean(axis=0) > MOVING
        columns = {
            name: x
            for name, x in zip(self._columns[1:], X[inside].T[1:], strict=True)
            if (joint := name.partition(".")[2]) not in index or moving[index[joint]]
        }
        if not columns:
            return []
        name = self._mechanism.name
        log = Log.from_arrays(name, X[inside, 0], columns)
        state = State(
            name=name, t=t, tau=np.empty((len(t), 0)), usable=np.ones(len(t), dtype=bool),
            yd=yd, ydd=ydd, still=still,
        )  # fmt: skip
        motion = replace(self._like, experiments=(state,), logs=(log,), mechanism=self._mechanism)
        return self.note(log_findings(self._mechanism, motion), start)

    def note(self, findings: Iterable[Finding], start: float) -> list[Since]:
        """Take findings of a window that begins at `start` [s]; return what is new."""
        by_kind = {(finding.code, finding.where): Since(finding, start) for finding in findings}
        new = {key: finding for key, finding in by_kind.items() if key not in self.known}
        self.known |= new
        return [*new.values()]
