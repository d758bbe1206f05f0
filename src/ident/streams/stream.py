"""Samples in, rows of equations out, as they come: the equations of a batch, a fixed lag later.

    sample → clock → q, v, a of the logged joints → all joints through the closures
           → Γ p + E c = τ in the independent coordinates → the rows' filter

Rows are made for a few samples together, since most of the time that one takes is not arithmetic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ident.equations.corrections import WIDER, Scene
from ident.equations.filter import STICKING, Decimator, FilterRun
from ident.equations.rows import CHUNK, Rows, raw_rows
from ident.equations.unknowns import Columns, Point
from ident.errors import FitError, MotionError
from ident.mechanism.mechanism import Mechanism, Multipliers
from ident.motion.closures import LoopSolver
from ident.motion.signals import GAP, UNEVEN
from ident.motion.state import State, nearness, wrenches
from ident.streams.fixed_lag import FixedLag
from ident.streams.samples import Sample, SampleParser
from ident.streams.setting import Setting

LATENCY = 0.02  # [s] that samples may wait for others
TOGETHER = 32  # samples that need not wait longer
SPLINE, TWICE = 12, 2  # samples: where a cubic spline forgets its ends; lost by two differences

Block = tuple[int, np.ndarray, np.ndarray]
"""Number of the first sample in steps of the clock, samples (n, columns) without a gap, and the
samples of the log behind them."""


class StreamClock:
    """Puts samples on a uniform clock as they come, as `complete` does with a whole log.

    Samples that are in step are taken as they are; the clock follows them. Others are interpolated
    on it, one sample late. Beyond a gap it begins anew: there numbers jump.
    """

    def __init__(self, rate: float, free: bool) -> None:
        self._dt, self._free = 1.0 / rate, free
        self._last: np.ndarray | None = None  # the last sample that came
        self._t, self._number = 0.0, 0  # of the last instant of the clock, of the next one

    def cut(self) -> None:
        """Begin anew with the next sample."""
        self._last, self._number = None, self._number + 2

    def __call__(self, X: np.ndarray) -> Iterator[Block]:
        """Yield the blocks that samples X (n, columns), `t` first, make."""
        dt, begun = self._dt, self._last is not None
        if self._free:
            self._number += len(X)
            yield self._number - len(X), X, X
            return
        whole = X if self._last is None else np.concatenate([self._last[None], X])
        self._last = X[-1]
        gaps = np.flatnonzero(np.diff(whole[:, 0]) > GAP * dt) + 1
        for i, j in pairwise([0, *gaps, len(whole)]):
            run = whole[i:j]
            first = run[: int(i > 0 or not begun)]  # the sample that came last is not made again
            if i:
                self._number += max(2, round((run[0, 0] - self._t) / dt)) - 1
            self._t = float(run[0, 0]) if len(first) else self._t
            samples, n = run[1:], np.arange(1, j - i)
            if len(n):
                off = samples[:, 0] - self._t - dt * n
                drift = off[-1] * n / len(n)
                if abs(off[-1]) > UNEVEN * dt * len(n) or np.abs(off - drift).max() > UNEVEN * dt:
                    instants = int((samples[-1, 0] - self._t) / dt + UNEVEN)
                    t = self._t + dt * np.arange(1, instants + 1)
                    columns = [np.interp(t, run[:, 0], x) for x in run.T[1:]]
                    samples = np.stack([t, *columns], axis=1)
            block, logged = np.concatenate([first, samples]), np.concatenate([first, run[1:]])
            if len(block):
                self._t, self._number = float(block[-1, 0]), self._number + len(block)
            if len(logged):
                yield self._number - len(block), block, logged


class Overlap:
    """Puts the last samples before those that come; they are needed as neighbours."""

    def __init__(self, count: int) -> None:
        self._count, self._number = count, 0
        self._last: State | None = None

    def __call__(self, number: int, new: State) -> tuple[int, State]:
        """Return the number of the first sample and all samples."""
        last = self._last
        if not self._count:
            return number, new
        if last is not None and self._number + len(last) == number:
            number, new = self._number, _joined(last, new)
        first = max(0, len(new) - self._count)
        self._number, self._last = number + first, new.at_samples(slice(first, None))
        return number, new


def _joined(a: State, b: State) -> State:
    """One block of samples after the other."""
    arrays: dict[str, Any] = {
        each.name: np.concatenate([x, getattr(b, each.name)])
        for each in fields(a)
        if each.name != "still" and isinstance(x := getattr(a, each.name), np.ndarray)
    }
    extra = {name: np.concatenate([x, b.extra[name]]) for name, x in a.extra.items()}
    loop = None
    if a.loop is not None and b.loop is not None:
        loop = np.concatenate([a.loop[0], b.loop[0]]), np.concatenate([a.loop[1], b.loop[1]])
    return replace(a, **arrays, extra=extra, loop=loop)


class ClosureFollower:
    """Completes motions of the logged joints through the closures, block by block.

    A position at which the closures cannot follow, or that is singular, is left out and counted;
    the next sample sets out from the last position that was good.

    Attributes:
        lost: how many samples could not be completed; why: of the last of them.
    """

    def __init__(self, mechanism: Mechanism, setting: Setting) -> None:
        self._mechanism, self._setting = mechanism, setting
        self._solver = LoopSolver(mechanism, setting.logged, setting.scale)
        self._q: np.ndarray | None = None
        self._y = np.empty(0)
        self._turning = [
            (i, joint.name)
            for i, joint in enumerate(mechanism.joints)
            if joint.rotational and not joint.in_tree
        ]
        self._own: dict[str, np.ndarray] = {}  # where closures' own joints were last: whole turns
        self.lost, self.why = 0, ""

    def __call__(self, base: State, known: np.ndarray) -> tuple[State, np.ndarray]:
        """Return the samples that can be completed, and their places (kept,) in the block."""
        mechanism, names = self._mechanism, self._setting.logged
        if not mechanism.closures:
            return base.at(mechanism, known, names), np.arange(len(base))
        q = self._followed(known[0], base.t)
        closed = np.flatnonzero(np.isfinite(q).all(axis=1))
        if not len(closed):
            return base.at_samples(closed), closed
        if len(closed) < len(q):
            base, known, q = base.at_samples(closed), known[:, closed], q[closed]
        v, a = self._solver.rates(q, *known[1:])
        near = {**self._own, **dict(zip(names, known[0].T, strict=True))}
        e = base.at(mechanism, motion=(q, v, a), turns=near)
        self._own = {name: e.y[-1:, i] for i, name in self._turning}
        e = e.transmitted(mechanism, self._setting.independent, np.inf)
        regular = nearness(e) < self._setting.singular
        if not regular.all():
            at = float(e.t[np.argmin(regular)])
            self.lose(int((~regular).sum()), f"t = {at:.6g} s is near a singular position")
            e, closed = e.at_samples(regular), closed[regular]
        return e, closed

    def _followed(self, y: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Configurations (n, nq) at the coordinates y (n, logged); NaN where there are none."""
        if self._q is None:  # from the known place that is nearest
            nearest = int(np.abs(self._setting.y - y[0]).max(axis=1).argmin())
            self._q, self._y = self._setting.q[nearest], self._setting.y[nearest]
        try:
            q = self._solver.onward(self._q, self._y, y, t)
        except MotionError as error:
            if len(y) == 1:
                self.lose(1, str(error))
                self._q = None  # the next sample begins from a place that is known
                return np.full((1, self._mechanism.model.nq), np.nan)
            half = len(y) // 2
            return np.concatenate(
                [self._followed(y[:half], t[:half]), self._followed(y[half:], t[half:])]
            )
        self._q, self._y = q[-1], y[-1]
        return q

    def lose(self, count: int, why: str) -> None:
        """Count samples that are left out."""
        self.lost, self.why = self.lost + count, why


