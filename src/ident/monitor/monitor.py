"""The monitor: rows in, alarms out.

watching  intervals → charts                     until Σ w R ≥ A
naming    intervals since the onset → suspects   until one leads alone, or patience ends
then      x_ref ← x_ref + θ: what was named is the new normal, and watching goes on
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from ident.equations.rows import Rows
from ident.errors import FitError
from ident.fit import Fit
from ident.mechanism.mechanism import Mechanism
from ident.monitor.alarm import Alarm
from ident.monitor.charts import Charts, Design, Statistics
from ident.monitor.interval import Cutter, Interval, Piece
from ident.monitor.learn import learnt
from ident.monitor.naming import Naming
from ident.monitor.reactions import felt
from ident.monitor.rehearse import Rehearsal
from ident.monitor.verdict import Raised, alarm_of
from ident.monitor.watched import KINDS, Watched
from ident.monitor.window import since_onset
from ident.motion import Motion
from ident.solve.factor import Factor

HELD = 240  # intervals kept, of which the onset can be one


class Monitor:
    """Watches a machine against its reference; made by `Monitor.of`.

    Args:
        watched: the reference and the suspects; its `mechanism`, `columns`, `point` and `cutoff`
            are those of the rows that `absorb` takes.
        rehearsal: the charts, and how they did on the log of normal running.
        reference: (k,) what normal running has of all columns.
        reactions: of the multipliers to all columns.
        seconds: of an interval; patience: longest time for naming [s].
        false_alarms_per_hour: stated.

    Attributes:
        normal: (k,) as given; reference: (k,) with the changes that have been named.
        alarms: all so far.
        raised: the change that is being named or learnt, if there is one; no other is watched for.
    """

    def __init__(
        self,
        watched: Watched,
        rehearsal: Rehearsal,
        reference: np.ndarray,
        reactions: Sequence[Factor],
        seconds: float,
        patience: float,
        false_alarms_per_hour: float,
    ) -> None:
        self.watched, self.rehearsal, self.reactions = watched, rehearsal, reactions
        self.seconds, self.patience = seconds, patience
        self.false_alarms_per_hour = false_alarms_per_hour
        self.normal, self.reference = reference, reference.copy()
        self.design = rehearsal.design
        self.alarms: list[Alarm] = []
        self.raised: Raised | None = None
        self._charts = Charts.fresh(len(self.design.weight))
        self._cutter = Cutter(seconds)
        self._unexplained = False  # what nothing has explained, later changes have to explain
        self._held: deque[Interval] = deque(maxlen=HELD)

    @classmethod
    def of(
        cls,
        reference: Fit | Mechanism,
        motion: Motion,
        *,
        kinds: Sequence[str] = KINDS,
        interval: float = 0.5,
        false_alarms_per_hour: float = 0.1,
        material: float = 0.003,
        patience: float = 20.0,
    ) -> Monitor:
        """A monitor, from a reference and logs of normal running.

        Args:
            reference: a fit, or a mechanism of which everything is known (`identified/`).
            motion: of normal running, as varied as it is; best not what was fitted. Its filter is
                that of all rows.
            kinds: of effects that could change.
            interval: of time that is judged at once [s].
            false_alarms_per_hour: in normal running, at most, on average.
            material: share of the torques below which a change does not matter.
            patience: longest time from an alarm to its name, and time in which a change is learnt
                before another is watched for [s].

        Raises:
            FitError: for a reference that is not known, a log of normal running that is too short,
                or a kind, interval or rate that cannot be.
        """
        if not (interval > 0 and false_alarms_per_hour > 0 and patience > 0 and material >= 0):
            raise FitError(
                f"interval {interval:g} s, {false_alarms_per_hour:g} false alarms an hour, "
                f"patience {patience:g} s, material {material:g}; valid: above 0"
            )
        watched = Watched.of(reference, motion, kinds)
        rehearsal, x = learnt(watched, motion, interval, material)
        reactions = felt(watched, motion)
        return cls(watched, rehearsal, x, reactions, interval, patience, false_alarms_per_hour)

    def fresh(self) -> Monitor:
        """The same monitor before it has seen anything, as after a repair."""
        return Monitor(
            self.watched, self.rehearsal, self.normal, self.reactions, self.seconds,
            self.patience, self.false_alarms_per_hour,
        )  # fmt: skip

    @property
    def threshold(self) -> float:
        """log A: the mean time to a false alarm is A intervals or more."""
        return float(np.log(3600.0 / (self.false_alarms_per_hour * self.seconds)))

    @property
    def evidence(self) -> float:
        """Logarithm of the charts' sum now; an alarm is raised at `threshold`."""
        return float(self._charts.height(self.design.weight))

    def watch(self, motion: Motion) -> list[Alarm]:
        """The alarms of a motion; what waits for its name at the end goes on with the next.

        Args:
            motion: completed with the filter, and best the knots, of normal running.
        """
        found = []
        for e in motion.experiments:
            for piece in self.watched.pieces(e):
                found += self._absorbed(piece)
        return found

    def absorb(self, rows: Rows, q: np.ndarray | None = None) -> list[Alarm]:
        """The alarms that further rows raise. Memory stays as it is.

        Args:
            rows: of `watched.columns`, in order of time.
            q: (n, nq) configurations, for the errors of the multipliers; None: without these.
        """
        return self._absorbed(self.watched.piece(rows, q))

    def finish(self) -> list[Alarm]:
        """The alarm that waits for its name, named by what there is."""
        if self.raised is None or self.raised.told:
            return []
        return [self._told(self.raised, *self._named(self.raised))]

    def _absorbed(self, piece: Piece) -> list[Alarm]:
        found = []
        for part in self._cutter.cut(piece):
            interval = Interval.of(part, self.design.clean.sigma, self.reference)
            if (alarm := self._step(interval)) is not None:
                found.append(alarm)
        return found

    def _step(self, interval: Interval) -> Alarm | None:
        self._held.append(interval)
        if self.raised is None:
            seen = Statistics.of([interval], self.reference)
            self._charts.update(self.design.evidence(seen)[0])
            if self.evidence < self.threshold:
                return None
            leader = self._charts.leader(self.design.weight)
            since = max(int(self._charts.since[leader]), 1)
            self.raised = Raised(interval.end, self.evidence, self._about(leader), since)
        else:
            self.raised.since += 1
            self.raised.waited += 1
        raised = self.raised
        late = raised.waited * self.seconds >= self.patience
        if raised.told and not late:
            return None
        naming, window = self._named(raised)
        ready = raised.ready(naming, len(window)) or late
        alarm = self._told(raised, naming, window) if ready and not raised.told else None
        if late:
            self._go_on(naming, window)
        return alarm

    def _about(self, chart: int) -> str:
        column, error = self.design.about(chart)
        if column is not None:
            return self.watched.columns.names[column]
        return f"error of {self.watched.errors[error or 0]}"

    def _named(self, raised: Raised) -> tuple[Naming, list[Interval]]:
        clean, held = self.rehearsal.design.clean, list(self._held)
        return since_onset(
            self.watched, held, raised.since, self.reference, clean, self.threshold,
            forgiving=not self._unexplained,
        )  # fmt: skip

    def _told(self, raised: Raised, naming: Naming, window: Sequence[Interval]) -> Alarm:
        clean = self.design.clean
        alarm = alarm_of(
            self.watched, clean, self.reactions, raised, naming, window, self.threshold
        )
        self.alarms.append(alarm)
        raised.told = True
        return alarm

    def _go_on(self, naming: Naming, window: Sequence[Interval]) -> None:
        """What was named is normal from now on, and the charts begin again."""
        clean, since = self.design.clean, window[1:] or window
        places, root = np.empty(0, dtype=int), np.empty((0, 0))
        if naming.best is not None:
            places, root = naming.best.suspect.places, naming.best.root
            self.reference[places] += naming.best.theta
        clean = clean.moved(places, root, since, self.reference)
        if not naming.sound:
            self._unexplained = True
            clean = clean.worse(since, self.reference, naming.remains)
        self.design = Design.of(clean, self.design.mask)
        self._charts = Charts.fresh(len(self.design.weight))
        self._held.clear()
        self.raised = None

    def __str__(self) -> str:
        name, rows = self.watched.mechanism.name, self.design.clean.factor.rows
        return "\n".join(
            [
                f"monitor of {name}: {rows} rows of normal running, intervals of "
                f"{self.seconds:g} s",
                f"  {self.false_alarms_per_hour:g} false alarms an hour at most, while the machine "
                f"runs as it did then; {self.rehearsal}",
                f"  watches, at so many places: {self.watched}",
                f"  alarms: {len(self.alarms)}, evidence {self.evidence:.1f} of "
                f"{self.threshold:.1f}",
            ]
        )

    __repr__ = __str__
