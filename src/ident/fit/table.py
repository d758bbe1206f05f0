"""All rows of a motion in memory, and further effects' columns in them.

    A x + C c = b          A, b: the model's rows, C: a candidate's, through the same filter

For searching shapes and judging candidates, where many columns meet the same rows.

Rows at another point differ in the columns of effects and in nothing else: the filtered columns of
Γ stay with the motion's states (`equations.rows`), unless an effect corrects data or mechanism.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from ident.effects import Effect, Signals
from ident.equations.filter import Decimator, decimated
from ident.equations.rows import Rows, Scene, beside, corrected, residual, rows
from ident.equations.terms import Samples
from ident.equations.unknowns import Columns, Point
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion

MOST = 20_000  # rows; of more, one in so many is kept: they decide, they are not fitted
BLOCKS = 20  # of time, in all experiments together
FINE = 16.0  # samples a period of the cut-off at which smooth sensitivities are evaluated


@dataclass(frozen=True, eq=False)
class Table:
    """The rows of all experiments; N rows of d independent coordinates, k unknowns.

    Attributes:
        mechanism, columns, motion, point: whose rows.
        scenes: one an experiment.
        t: (N,) [s]; experiment: (N,); sample: (N,) index into its experiment.
        A: (N, d, k); b, tau: (N, d); informed: (N, d).
    """

    mechanism: Mechanism
    columns: Columns
    motion: Motion
    point: Point
    scenes: tuple[Scene, ...]
    t: np.ndarray
    experiment: np.ndarray
    sample: np.ndarray
    A: np.ndarray
    b: np.ndarray
    tau: np.ndarray
    informed: np.ndarray

    @classmethod
    def of(cls, mechanism: Mechanism, columns: Columns, motion: Motion, point: Point) -> Table:
        """Return the rows of a model at a working point."""
        cutoff = motion.band.cutoff
        scenes = tuple(Scene.of(mechanism, columns, e, point, cutoff) for e in motion.experiments)
        expected = sum(len(s.e) // Decimator.of(cutoff, s.e.rate).factor for s in scenes)
        every = max(1, -(-expected // MOST))
        parts: list[list[np.ndarray]] = []
        number: list[np.ndarray] = []
        for i, scene in enumerate(scenes):
            for piece in rows(scene, cutoff):
                parts.append([getattr(piece, each.name)[::every] for each in fields(Rows)])
                number.append(np.full(len(parts[-1][0]), i))
        t, *arrays = (np.concatenate(same) for same in zip(*parts, strict=True))
        experiment = np.concatenate(number)
        return cls(mechanism, columns, motion, point, scenes, t, experiment, *arrays)

    @cached_property
    def blocks(self) -> np.ndarray:
        """(N,) numbers of contiguous stretches of time, about BLOCKS in all, none over two
        experiments.
        """
        each = max(2, -(-BLOCKS // len(self.scenes)))
        found = np.empty(len(self.t), dtype=int)
        for number in range(len(self.scenes)):
            mine = self.experiment == number
            found[mine] = number * each + np.arange(mine.sum()) * each // max(mine.sum(), 1)
        return found

    def filtered(self, number: int, x: np.ndarray) -> np.ndarray:
        """Return a series x (n, …) of one experiment at full rate, in its rows (N_e, …)."""
        at = self.sample[self.experiment == number]
        taps = Decimator.of(self.motion.band.cutoff, self.scenes[number].e.rate).taps
        if taps is None:
            return x[at]
        flat = decimated(x.reshape(len(x), -1), taps, at)
        return flat.reshape(len(flat), *x.shape[1:])

    def effect_columns(
        self, effect: Effect, shapes: Sequence[Mapping[str, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return columns (N, c, numbers · shapes) of an effect at shapes, and the c coordinates in
        whose rows they can be; those of a correction are its sensitivities.
        """
        d = self.b.shape[1]
        if effect.corrects:
            names = [each.name for each in effect.searched]
            S = [self.sensitivity(effect, shape, name) for shape in shapes for name in names]
            return np.stack(S, axis=-1), np.arange(d)
        own_rows = effect.local and not self.mechanism.closures
        joints = [self.mechanism.joint(name).index for name in effect.joints] if own_rows else ()
        felt, u = np.array(joints) if own_rows else np.arange(d), len(effect.unknowns)
        series = []
        for number, s in enumerate(self.samples):
            found = []
            for shape in shapes:
                if own_rows:
                    out = s.columns(effect, shape)
                else:
                    out = np.zeros((len(s), len(felt), u))
                    s.add_effect(out, effect, np.eye(u), shape)
                found.append(self.filtered(number, out))
            series.append(np.concatenate(found, axis=2))
        return np.concatenate(series), felt

    def sensitivity(self, effect: Effect, shape: Mapping[str, float], name: str) -> np.ndarray:
        """Return S (N, d) of one shape of a correcting effect, at a shape, in the table's rows."""
        others = {f: shape[each.name] for f, each in zip(effect.names, effect.shapes, strict=True)}
        series = []
        cutoff = self.motion.band.cutoff
        for number, scene in enumerate(self.scenes):
            grown, point = scene.mechanism + effect, self.point.with_values(others)
            bare = replace(self.thin[number], mechanism=grown, point=point)
            h, moved = beside(bare, effect, name, cutoff, effect)
            S, t = (residual(corrected(bare, cutoff, effect)) - residual(moved)) / h, scene.e.t
            if len(S) != len(t):
                from scipy.interpolate import CubicSpline  # takes 0.2 s to import

                S = CubicSpline(bare.e.t, S)(t)
            series.append(self.filtered(number, S))
        return np.concatenate(series)

    @cached_property
    def thin(self) -> tuple[Samples, ...]:
        """The experiments with as few samples as smooth series allow, given the rows' filter."""
        cutoff, found = self.motion.band.cutoff, []
        for scene in self.scenes:
            every = max(1, int(scene.e.rate / (FINE * cutoff))) if cutoff else 1
            found.append(replace(scene.whole, e=scene.e.thinned(every), memo={}))
        return tuple(found)

    @cached_property
    def samples(self) -> tuple[Samples, ...]:
        """All samples of every experiment."""
        return tuple(scene.samples(slice(None)) for scene in self.scenes)

    def starts(self, effect: Effect) -> list[Mapping[str, float]]:
        """Return the shapes at which a search starts, known ones at their values."""
        signals = self.pooled(effect)
        known = {s.name: effect.values[s.name] for s in effect.shapes if s.name in effect.values}
        found = ({**start, **known} for start in effect.starts(signals))
        return [dict(x) for x in dict.fromkeys(tuple(sorted(each.items())) for each in found)]

    def bounds(self, effect: Effect) -> dict[str, tuple[float, float]]:
        """Return the bounds of every shape, over all experiments."""
        shape = {each.name: 0.0 for each in effect.shapes}
        return dict(effect.bounds(replace(self.pooled(effect), shape=shape)))

    def pooled(self, effect: Effect) -> Signals:
        """Return the effect's signals of all experiments joined: for ranges, not for time."""
        each = [s.signals(effect.joints) for s in self.samples]
        if len(each) == 1:
            return each[0]

        def joined(name: str) -> np.ndarray:
            return np.concatenate([getattr(s, name) for s in each])

        return replace(
            each[0],
            t=np.concatenate([s.t - s.t[0] for s in each]),  # of each log's own beginning
            extra={
                name: np.concatenate([s.extra[name] for s in each])
                for name in each[0].extra
                if all(name in s.extra for s in each)
            },
            q=joined("q"),
            v=joined("v"),
            a=joined("a"),
            still=np.min([s.still for s in each], axis=0),
            predicted=lambda: (joined("torque"), joined("load")),
        )
