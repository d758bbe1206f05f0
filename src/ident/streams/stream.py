"""Samples in, rows of equations out, as they come: a stream is a log that grows, read in windows.

    samples → the last of them → the state of a part of a log (`motion.part_of`) → its rows

A window is evaluated as a portion of a long log is. Rows whose filter, splines and corrections have
all of their neighbours leave it, once each; the samples that later rows need stay for the next one.
What lies n knots away moves a quintic spline by 0.67ⁿ (the root of the Euler-Frobenius polynomial
of degree 11; C. de Boor, A Practical Guide to Splines, 1978, ch. XIII): with `LAG` knots around it
the variance of the noise in an acceleration differs from a batch's by 0.1 %.

Rows are absorbed by intervals of time. An old equation counts less, by the weight exp(−age/T) on
its square; its triangle shrinks with

    R → exp(−Δt/2T) R,   d → exp(−Δt/2T) d,   ρ → exp(−Δt/2T) ρ

and Σ exp(−age/T) equations count. Source: L. Ljung, System Identification, 2nd ed., sect. 11.2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.equations.filter import STICKING, Decimator
from ident.equations.problem import LENGTH, blocks_of
from ident.equations.rows import WIDER, Rows, Scene, rows
from ident.equations.unknowns import Columns, Point
from ident.errors import FitError, MotionError
from ident.information.blocks import Block, Information
from ident.log import Log
from ident.mechanism.mechanism import Mechanism, Multipliers
from ident.motion import Motion
from ident.motion.motion import part_of
from ident.motion.recipe import recipe_of
from ident.motion.signals import (
    GAP,
    ORDERS,
    SHORTEST,
    Clock,
    LogSignals,
    is_signal,
    runs,
    torque_limits,
    usual_range,
)
from ident.motion.state import State, nearness
from ident.streams.samples import Sample, SampleParser

LATENCY = 0.5  # range: [s] that samples may wait: what is around them is made again each time
SAMPLES = 4096  # work: new samples of one window, at most
LAG = 10.0  # numerics: knots on either side of a sample, of splines that smooth
EXACT = 16  # numerics: samples there, of splines that interpolate: 0.43 is left by each
PLACES = 64  # work: configurations from which a stream may set out
INTERVALS = 32  # work: of time, at most
FADING = 8.0  # work: intervals in a time constant of forgetting
TOGETHER = 128  # work: samples whose rows are absorbed at once
SPLINE, TWICE = 12, 2  # numerics: samples: a cubic spline's ends; lost by two differences


SampleWindow = tuple[State, slice]
"""Consecutive samples, and which of them have all neighbours that they need."""


class Stream:
    """The equations of a mechanism, made of samples as they come.

    Refuses an effect that a whole log decides, naming it, and a motion that has no log.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        columns: Columns,
        like: Motion,  # of the same machine, whose decisions (filter, knots, …) hold
        point: Point | None = None,  # where what is not linear is evaluated
        latency: float = LATENCY,  # how long samples may wait for others [s]
        sticking: float = STICKING,  # share of a row of samples that do not inform it
        on_demand: bool = False,  # whether rows are seen after `flush` alone: then all may wait
    ) -> None:
        check_causal(mechanism)
        if not like.logs:
            raise MotionError(
                "this motion has no log, so nothing says what is logged; one of "
                "ident.complete(mechanism, log) has"
            )
        e, log = like.experiments[0], like.logs[0]
        self.mechanism, self.columns, self._sticking = mechanism, columns, sticking
        self.point = Point.prior(mechanism) if point is None else point
        self.recipe = replace(
            recipe_of(like.experiments, like.band), limits=torque_limits(log.columns)
        )
        self._dt, self._decimator = 1 / e.rate, Decimator.of(like.band.cutoff, e.rate)
        used = {channel.column for channel in e.channels} or {*log.columns}  # zero rates are none
        used &= {*log.columns}
        motion = [f"{k}.{name}" for name in e.logged for k in ORDERS if f"{k}.{name}" in used]
        names = [*motion, *(f"tau.{name}" for name in mechanism.measured)]
        names += [name for name in log.columns if name.startswith("wrench.")]
        names += [name for effect in mechanism.effects for name in effect.reads()]
        usual = {name: usual_range(x) for name, x in log.columns.items() if is_signal(name)}
        self._parser = SampleParser(
            mechanism.name, mechanism.sources, [*dict.fromkeys(names)], gap=GAP * self._dt,
            usual=usual,
        )  # fmt: skip
        self._margin = margin_of(mechanism, e.rate, like.band.cutoff)
        smooth = EXACT if len(motion) < len(ORDERS) * len(e.logged) else 0
        if self.recipe.noisy:
            smooth = max(smooth, int(np.ceil(LAG * self.recipe.knots * e.rate)))
        self._around = smooth + self._margin  # samples beside one that its state depends on
        block = max(1, round(latency * e.rate))
        self._block = max(block, round(LATENCY * e.rate)) if on_demand else block
        self.columns_of_samples = self._parser.columns  # `t` first
        self.period = self._decimator.factor * self._dt  # between two rows [s]
        late = self._around + self._decimator.half + self._decimator.factor + block - 2
        self.lag = late * self._dt  # of the newest row behind the newest sample, at most [s]
        usable = np.flatnonzero(e.usable)
        usable = usable[:: max(1, len(usable) // PLACES)]
        self._places = e.known(mechanism)[0, usable], e.q[usable]
        self.samples = 0  # that have come
        self.lost = (0, "")  # how many are left out in all, and why the last of them
        self.windows: list[SampleWindow] = []  # samples of which the last call made rows
        self.left_out: list[tuple[int, str]] = []  # (row, why) of samples of the last call
        self.last = self._X = np.empty((0, len(self._parser.columns)))
        self._new, self._waiting = list[np.ndarray](), 0  # samples that are not in _X yet
        self._begin = np.nan  # time of the first sample of all [s]
        self._cut()

    def _cut(self) -> None:
        """Begin a new run: nothing passes to it from the samples before."""
        self._old = 0  # samples of _X that were in a window already
        self._t0 = np.nan  # first time of the run [s]
        self._done = self._row = -np.inf  # times of the last sample and row that have left [s]
        self._q: np.ndarray | None = None  # a configuration near the next window's first

    @property
    def t(self) -> float:
        """Time of the last sample [s]."""
        return self._parser.last

    def push(self, sample: Sample) -> list[Rows]:
        """Return the rows that are known with further samples; one that is not whole or is absurd
        is refused, of a block it is left out.
        """
        X = self._parser(sample)
        self.left_out = self._parser.left_out
        for _, why in self.left_out:
            self._lose(1, why)
        self.samples, self.last, self.windows = self.samples + len(X), X, []
        self._new.append(X)
        self._waiting += len(X)
        return self.flush() if self._waiting >= self._block else []

    def flush(self, last: bool = False) -> list[Rows]:
        """Return the rows of samples that wait; `last`: of all, so that others begin a new run."""
        self.windows, made = [], []
        self._X, self._new, self._waiting = np.concatenate([self._X, *self._new]), [], 0
        while self._old < len(self._X) or (last and len(self._X)):
            stop = min(len(self._X), self._old + SAMPLES)
            since = max(self._old - 1, 0)
            gaps = np.flatnonzero(np.diff(self._X[since:stop, 0]) > GAP * self._dt)
            if len(gaps):
                stop = since + int(gaps[0]) + 1
            ended = bool(len(gaps)) or (last and stop == len(self._X))
            made += self._rows_of(stop, ended)
            if ended:
                self._X = self._X[self._old :]
                self._cut()
        return made

    def _rows_of(self, stop: int, last: bool) -> list[Rows]:
        """Return the rows that a window of samples up to `stop` completes."""
        X, dt, half = self._X[:stop], self._dt, self._decimator.half
        if np.isnan(self._t0):
            self._t0 = float(X[0, 0])
            self._begin = self._t0 if np.isnan(self._begin) else self._begin
        new, self._old = stop - self._old, stop
        if len(X) <= (SHORTEST if last and self._around else max(1, self._around)):
            return []
        end, made = float(X[-1, 0]), list[Rows]()
        window = 2 * (half + self._around + self._decimator.factor) + SHORTEST
        first = int(np.searchsorted(X[:, 0], end - window * dt))
        try:
            e = self._state(X, self._t0, self._q)
        except MotionError as error:
            self._lose(new, str(error))
            self._X = self._X[stop:]
            self._cut()
            return []
        if e is not None:
            made += self._made(e, end - (0 if last else self._around) * dt)
            self._q = e.q[min(int(np.searchsorted(e.t, X[first, 0])), len(e) - 1)]
        self._X, self._old = self._X[first:], stop - first
        return made

    def state_of(self, X: np.ndarray) -> State | None:
        """Return the state over samples (n, columns) that follow each other, as of a log of its
        own, without those at which torques are at their limits; None if none of them is usable.
        """
        try:
            e = self._state(X, float(X[0, 0]), None) if len(X) > SHORTEST else None
        except MotionError:
            return None
        return None if e is None else replace(e, usable=e.usable & ~self._clipped(e))

    def _clipped(self, e: State) -> np.ndarray:
        """Return (n,) at which samples a torque is at its limit."""
        drives, endless = self.mechanism.driven, (-np.inf, np.inf)
        ends = [self.recipe.limits.get(f"tau.{name}", endless) for name in drives]
        low, high = np.array(ends).reshape(-1, 2).T
        return np.asarray(((e.tau <= low) | (e.tau >= high)).any(axis=1))

    def _state(self, X: np.ndarray, t0: float, near: np.ndarray | None) -> State | None:
        """Return the state over a window (n, columns) of a run that begins at t0 [s], `near` a
        configuration; None if no sample of it is usable.
        """
        columns = dict(zip(self._parser.columns[1:], X.T[1:], strict=True))
        log = Log(self.mechanism.name, columns, X[:, 0])
        clock = Clock(t0, self._dt, 0, Clock.of(log).even)
        t = clock.within(log)
        if len(t) < 2:
            return None
        if not clock.even:
            columns = {name: np.interp(t, log.t, x) for name, x in columns.items()}
        signals = LogSignals(log, t, columns, np.ones(len(t), dtype=bool), clock.even)
        mechanism = self.mechanism
        if mechanism.closures:
            y = np.array([columns[f"q.{name}"][0] for name in self.recipe.logged])
            places, q = self._places
            nearest = q[int(np.abs(places - y).max(axis=1).argmin())]
            mechanism = mechanism.with_same_kinematics(start=nearest if near is None else near)
        return part_of(mechanism, signals, replace(self.recipe, clock=clock))

    def _made(self, e: State, until: float) -> Iterator[Rows]:
        """Yield the rows of a window that are new and complete, and add its new samples."""
        dt, half = self._dt, self._decimator.half
        new = (e.t > self._done + 0.5 * dt) & (e.t <= until + 0.5 * dt)
        if not new.any():
            return
        self._done = float(e.t[new][-1])
        clipped = self._clipped(e)
        e = replace(e, usable=e.usable & ~clipped)
        for bad, why in (
            (clipped, "a torque is at its limit"),
            (nearness(e) >= self.recipe.singular, "it is near a singular position"),
        ):
            if (new & bad).any():
                self._lose(int((new & bad).sum()), f"{why} at t = {e.t[new & bad][-1]:.6g} s")
        self.windows += [(e, run) for run in runs(new & e.usable)]
        cutoff = self.recipe.band.cutoff
        scene = Scene.of(self.mechanism, self.columns, self._aligned(e), self.point, cutoff)
        ready, before = until - half * dt + 0.5 * dt, self._row + 0.5 * dt
        for piece in rows(scene, cutoff, self._sticking, self.recipe.farthest, keep=False):
            new_rows = piece[(piece.t > before) & (piece.t <= ready)]
            if len(new_rows):
                self._row = float(new_rows.t[-1])
                sample = np.rint((new_rows.t - self._begin) / dt).astype(int)
                yield replace(new_rows, sample=sample)

    def _aligned(self, e: State) -> State:
        """Return the state, filtered at the same instants as the windows before."""
        if not np.isfinite(self._row):
            return e
        i, usable = int(np.abs(e.t - self._row).argmin()), e.usable.copy()
        for run in e.segments():
            if run.start <= i < run.stop:
                first = max(run.start, self._margin)
                first += (i - self._decimator.half - first) % self._decimator.factor
                usable[run.start : first] = False
        return replace(e, usable=usable)

    def _lose(self, count: int, why: str) -> None:
        self.lost = self.lost[0] + count, why


# --- rows absorbed --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Interval:
    """The triangles of some time."""

    at: float  # the time to which weights refer [s]
    blocks: tuple[Block, ...]  # one a coordinate
    weights: np.ndarray  # (3, d) Σ exp(−age/T) of the rows of each of the blocks' triangles

    @property
    def start(self) -> float:
        """Time of the first row [s]."""
        return self.blocks[0].span[0]

    @classmethod
    def of(cls, rows: Rows, supports: Sequence[np.ndarray], T: float) -> Interval:
        """Absorb rows; T is the time constant of forgetting [s], ∞: all count alike."""
        at = float(rows.t[-1])
        w = np.exp((rows.t[:, None] - at) / (2 * T))
        scaled = replace(rows, A=rows.A * w[:, None], b=rows.b * w, tau=rows.tau * w)
        informs, still = rows.informed, rows.informed & ~rows.moving
        weights = np.stack([(w**2 * counted).sum(axis=0) for counted in (informs, ~informs, still)])
        return cls(at, tuple(blocks_of(0, 0, scaled, supports)), weights)

    def aged(self, to: float, T: float) -> Interval:
        """Return the same with weights that refer to a later time [s]."""
        w = float(np.exp((self.at - to) / (2 * T)))
        if w == 1.0:
            return replace(self, at=to)
        return Interval(to, tuple(block.scaled(w) for block in self.blocks), w**2 * self.weights)

    def merged(self, later: Interval, T: float) -> Interval:
        """Return this with a later interval."""
        earlier = self.aged(later.at, T)
        both = tuple(a + b for a, b in zip(earlier.blocks, later.blocks, strict=True))
        return Interval(later.at, both, earlier.weights + later.weights)

    def numbered(self, block: int) -> list[Block]:
        """Return the blocks of one block of time, with the number of rows that count."""
        numbered = []
        for b, count in zip(self.blocks, np.rint(self.weights).astype(int).T, strict=True):
            both = zip(b.triangles, count.tolist(), strict=True)
            informed, rest, still = (replace(triangle, rows=rows) for triangle, rows in both)
            numbered.append(replace(b, block=block, triangle=informed, rest=rest, still=still))
        return numbered


@dataclass(frozen=True, eq=False)
class RowSpan:
    """An interval of rows that follow each other, before they are reduced."""

    rows: Rows
    first: int
    stop: int

    @property
    def start(self) -> float:
        """Time of the first row [s]."""
        return float(self.rows.t[self.first])

    @property
    def at(self) -> float:
        """Time of the last row [s]."""
        return float(self.rows.t[self.stop - 1])


class Accumulator:
    """Absorbs rows as they come, in bounded memory: intervals of time stay few.

    An interval is as long as the shortest before it. Of too many, the pair that makes the shortest
    is merged, so that they remain about equal blocks; with forgetting, the two oldest.
    """

    def __init__(self, supports: Sequence[np.ndarray], forget: float | None, period: float) -> None:
        self._supports, self._T, self._period = list(supports), forget or np.inf, period
        self._length = forget / FADING if forget else LENGTH * period
        # of which the last is open to further rows; spans while rows are absorbed
        self._intervals: list[Interval | RowSpan] = []
        self._waiting: list[Rows] = []
        self.now = self.informed = -np.inf  # times of the last row, and of the last that informs

    def absorb(self, rows: Rows) -> None:
        """Add rows, which come in the order of time."""
        self._waiting.append(rows)
        self.now = float(rows.t[-1])
        if (informed := rows.informed.any(axis=1)).any():
            self.informed = float(rows.t[informed][-1])
        if sum(map(len, self._waiting)) >= TOGETHER:
            self._absorb_waiting()

    def information(self, k: int) -> Information:
        """Return all rows on k columns by interval of time; weights refer to now."""
        self._absorb_waiting()
        reduced = map(self._reduced, self._intervals)
        aged = [interval.aged(self.now, self._T) for interval in reduced]
        blocks = [block for i, interval in enumerate(aged) for block in interval.numbered(i)]
        return Information.of(blocks, k, len(self._supports))

    def _absorb_waiting(self) -> None:
        """Absorb what waits, interval by interval."""
        if not self._waiting:
            return
        rows, self._waiting, known = Rows.concatenated(self._waiting), [], self._intervals
        first = 0
        while first < len(rows):
            stop = self._end(rows, known[-1].start) if known else 0
            if begins := stop <= first:
                self._thin_out()
                stop = self._end(rows, float(rows.t[first]))
            new = RowSpan(rows, first, stop)
            known.append(new if begins else self._merged(known.pop(), new))
            first = stop
        known[:] = map(self._reduced, known)

    def _reduced(self, interval: Interval | RowSpan) -> Interval:
        """Return the triangles of an interval."""
        if isinstance(interval, Interval):
            return interval
        return Interval.of(interval.rows[interval.first : interval.stop], self._supports, self._T)

    def _merged(self, a: Interval | RowSpan, b: Interval | RowSpan) -> Interval | RowSpan:
        """Return an interval with the next one."""
        if isinstance(a, RowSpan) and isinstance(b, RowSpan):
            return RowSpan(a.rows, a.first, b.stop)
        return self._reduced(a).merged(self._reduced(b), self._T)

    def _end(self, rows: Rows, start: float) -> int:
        """Return up to which row an interval goes that begins at `start` [s]."""
        return int(np.searchsorted(rows.t, start + self._length - 0.5 * self._period))

    def _thin_out(self) -> None:
        """Merge two of too many intervals."""
        known, at, unweighted = self._intervals, 0, np.isinf(self._T)
        if len(known) <= INTERVALS:
            return
        if unweighted:
            lengths = [interval.at - interval.start + self._period for interval in known]
            at = int(np.argmin(np.round(np.add(lengths[1:], lengths[:-1]) / self._period)))
        known[at : at + 2] = [self._merged(known[at], known[at + 1])]
        if unweighted:
            self._length = min(interval.at - interval.start for interval in known) + self._period


def margin_of(mechanism: Mechanism, rate: float, cutoff: float | None) -> int:
    """Return how many samples on either side the corrections of a mechanism depend on."""
    most = 0
    for effect in mechanism.effects:
        if effect.margin:
            most = max(most, int(np.ceil(effect.margin * rate)) + SPLINE)
        elif effect.corrects and effect.implicit:
            wide = WIDER * cutoff if cutoff and WIDER * cutoff < 0.5 * rate else None
            most = max(most, Decimator.of(wide, rate).half + TWICE)
    return most


def with_free_multipliers(mechanism: Mechanism) -> tuple[Mechanism, list[str]]:
    """Return the mechanism with one value of λ a sample, and a note if it has a time basis."""
    if (basis := mechanism.multipliers.basis) == "free":
        return mechanism, []
    note = f"multipliers are free, one value a sample, and not {basis}"
    return mechanism.with_same_kinematics(multipliers=Multipliers()), [note]


def check_causal(mechanism: Mechanism) -> None:
    """Refuse effects whose columns at one sample depend on more than its surroundings."""
    for effect in mechanism.effects:
        why = "depends on all that was before" if effect.memory else ""
        why = "depends on the load of a whole log" if effect.whole_log else why
        if why:
            raise FitError(
                f"{mechanism.name}: effect '{effect.label}' {why}, which is not there sample by "
                f"sample; leave out {effect.label}, or identify whole logs (ident identify)"
            )