@dataclass(frozen=True, eq=False)
class SampleWindow:
    """Consecutive samples, of which those `inside` have all neighbours that they need."""

    e: State  # the samples
    inside: slice  # which of them the window stands for


class Stream:
    """The equations of a mechanism, made of samples as they come.

    Attributes:
        windows: the samples of which the last call made rows.
        samples: how many have come.
        left_out: (row, why) of the samples of the last call that are left out.
        last: (n, columns) those that are not.

    Raises:
        FitError: for an effect that a whole log decides, naming it.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        columns: Columns,
        setting: Setting,
        point: Point | None = None,
        latency: float = LATENCY,
        sticking: float = STICKING,
    ) -> None:
        check_causal(mechanism)
        self.mechanism, self.columns, self.setting = mechanism, columns, setting
        self.point = Point.prior(mechanism) if point is None else point
        self.samples = 0
        self.windows: list[SampleWindow] = []
        torques = tuple(f"tau.{name}" for name in mechanism.driven)
        reads = tuple(x for effect in mechanism.effects for x in effect.reads())
        others = tuple(dict.fromkeys((*torques, *setting.wrenches, *reads)))
        needed = (*setting.motion_columns, *others)
        self._parser = SampleParser(
            mechanism.name, mechanism.columns, needed, gap=GAP / setting.rate, usual=setting.usual
        )
        place = self._parser.columns.index
        self.left_out: list[tuple[int, str]] = []
        self.last = np.empty((0, len(self._parser.columns)))
        self._others = {name: place(name) for name in others}
        self._torques = [place(name) for name in torques]
        self._margin = margin_of(mechanism, setting.rate, setting.cutoff)
        self._smoother = FixedLag(setting, self._parser.columns)
        self._completed = Overlap(2 * self._margin)
        self._follower = ClosureFollower(mechanism, setting)
        self._decimator, self._sticking = Decimator.of(setting.cutoff, setting.rate), sticking
        self._run: FilterRun | None = None
        self._recent = np.empty(0)  # t of the samples that the filter holds
        free = setting.smoothing_lag == self._margin == 0 and setting.cutoff is None
        self._clock = StreamClock(setting.rate, free)
        self._block = int(np.clip(round(latency * setting.rate), 1, TOGETHER))
        self._waiting: list[np.ndarray] = []
        assert setting.still is not None
        self._still = setting.still

    @property
    def t(self) -> float:
        """Time of the last sample [s]."""
        return self._parser.last

    @property
    def columns_of_samples(self) -> tuple[str, ...]:
        """Columns of the samples, `t` first."""
        return self._parser.columns

    @property
    def lag(self) -> float:
        """By how much the newest row is older than the newest sample, at most [s]."""
        around = self.setting.smoothing_lag + self._margin + self._decimator.half
        return (around + self._decimator.factor - 1 + self._block - 1) / self.setting.rate

    @property
    def period(self) -> float:
        """Time between two rows [s]."""
        return self._decimator.factor / self.setting.rate

    @property
    def lost(self) -> tuple[int, str]:
        """Samples that are left out, and why the last of them."""
        return self._follower.lost, self._follower.why

    def push(self, sample: Sample) -> list[Rows]:
        """Return the rows that are known with a further sample, or a block of them.

        Raises:
            LogError: for a sample that is not whole, or absurd; of a block, absurd ones are left
                out.
        """
        X = self._parser(sample)
        self.left_out = self._parser.left_out
        for _, why in self.left_out:
            self._follower.lose(1, why)
        self.samples, self.last = self.samples + len(X), X
        if len(X):
            self._waiting.append(X)
        if sum(map(len, self._waiting)) >= self._block:
            return self.flush()
        self.windows = []
        return []

    def flush(self) -> list[Rows]:
        """Return the rows of samples that wait for others."""
        self.windows, waiting, self._waiting = [], self._waiting, []
        X = np.concatenate(waiting) if waiting else np.empty((0, 1))
        return [
            rows
            for start in range(0, len(X), CHUNK)
            for block in self._clock(X[start : start + CHUNK])
            for smooth in self._smoother(*block)
            for rows in self._rows_of(*smooth)
        ]

    def finish(self) -> list[Rows]:
        """Return all rows that are left, as before a gap; further samples begin a new run."""
        made = self.flush()
        self._clock.cut()
        return made + [rows for x in self._smoother.finish() for rows in self._rows_of(*x)]

    def _rows_of(self, number: int, X: np.ndarray, known: np.ndarray) -> Iterator[Rows]:
        """Yield the rows that samples X (n, columns) complete; known (3, n, logged): q, v, a."""
        margin, setting = self._margin, self.setting
        e, places = self._experiment(X, known)
        jumps = np.flatnonzero(np.diff(places) != 1) + 1
        for i, j in pairwise([0, *jumps, len(places)]):
            if i == j:
                continue
            first, around = self._completed(number + int(places[i]), e.at_samples(slice(i, j)))
            if len(around) <= 2 * margin:
                continue
            window = SampleWindow(around, slice(margin, len(around) - margin))
            self.windows.append(window)
            sample = np.arange(first + margin, first + len(around) - margin)
            scene = Scene.of(self.mechanism, self.columns, around, self.point, setting.cutoff)
            raw = raw_rows(scene, window.inside, setting.farthest)
            rows = self._filtered(replace(raw, sample=sample))
            if rows is not None:
                yield rows

    def _experiment(self, X: np.ndarray, known: np.ndarray) -> tuple[State, np.ndarray]:
        setting = self.setting
        base = State(
            name=self.mechanism.name, t=X[:, 0], tau=X[:, self._torques],
            usable=np.ones(len(X), dtype=bool), still=self._still,
            extra={name: X[:, at] for name, at in self._others.items()},
            logged=setting.logged, independent=setting.independent,
        )  # fmt: skip
        e, places = self._follower(base, known)
        if setting.wrenches and len(e):
            e = replace(e, wrench=wrenches(self.mechanism, e.name, e.extra, e.q))
        return e, places

    def _filtered(self, raw: Rows) -> Rows | None:
        """Return the rows that are known with further raw rows."""
        if self._run is None or raw.sample[0] != self._run.end:  # nothing passes a gap
            self._run = FilterRun(self._decimator, int(raw.sample[0]), self._sticking)
            self._recent = np.empty(0)
        t = np.concatenate([self._recent, raw.t])
        sample, (A, b, tau, informed) = self._run.push([raw.A, raw.b, raw.tau, raw.informed])
        self._recent = t[max(0, len(t) - self._decimator.half) :]
        at = sample - self._run.end  # from the end
        return Rows(t[at], sample, A, b, tau, informed) if len(sample) else None


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
    return replace(mechanism, multipliers=Multipliers()), [note]


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
