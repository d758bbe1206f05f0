"""All rows of a motion in memory, and further effects' columns in the same rows.

    A x + C c = b          A, b: the model's rows, C: a candidate's, through the same filter

For searching shapes and judging candidates, where many columns meet the same rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from ident.effects import Correcting, Effect, Signals
from ident.equations.corrections import Corrected, Scene, corrected, step_of
from ident.equations.filter import Decimator
from ident.equations.rows import Rows, rows
from ident.equations.terms import Samples, reduced, unbalanced
from ident.equations.unknowns import Columns, Point
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion

MOST = 20_000  # rows; of more, one in so many is kept: they decide, they are not fitted
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
        parts: list[Rows] = []
        number: list[np.ndarray] = []
        for i, scene in enumerate(scenes):
            for piece in rows(scene, cutoff):
                some = {name: getattr(piece, name)[::every] for name in Rows.__dataclass_fields__}
                parts.append(Rows(**some))
                number.append(np.full(len(parts[-1].t), i))
        arrays = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("t", "sample", "A", "b", "tau", "informed")
        }
        experiment = np.concatenate(number)
        return cls(mechanism, columns, motion, point, scenes, experiment=experiment, **arrays)

    def filtered(self, number: int, x: np.ndarray) -> np.ndarray:
        """Return a series x (n, …) of one experiment at full rate, in its rows (N_e, …)."""
        scene, cutoff = self.scenes[number], self.motion.band.cutoff
        at = self.sample[self.experiment == number]
        decimator = Decimator.of(cutoff, scene.e.rate)
        if decimator.taps is None:
            return x[at]
        pieces = []
        for segment in scene.e.segments():
            mine = at[(at >= segment.start) & (at < segment.stop)]
            if len(mine):
                pieces.append(decimator.apply(x[segment], segment, mine))
        return np.concatenate(pieces)

    def felt(self, effect: Effect) -> np.ndarray:
        """Return the coordinates (c,) in whose rows an effect can appear."""
        d = self.b.shape[1]
        if self.mechanism.closures or not effect.local:
            return np.arange(d)
        return np.array([self.mechanism.joint(name).index for name in effect.joints])

    def with_effect(self, effect: Effect, shapes: Sequence[Mapping[str, float]]) -> np.ndarray:
        """Return columns (N, c, unknowns · shapes) of an effect at several shapes, where `felt`."""
        rows, u = self.felt(effect), len(effect.unknowns)
        series = []
        for number in range(len(self.scenes)):
            s = self.samples(number)
            out = np.zeros((len(s), len(rows), len(shapes) * u))
            for i, shape in enumerate(shapes):
                mine = out[:, :, i * u : (i + 1) * u]
                if self.mechanism.closures or not effect.local:
                    s.add_effect(mine, effect, np.eye(u), shape)
                else:  # every joint has one row of its own
                    mine += s.columns(effect, shape)
            series.append(self.filtered(number, out))
        return np.concatenate(series)

    def sensitivity(self, effect: Effect, shape: Mapping[str, float], name: str) -> np.ndarray:
        """Return S (N, d) of one shape of a correcting effect, at a shape, in the table's rows."""
        assert isinstance(effect, Correcting)
        full = effect.names[[each.name for each in effect.shapes].index(name)]
        others = {f: shape[each.name] for f, each in zip(effect.names, effect.shapes, strict=True)}
        series = []
        cutoff = self.motion.band.cutoff
        for number, scene in enumerate(self.scenes):
            thin = self.thin[number]
            bare = Corrected(scene.mechanism + effect, thin.e, thin.memo)
            h = step_of(effect, bare, self.point, name)
            sides = []
            for sign in (1, -1):
                point = self.point.with_values({**others, full: others[full] + sign * h})
                moved = corrected(bare, point, cutoff, only=effect)
                s = reduced(moved.mechanism, moved.e, slice(None), self.point, moved.memo)
                sides.append(unbalanced(s, self.point))
            S = self.refined(number, (sides[1] - sides[0]) / (2 * h))
            series.append(self.filtered(number, S))
        return np.concatenate(series)

    @cached_property
    def thin(self) -> tuple[Corrected, ...]:
        """The experiments with as few samples as smooth series allow."""
        return tuple(
            Corrected(scene.mechanism, scene.e.thinned(self.every(number)))
            for number, scene in enumerate(self.scenes)
        )

    def every(self, number: int) -> int:
        """Return of how many samples one is enough for a smooth series, given the rows' filter."""
        cutoff = self.motion.band.cutoff
        return max(1, int(self.scenes[number].e.rate / (FINE * cutoff))) if cutoff else 1

    def refined(self, number: int, x: np.ndarray) -> np.ndarray:
        """Return a smooth series of thinned samples at the experiment's full rate."""
        t, every = self.scenes[number].e.t, self.every(number)
        return x if every == 1 else CubicSpline(t[::every], x)(t)

    def samples(self, number: int) -> Samples:
        """Return all samples of one experiment."""
        return self.scenes[number].samples(slice(None))

    def starts(self, effect: Effect) -> list[Mapping[str, float]]:
        """Return the shapes at which a search starts, known ones at their values."""
        signals = self.pooled(effect)
        known = {s.name: effect.values[s.name] for s in effect.shapes if s.name in effect.values}
        found = [{**start, **known} for start in effect.starts(signals)]
        return [dict(x) for x in dict.fromkeys(tuple(sorted(each.items())) for each in found)]

    def bounds(self, effect: Effect) -> dict[str, tuple[float, float]]:
        """Return the bounds of every shape, over all experiments."""
        shape = {each.name: 0.0 for each in effect.shapes}
        return dict(effect.bounds(replace(self.pooled(effect), shape=shape)))

    def pooled(self, effect: Effect) -> Signals:
        """Return the effect's signals of all experiments joined: for ranges, not for time."""
        each = [self.samples(number).signals(effect.joints) for number in range(len(self.scenes))]
        if len(each) == 1:
            return each[0]

        def joined(name: str) -> np.ndarray:
            return np.concatenate([getattr(s, name) for s in each])

        return replace(
            each[0],
            t=joined("t"),
            q=joined("q"),
            v=joined("v"),
            a=joined("a"),
            still=np.min([s.still for s in each], axis=0),
            predicted=lambda: (joined("torque"), joined("load")),
        )
