"""The recursion behind `Online`: rows of a stream, absorbed; what they say, when it is asked for.

Where information is forgotten and none follows, nothing is claimed that is not known any more: a
parameter that no row determines now stays at its last value, and its standard error grows by

    exp(Δt/2T)        the root of what an equation's weight exp(−Δt/T) leaves of its information
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.rows import Rows, row_supports
from ident.fit.reach import identifiable_multipliers
from ident.fit.values import Value
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.online.accumulator import Accumulator
from ident.online.found import Found
from ident.online.intake import Sample
from ident.online.reactions import Multipliers, multipliers
from ident.online.setting import Setting
from ident.online.snapshot import Snapshot
from ident.online.stream import Stream
from ident.online.window import Window
from ident.residual.error import Squares


class Recursion:
    """A stream of rows and the factors that absorb it.

    Args:
        mechanism: with all shapes of its effects known.
        like: a motion of this machine.
        point: the working point.
        forget: time constant [s]; None: all rows count alike.
        latency: how long samples may wait for others [s].
    """

    def __init__(
        self,
        mechanism: Mechanism,
        like: Motion,
        point: Point,
        forget: float | None,
        latency: float,
    ) -> None:
        self._mechanism, self._point, self._T = mechanism, point, forget
        self._columns = Columns.of(mechanism)
        self._setting = setting = Setting.of(mechanism, like)
        self.stream = Stream(mechanism, self._columns, setting, point, latency)
        supports = row_supports(mechanism, self._columns, like.experiments[0])
        self._accumulator = Accumulator(supports, forget, self.stream.period)
        self._determined = identifiable_multipliers(mechanism, like)
        self._noise = np.array([setting.noise.get(f"tau.{name}", 0.0) for name in mechanism.driven])
        self._units = [mechanism.joint(name).force_unit for name in setting.independent]
        self._found: Found | None = None
        self._known: dict[str, tuple[Value, float]] = {}  # identified parameters, and when [s]
        self._most = 0  # base parameters that were known at once
        self._ahead = self._nothing()
        self._completed: list[Window] = []  # by the last call
        self._last: Window | None = None

    def push(self, sample: Sample) -> None:
        """Takes a sample or a block."""
        self._absorb(self.stream.push(sample))

    def snapshot(self) -> Snapshot:
        """What is known by now.

        Raises:
            FitError: if no row informs yet.
        """
        self._absorb(self.stream.flush())
        found, informed = self._solved()
        parameters, held = self._stated(found, informed)
        ahead, self._ahead = self._ahead, self._nothing()
        names, lost = self._setting.independent, self.stream.lost
        notes = [f"{lost[0]} samples are left out, the last since {lost[1]}"] if lost[0] else []
        last = None if self._last is None else self._multipliers(self._last)
        return Snapshot(
            t=self._accumulator.now,
            samples=self.stream.samples,
            rows=float(found.squares.rows.mean()),
            parameters=parameters,
            base_parameters=found.base,
            held=held,
            multipliers=last,
            errors=found.squares.errors(names, self._units),
            ahead=ahead.errors(names, self._units) if ahead.rows.any() else {},
            rank=found.estimate.base.rank,
            condition_number=found.estimate.base.condition_number,
            lag=self.stream.lag,
            notes=tuple(notes),
        )

    @property
    def multipliers(self) -> Multipliers | None:
        """λ of the samples that the last call completed; None where there are none."""
        parts = [x for each in self._completed if (x := self._multipliers(each)) is not None]
        return Multipliers.joined(parts) if parts else None

    def _absorb(self, made: list[Rows]) -> None:
        self._completed = self.stream.seen
        if self._completed:
            self._last = self._completed[-1].last
        for rows in made:
            if self._found is not None:
                off = rows.b - rows.A @ self._found.estimate.solution.x
                count = np.full(off.shape[1], float(len(off)))
                self._ahead = self._ahead + Squares(
                    (off**2).sum(axis=0), (rows.tau**2).sum(axis=0), count
                )
            self._accumulator.absorb(rows)

    def _solved(self) -> tuple[Found, bool]:
        """What the rows say, and whether any has informed lately; else what they said last."""
        old, now = self._found, self._accumulator.now
        if old is not None and self._T and now - self._accumulator.informed > self._T:
            return old, False
        total, cells = self._accumulator.total(), self._accumulator.cells()
        # what is forgotten stays where it was
        prior = old.estimate.solution.x if old is not None and self._T else self._columns.prior
        self._found = Found.of(self._mechanism, self._columns, self._point, cells, total, prior)
        return self._found, True

    def _stated(self, found: Found, informed: bool) -> tuple[tuple[Value, ...], tuple[str, ...]]:
        """The parameters, and the names of those that are held at their last value."""
        values, held, now = [], [], self._accumulator.now
        rank = found.estimate.base.rank
        if informed and rank >= self._most:  # as much is known as ever: none is lost
            self._most, self._known = rank, {}
        for value in found.parameters:
            if value.identifiable and informed:
                self._known[value.name] = value, now
            elif self._T and value.name in self._known:
                last, t = self._known[value.name]
                growth = float(np.exp((now - t) / (2 * self._T)))
                stderr = growth * (last.stderr or 0.0)
                value = replace(last, stderr=stderr, identifiable=False)
                held.append(value.name)
            values.append(value)
        return tuple(values), tuple(held)

    def _multipliers(self, window: Window) -> Multipliers | None:
        if self._found is None or not self._mechanism.closures:
            return None
        return multipliers(
            self._mechanism, self._columns, self._point, window, self._setting.cutoff,
            self._determined, self._found.estimate, self._found.covariance, self._noise,
        )  # fmt: skip

    def _nothing(self) -> Squares:
        d = len(self._setting.independent)
        return Squares(np.zeros(d), np.zeros(d), np.zeros(d))
