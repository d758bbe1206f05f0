"""Equations of the motion as it would be without a fault of it, in few samples.

States that leave the mechanism, its speeds of standstill and the clock as they are follow each
other in one state, of which the rows of all are made at once: memory and interpolation in time run
over the ends of each, so that these say which hypotheses are worth equations of their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from ident.effects import Effect
from ident.equations.problem import Problem
from ident.equations.table import TABLE, Table
from ident.errors import IdentError
from ident.faults.channel_fits import ChannelEquations, EffectsAndTorques
from ident.faults.fault import StateChange
from ident.faults.motors import MotorCoordinates
from ident.information.estimate import Estimate
from ident.information.linear import Array
from ident.mechanism.mechanism import Mechanism
from ident.motion import State

MOTION_SAMPLES = 300  # work: samples that tell a right motion from a wrong one
NUMBERS = 10_000_000  # work: of the equations of hypotheses that are made at once


@dataclass(frozen=True, eq=False)
class MotionTrials:
    """The samples in which faults of the motion are tried."""

    problem: Problem
    estimate: Estimate
    table: Table  # of the fit
    common: Sequence[Effect]  # beside the model

    @property
    def mechanism(self) -> Mechanism:
        """The fitted mechanism."""
        return self.problem.mechanism

    @cached_property
    def states(self) -> list[State]:
        """Few samples of each experiment as logged."""
        experiments = self.problem.motion.experiments
        step = -(-sum(int(e.usable.sum()) for e in experiments) // MOTION_SAMPLES)
        return [e.at_samples(np.flatnonzero(e.usable)[::step]) for e in experiments]

    @cached_property
    def logged(self) -> Table:
        """Their rows, without a filter."""
        return self._table(self.mechanism, self.states)

    def _table(self, mechanism: Mechanism, states: Sequence[State]) -> Table:
        motion = self.problem.motion
        band = replace(motion.band, cutoff=None)
        unfiltered = replace(motion, experiments=tuple(states), band=band)
        return Table.of(mechanism, self.problem.columns, unfiltered, self.table.point, keep=False)

    @cached_property
    def _first(self) -> Array:
        """The number of the first sample of each experiment among all."""
        return np.cumsum([0, *map(len, self.states)])

    @cached_property
    def _logged_samples(self) -> Array:
        """The number of each row's sample among all."""
        return self._first[self.logged.experiment] + self.logged.sample

    @cached_property
    def _further(self) -> EffectsAndTorques:
        """The common effects and the torques in the rows as logged."""
        return EffectsAndTorques.of(self.logged, self.common)

    def equations(self, change: StateChange) -> ChannelEquations:
        """Return the equations in the rows that count as logged and in which the motion closes."""
        changed = [change(self.mechanism, e) for e in self.states]
        table = self._table(changed[0][0], [e for _, e in changed])
        return self._equations(*self._rows(change, table))

    def equations_together(
        self, changes: Sequence[StateChange]
    ) -> Iterator[tuple[StateChange, ChannelEquations]]:
        """Yield those changes of the state that can be tried together, with their equations in all
        rows, as one block.
        """
        samples, numbers = int(self._first[-1]), int(np.prod(self.logged.A.shape[1:]))
        most = max(min(TABLE, NUMBERS // max(numbers, 1)) // samples, 1)
        batch = list[tuple[StateChange, list[State]]]()
        for change in changes if not self.mechanism.closures else ():
            try:
                changed = [change(self.mechanism, e) for e in self.states]
            except (IdentError, np.linalg.LinAlgError):  # a motion that does not close
                continue
            pairs = zip(changed, self.states, strict=True)
            if all(m is self.mechanism and _same_clock(e, old) for (m, e), old in pairs):
                batch.append((change, [e for _, e in changed]))
            if len(batch) == most:
                yield from self._together(batch)
                batch = []
        yield from self._together(batch)

    def _together(
        self, batch: Sequence[tuple[StateChange, list[State]]]
    ) -> Iterator[tuple[StateChange, ChannelEquations]]:
        """Yield the equations of some changes, of which the rows are made at once, as one block;
        not of those that lack rows of the log as it is, and none if one makes no equations.
        """
        if not batch:
            return
        states = [e for _, e in batch]
        in_rows = [in_a_row(series) for series in zip(*states, strict=True)]
        try:
            table = self._table(self.mechanism, in_rows)
        except (IdentError, np.linalg.LinAlgError):
            return
        further = EffectsAndTorques.of(table, self.common)
        lengths = np.array([len(e) for e in self.states])[table.experiment]
        number, sample = table.sample // lengths, table.sample % lengths
        # the ends of a log, where a late torque is not known, are within this one
        logged = np.isin(self._first[table.experiment] + sample, self._logged_samples)
        for i, (change, changed) in enumerate(batch):
            at = np.flatnonzero((number == i) & logged)
            if len(at) < len(self.logged):
                continue
            motion = replace(table.motion, experiments=tuple(changed))
            rows_of_change = {name: getattr(table, name)[at] for name in ROWS}
            changed_table = replace(table, **rows_of_change | {"sample": sample[at]}, motion=motion)
            changed_table, of_rows, use, blocks = self._rows(change, changed_table, further.at(at))
            if len(np.unique(blocks[use.any(axis=1)])) == self._blocks:
                one = np.zeros_like(blocks)
                yield change, self._equations(changed_table, of_rows, use, one)

    def _rows(
        self, change: StateChange, table: Table, further: EffectsAndTorques | None = None
    ) -> tuple[Table, EffectsAndTorques, np.ndarray, Array]:
        """Return the rows of a change, what is `further` in them, which (N, d) count, and the
        blocks (N,) in which they are.
        """
        logged, logged_samples = self.logged, self._logged_samples
        if isinstance(change, MotorCoordinates):
            table, further = change.table(logged, table), self._further
        samples = self._first[table.experiment] + table.sample
        nearest = np.minimum(np.searchsorted(logged_samples, samples), len(logged_samples) - 1)
        use = logged.informed[nearest] & (logged_samples[nearest] == samples)[:, None]
        further = further or EffectsAndTorques.of(table, self.common)
        return table, further, use, logged.blocks[nearest]

    @cached_property
    def _blocks(self) -> int:
        """How many blocks the log as it is has."""
        return len(np.unique(self.logged.blocks[self.logged.informed.any(axis=1)]))

    def _equations(
        self, table: Table, further: EffectsAndTorques, use: np.ndarray, blocks: Array
    ) -> ChannelEquations:
        return ChannelEquations.of(
            self.estimate, table, use, self.common, blocks=blocks, further=further
        )


# of a table, one a row
ROWS = ("t", "sample", "A", "b", "tau", "informed", "moving", "rest", "experiment", "scale")


def _same_clock(e: State, old: State) -> bool:
    """Return whether two states differ in their motion alone."""
    return e.t is old.t and e.still is old.still and e.wrench is old.wrench


def in_a_row(states: Sequence[State]) -> State:
    """Return states of equal length, of one log, one after the other on one clock."""
    first, n = states[0], len(states[0])
    concatenated, names = dict[tuple[int, ...], np.ndarray](), list[str]()
    for entry in fields(first):
        x = getattr(first, entry.name)
        if entry.name not in ("still", "rest") and isinstance(x, np.ndarray) and len(x) == n:
            names.append(entry.name)
    series = dict[str, Any]()
    for name in names:
        parts = [getattr(e, name) for e in states]
        key = tuple(map(id, parts))  # q is y, in a tree
        if key not in concatenated:
            concatenated[key] = np.concatenate(parts)
        series[name] = concatenated[key]
    turn = first.t[-1] - first.t[0] + (1 / first.rate if first.rate else 1.0)
    series["t"] = np.concatenate([e.t + i * turn for i, e in enumerate(states)])
    extra = {name: np.concatenate([e.extra[name] for e in states]) for name in first.extra}
    return replace(first, **series, extra=extra)
