"""The monitor: rows in, alarms out.

watching  intervals → charts                     until Σ w R ≥ A
naming    intervals since the onset → suspects   until one leads alone, or patience ends
then      x_ref ← x_ref + θ: what was named is the new normal, and watching goes on
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ident.display import Displayed, render
from ident.equations.rows import Rows
from ident.errors import FitError
from ident.fit import Fit
from ident.information.blocks import Error
from ident.information.estimate import MATERIAL
from ident.information.linear import Triangle
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.streams import charts, suspects
from ident.streams.causes import name_together
from ident.streams.charts import FEWEST, Charts, Cutter, Design, NormalRunning, WatchedInterval
from ident.streams.suspects import SURPLUS, WATCHED, Naming, Reading, Watched, name_since_onset

INTERVAL, SHORTEST, STEP = 0.5, 0.4, 0.02  # range: [s] usual; least; by steps
RECENT_INTERVALS = 240  # work: intervals kept, of which the onset can be one
STEADY = 3  # tuned: intervals in a row for which one suspect must lead alone


@dataclass(frozen=True, repr=False)
class ParameterChange(Displayed):
    """Change of one parameter; the standard error is None where it is not determined alone."""

    name: str
    change: float
    stderr: float | None
    unit: str


@dataclass(frozen=True, repr=False)
class SuspectedCause(Displayed):
    """One cause of an alarm, and what it would have done."""

    label: str  # `coulomb:elbow`
    steps: tuple[ParameterChange, ...]  # of its parameters
    explains: float  # share of the squares beyond noise
    # by multiplier, rms of the change of its force in normal running [N | N m]
    reactions: Mapping[str, float]


@dataclass(frozen=True, repr=False)
class Alarm(Displayed):
    """Something has changed.

    Attributes:
        onset, detected, named: since when, when it was sure, when it was named [s].
        from_start: whether the onset is that of the first interval, so it may have been earlier.
        verdict: `named`, `one of` (what this motion does not tell apart) or `cannot tell` (nothing
            in the library explains it).
        best: the likeliest cause; rivals: others that it may be.
        seen_by: what the leading chart is about.
        evidence: logarithm of the charts' sum when it was sure; threshold: at which that was.
        errors: by joint, rms of the error over its normal size, until it was named.
    """

    onset: float
    detected: float
    named: float
    verdict: str
    best: SuspectedCause | None
    rivals: tuple[SuspectedCause, ...]
    seen_by: str
    evidence: float
    threshold: float
    errors: Mapping[str, float]
    from_start: bool

    @property
    def suspects(self) -> tuple[str, ...]:
        """Labels of all that it may be, the likeliest first; none where that cannot be told."""
        if self.verdict == "cannot tell" or self.best is None:
            return ()
        return (self.best.label, *(cause.label for cause in self.rivals))

    @property
    def headline(self) -> str:
        """The alarm in one line."""
        return str(render(self, "headline"))

    def json(self) -> dict[str, Any]:
        """Return the alarm for a file of alarms."""
        return asdict(self)


@dataclass
class _Raised:
    """An alarm that waits for its name."""

    at: float  # when it was sure [s]
    height: float  # evidence
    by: str  # what the leading chart is about
    since: int  # intervals since the onset
    waited: int = 0  # since it was sure
    leader: str = ""  # the suspect that leads alone, for `lead` intervals
    lead: int = 0
    named: float = np.inf  # when it was named [s]

    def ready(self, naming: Naming) -> bool:
        """Whether one suspect has led alone for long enough."""
        alone = naming.best is not None and naming.sound and naming.alone
        leader = naming.best.suspect.label if naming.best and alone else ""
        self.lead = self.lead + 1 if leader and leader == self.leader else int(alone)
        self.leader = leader
        return self.lead >= STEADY


@dataclass(eq=False, repr=False)
class Monitor(Displayed):
    """Watches a machine against its reference; made by `Monitor.of`.

    Attributes:
        watched: the reference and the suspects; its `mechanism`, `columns`, `point` and `cutoff`
            are those of the rows that `absorb` takes.
        calibrated: the charts of normal running; drawn: how many alarms they raised on it, drawn
            again, where `charts.OFTEN` are stated.
        normal: (k,) what normal running has of all columns; reference: (k,) with the changes that
            have been named.
        multipliers: triangles of ∂λ/∂x.
        seconds: of an interval; patience: longest time for naming [s].
        false_alarms_per_hour: stated.
        torque: (d,) rms of the torques in normal running [N m | N].
        alarms: all so far.
        raised: the change that is being named or learnt, if there is one; no other is watched for.
    """

    watched: Watched
    calibrated: Design
    drawn: int
    normal: np.ndarray
    multipliers: Sequence[Triangle]
    seconds: float
    patience: float
    false_alarms_per_hour: float
    torque: np.ndarray

    def __post_init__(self) -> None:
        self.reference = self._now = self.normal.copy()  # now: with what is being learnt
        # log A: the mean time to a false alarm is A intervals or more
        self.threshold = float(np.log(3600.0 / (self.false_alarms_per_hour * self.seconds)))
        self.design = self.calibrated  # now
        self.alarms: list[Alarm] = []
        self.raised: _Raised | None = None
        self._charts = Charts.fresh(len(self.design.weight))
        self._cutter = Cutter(self.seconds)
        self._recent: deque[WatchedInterval] = deque(maxlen=RECENT_INTERVALS)
        # by interval, squares of the normal reference's error and of torques, and rows (3, d)
        self._of_normal: deque[np.ndarray] = deque(maxlen=RECENT_INTERVALS)
        self._begun = np.inf  # start of the first interval [s]

    @classmethod
    def of(
        cls,
        reference: Fit | Mechanism,
        motion: Motion,
        *,
        kinds: Sequence[str] = WATCHED,
        interval: float | None = None,
        false_alarms_per_hour: float = 0.1,
        material: float = MATERIAL,
        patience: float = 20.0,
    ) -> Monitor:
        """Make a monitor from a reference and logs of normal running.

        Args:
            reference: a fit, or a mechanism of which everything is known (`identified/`).
            motion: of normal running, as varied as it is; best not what was fitted. Its filter is
                that of all rows.
            kinds: of effects that could change.
            interval: of time that is judged at once [s]. Default: 0.5, and less, down to 0.4,
                where the logs are too short for enough of them.
            false_alarms_per_hour: in normal running, at most, on average.
            material: share of the torques below which a change does not matter.
            patience: longest time from an alarm to its name, and time in which a change is learnt
                before another is watched for [s].

        Raises:
            FitError: for a reference that is not known, a log of normal running that is too short,
                or a kind, interval or rate that cannot be.
        """
        least, interval = (SHORTEST, INTERVAL) if interval is None else (interval, interval)
        if not (interval > 0 and false_alarms_per_hour > 0 and patience > 0 and material >= 0):
            raise FitError(
                f"interval {interval:g} s, {false_alarms_per_hour:g} false alarms an hour, "
                f"patience {patience:g} s, material {material:g}; valid: above 0"
            )
        watched = Watched(reference, motion, kinds)
        of_log = (rows for e in motion.experiments for rows in watched.rows(e))
        x, parts = watched.reference, [*map(watched.with_gains, of_log)]
        count = sum(part.informed.sum(axis=0) for part in parts)
        squares = sum((np.where(p.informed, p.b - p.A @ x, 0.0) ** 2).sum(axis=0) for p in parts)
        sigma = np.sqrt(np.maximum(squares / np.maximum(count, 1), 1e-300))
        first = charts.intervals_of(parts, interval, sigma, x)
        while len(first) < FEWEST and interval > least:
            interval = max(least, interval - STEP)
            first = charts.intervals_of(parts, interval, sigma, x)
        if len(first) < FEWEST:
            enough = FEWEST * interval + interval / 2 * len(parts)
            raise FitError(
                f"normal running has only {len(first)} intervals of {interval:g} s; valid: "
                f"{FEWEST} or more, better a thousand: give longer logs, of "
                f"{enough:.3g} s in motion or more, or several"
            )
        triangle = Triangle.merge([interval.triangle for interval in first])
        felt = charts.felt_columns(triangle, watched.columns.units)
        x, _ = charts.moved_reference(triangle, x, felt)
        intervals = charts.intervals_of(parts, interval, sigma, x)
        normal = NormalRunning.of(intervals, sigma, x, material, felt)
        direct = [i for suspect in watched.suspects for i in suspect.places[: suspects.DIRECT]]
        design, drawn = charts.calibrated(normal, np.isin(np.arange(len(x)), direct), intervals, x)
        forces = watched.multiplier_triangles(motion)
        torques = sum((np.where(p.informed, p.tau, 0.0) ** 2).sum(axis=0) for p in parts)
        torque = np.sqrt(torques / np.maximum(count, 1))
        stated = interval, patience, false_alarms_per_hour
        return cls(watched, design, drawn, x, forces, *stated, torque)

    def fresh(self) -> Monitor:
        """Return the same monitor before it has seen anything, as after a repair."""
        return replace(self)

    @property
    def evidence(self) -> float:
        """Logarithm of the charts' sum now; an alarm is raised at `threshold`."""
        return float(self._charts.height(self.design.weight))

    def watch(self, motion: Motion) -> list[Alarm]:
        """Return the alarms of a motion, completed with the filter, and best the knots, of normal
        running; one that waits for its name goes on with the next motion.
        """
        states = motion.experiments
        return [x for e in states for rows in self.watched.rows(e) for x in self.absorb(rows)]

    def absorb(self, rows: Rows) -> list[Alarm]:
        """Return the alarms that further rows of `watched.columns` raise, in order of time."""
        sigma = self.design.normal.sigma
        alarms = []
        for part in self._cutter.cut(self.watched.with_gains(rows)):
            series = part.b - part.A @ self.normal, part.tau, np.ones(part.tau.shape)
            squares = (np.where(part.informed, x, 0.0) ** 2 for x in series)
            self._of_normal.append(np.stack([x.sum(axis=0) for x in squares]))
            alarms.append(self._step(WatchedInterval.of(part, sigma, self._now)))
        return [alarm for alarm in alarms if alarm is not None]

    @property
    def errors(self) -> dict[str, Error]:
        """Error of the normal reference in the last intervals, by joint: how far the machine is
        from normal now, whatever has been named or learnt since.
        """
        if not self._of_normal:
            return {}
        *squares, count = np.sum(self._of_normal, axis=0)
        return self._errors(*np.sqrt(np.array(squares) / np.maximum(count, 1)))

    @property
    def usual_errors(self) -> dict[str, Error]:
        """Error in normal running by joint, as a share of the torques there."""
        normal = self.design.normal
        return self._errors(normal.sigma * np.sqrt(normal.energy), self.torque)

    def _errors(self, rms: np.ndarray, torque: np.ndarray) -> dict[str, Error]:
        """Return errors by joint from their rms (d,) and that of the torques (d,)."""
        rows = zip(map(self.watched.mechanism.joint, self.watched.joints), rms, torque, strict=True)
        return {
            joint.name: Error(float(x), float(x / size) if size > 0 else None, joint.force_unit)
            for joint, x, size in rows
        }

    def finish(self) -> list[Alarm]:
        """Return the alarm that waits for its name, named by what there is."""
        if self.raised is None or self.raised.named < np.inf:
            return []
        return [self._alarm(self.raised, *self._naming(self.raised, last=True))]

    def _step(self, interval: WatchedInterval) -> Alarm | None:
        self._recent.append(interval)
        self._begun = min(self._begun, interval.start)
        if self.raised is None:
            shown = self.design.evidence(*charts.statistics([interval], self.reference))
            self._charts.update(shown[0])
            if self.evidence < self.threshold:
                return None
            leader = self._charts.leader(self.design.weight)
            by = self.design.subjects(self.watched.columns.names, self.watched.joints)[leader]
            since = max(int(self._charts.since[leader]), 1)
            self.raised = _Raised(interval.end, self.evidence, by, since)
        else:
            self.raised.since += 1
            self.raised.waited += 1
        raised, alarm = self.raised, None
        late = raised.waited * self.seconds >= self.patience
        named = raised.named < np.inf
        if late or not named:
            naming, window = self._naming(raised, last=late and not named)
            if (raised.ready(naming) or late) and not named:
                alarm = self._alarm(raised, naming, window)
            if late:
                self._go_on(raised, naming, window)
        return alarm

    def _naming(self, raised: _Raised, last: bool) -> tuple[Naming, list[WatchedInterval]]:
        """Name one cause; two where it is the last time and no single one is sound."""
        known, intervals = self.watched.suspects, list(self._recent)
        x, normal = self.reference, self.calibrated.normal
        single, window = name_since_onset(known, intervals, raised.since, x, normal, self.threshold)
        if not last or single.sound:
            return single, window
        both = name_together(single, known, intervals, window, x, normal, self.threshold)
        return both or (single, window)

    def _alarm(self, raised: _Raised, naming: Naming, window: Sequence[WatchedInterval]) -> Alarm:
        energy = self.design.normal.energy
        usual = np.maximum(np.sum([interval.rows for interval in window], axis=0), 1) * energy
        squares = np.sum([interval.squares for interval in window], axis=0)
        errors = zip(self.watched.joints, squares, usual, strict=True)
        causes = [self._cause(x, naming) for x in (naming.best, *naming.rivals) if x]
        alarm = Alarm(
            onset=window[0].start,
            detected=raised.at,
            named=window[-1].end,
            verdict="cannot tell" if not naming.sound else "one of" if naming.rivals else "named",
            best=causes[0] if causes else None,
            rivals=tuple(causes[1:]),
            seen_by=raised.by,
            evidence=raised.height,
            threshold=self.threshold,
            errors={name: float(np.sqrt(x / size)) for name, x, size in errors if size > 0},
            from_start=window[0].start <= self._begun,
        )
        self.alarms.append(alarm)
        raised.named, self._now = alarm.named, self._reference_after(naming)
        return alarm

    def _cause(self, reading: Reading, naming: Naming) -> SuspectedCause:
        """The cause of a reading, one of those of a naming."""
        assert naming.best is not None
        excess = naming.best.fall / naming.explained  # squares beyond noise
        suspect, dx = reading.suspect, np.zeros(len(self.watched.columns))
        dx[suspect.places] = reading.theta
        labels = [parameter.name for parameter in suspect.parameters]
        if len(set(labels)) < len(labels):  # as of dry friction in two joints
            labels = [self.watched.columns.names[i] for i in suspect.places]
        parts = zip(labels, reading.theta, reading.stderr, suspect.units, strict=True)
        steps = tuple(
            ParameterChange(label, float(x), None if np.isnan(s) else float(s), unit)
            for label, x, s, unit in parts
        )
        names = self.watched.mechanism.kinematics.multipliers
        forces = {
            name: float(np.linalg.norm(triangle.R @ dx)) / max(triangle.rows, 1) ** 0.5
            for name, triangle in zip(names, self.multipliers, strict=True)
        }
        explains = float(np.clip(reading.fall / excess, 0.0, 1.0))
        return SuspectedCause(suspect.label, steps, explains, forces)

    def _reference_after(self, naming: Naming) -> np.ndarray:
        """The reference with the change that is named best."""
        x = self.reference.copy()
        if naming.best is not None:
            x[naming.best.suspect.places] += naming.best.theta
        return x

    def _go_on(self, raised: _Raised, naming: Naming, window: Sequence[WatchedInterval]) -> None:
        """Take what was named for normal from now on, and begin the charts again."""
        normal, since = self.design.normal, window[1:] or window
        self.reference = self._now = self._reference_after(naming)
        places, root = np.empty(0, dtype=int), np.empty((0, 0))
        if naming.best is not None:
            places, root = naming.best.suspect.places, naming.best.root
        normal = normal.after_change(places, root, since, self.reference)
        if not naming.sound or naming.excess >= SURPLUS:  # noise may have grown with a load
            known = [interval for interval in since if interval.start >= raised.named]
            normal = normal.worse(since, self.reference, naming.remains, known)
        self.design = Design.of(normal, self.design.mask)
        self._charts = Charts.fresh(len(self.design.weight))
        self._recent.clear()
        self.raised = None
