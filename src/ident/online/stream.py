"""Samples in, rows of equations out, as they come: the equations of a batch, a fixed lag later.

    sample → clock → q, v, a of the logged joints → all joints through the closures
           → Γ p + E c = τ in the independent coordinates → the rows' filter

Rows are made for a few samples together, since most of the time that one takes is not arithmetic.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.rows import CHUNK, STICKING, Rows, raw_rows
from ident.equations.scene import Scene
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment
from ident.motion.wrench import wrenches
from ident.online.causal import check_causal
from ident.online.clock import Clock, Run
from ident.online.derivative import Derivative
from ident.online.fixed_lag import FixedLag
from ident.online.follow import Follower
from ident.online.intake import Intake, Sample
from ident.online.setting import Setting
from ident.online.window import Window, Windows, margin_of

LATENCY = 0.02  # [s] that samples may wait for others
TOGETHER = 32  # samples that need not wait longer


class Stream:
    """The equations of a mechanism, made of samples as they come.

    Args:
        mechanism: the mechanism; its effects must follow from a sample and its surroundings.
        columns: the unknowns of the equations.
        setting: what is chosen for all samples.
        point: the working point, for effects that are not linear; default: the prior.
        latency: how long samples may wait for others, so that rows are made together [s]; 0 makes
            the rows of every sample at once.
        sticking: share of a filtered row that may come from samples that do not inform it.

    Attributes:
        seen: the samples of which the last call made rows.
        samples: how many have come.

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
        self.seen: list[Window] = []
        torques = tuple(f"tau.{name}" for name in mechanism.driven)
        reads = tuple(dict.fromkeys(x for effect in mechanism.effects for x in effect.reads()))
        self._others = tuple(dict.fromkeys((*torques, *setting.wrenches, *reads)))
        self._intake = Intake(
            mechanism.name, (*setting.motion_columns, *self._others), mechanism.columns
        )
        self._torques = [self._intake.columns.index(name) for name in torques]
        self._derivative = Derivative(setting, self._intake.columns)
        self._filter = FixedLag(setting.cutoff, setting.rate, sticking)
        self._follower = Follower(mechanism, setting)
        self._margin = margin_of(mechanism, setting.rate, setting.cutoff)
        self._windows = Windows(self._margin)
        free = setting.half == self._margin == 0 and setting.cutoff is None
        self._clock = Clock(setting.rate, free)
        self._block = int(np.clip(round(latency * setting.rate), 1, TOGETHER))
        self._waiting: list[np.ndarray] = []
        self._kept: list[tuple[np.ndarray, np.ndarray]] = []  # numbers and q of samples lately

    @property
    def t(self) -> float:
        """Of the last sample [s]."""
        return self._intake.last

    @property
    def lag(self) -> float:
        """By how much the newest row is older than the newest sample, at most [s]."""
        around = self.setting.half + self._margin + self._filter.half
        return (around + self._filter.every - 1 + self._block - 1) / self.setting.rate

    @property
    def period(self) -> float:
        """Time between two rows [s]."""
        return self._filter.every / self.setting.rate

    @property
    def lost(self) -> tuple[int, str]:
        """Samples that could not be completed, and why the last of them."""
        return self._follower.lost, self._follower.why

    def push(self, sample: Sample) -> list[Rows]:
        """The rows that are known with a further sample, or a block of them.

        Args:
            sample: numbers, or arrays (n,), by column: this robot's own names or ident's; or a
                `Log`.

        Raises:
            LogError: for a sample that is not whole, or not later than those before; it is left
                out, and others may follow.
        """
        X = self._intake(sample)
        self.samples += len(X)
        self._waiting.append(X)
        self.seen = []
        return self._made() if sum(map(len, self._waiting)) >= self._block else []

    def flush(self) -> list[Rows]:
        """The rows of samples that wait for others."""
        self.seen = []
        return self._made()

    def _made(self) -> list[Rows]:
        if not self._waiting:
            return []
        X = np.concatenate(self._waiting)
        self._waiting = []
        found = []
        for start in range(0, len(X), CHUNK):
            for run in self._clock(X[start : start + CHUNK]):
                found += self._of_run(run)
        return found

    def _of_run(self, run: Run) -> list[Rows]:
        run, known = self._derivative(run)
        if not len(run):
            return []
        e, kept = self._completed(run, known)
        found = []
        for part in _consecutive(kept):
            window = self._windows(e.at_samples(part), run.number + int(kept[part.start]))
            if window is None:
                continue
            self.seen.append(window)
            self._keep(window)
            if (rows := self._filter(self._raw(window))) is not None:
                found.append(rows)
        return found

    def configurations(self, rows: Rows) -> np.ndarray:
        """Configurations (n, nq) at rows of the last call.

        Args:
            rows: as they were made.
        """
        number, q = (np.concatenate(each) for each in zip(*self._kept, strict=True))
        return np.asarray(q[np.searchsorted(number, rows.sample)])

    def _keep(self, window: Window) -> None:
        """Remembers configurations for as long as the filter holds rows back."""
        self._kept.append((window.sample, window.e.q[window.inside]))
        needed = 2 * (self._filter.half + CHUNK)
        while sum(len(number) for number, _ in self._kept[1:]) > needed:
            self._kept.pop(0)

    def _raw(self, window: Window) -> Rows:
        e, point, setting = window.e, self.point, self.setting
        scene = Scene.of(self.mechanism, self.columns, e, point, setting.cutoff)
        return replace(raw_rows(scene, window.inside, setting.farthest), sample=window.sample)

    def _completed(self, run: Run, known: np.ndarray) -> tuple[Experiment, np.ndarray]:
        X, names = run.X, self._intake.columns
        empty, setting = np.empty(0), self.setting
        others = {name: X[:, names.index(name)] for name in self._others}
        base = Experiment(
            name=self.mechanism.name, t=X[:, 0], q=empty, v=empty, a=empty, y=empty, yd=empty,
            ydd=empty, tau=X[:, self._torques], wrench=None, pinv=None, leverage=None,
            usable=np.ones(len(X), dtype=bool), still=setting.still, extra=others,
            logged=setting.logged, independent=setting.independent,
        )  # fmt: skip
        e, kept = self._follower(base, known)
        if setting.wrenches and len(e):
            e = replace(e, wrench=wrenches(self.mechanism, e.name, e.extra, e.q))
        return e, kept


def _consecutive(places: np.ndarray) -> list[slice]:
    """Runs of places (n,) that follow one another."""
    jumps = np.flatnonzero(np.diff(places) != 1) + 1
    return [slice(int(i), int(j)) for i, j in pairwise([0, *jumps, len(places)]) if j > i]
