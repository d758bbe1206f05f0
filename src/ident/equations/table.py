"""The rows themselves, where many columns meet the same rows, and further effects' columns in them.

    A x + C c = b          A, b: the model's rows, C: a candidate's, through the same filter

For searching shapes and judging candidates: they decide, they are not fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ident.effects import Effect, Signals
from ident.equations.filter import Decimator, Product, multiplied, products
from ident.equations.nearby import difference, linearized
from ident.equations.rows import Rows, Scene, corrected, perturbed, rows, slightly_further, twist_of
from ident.equations.terms import Samples, residual
from ident.equations.thinning import SplineProduct, multiplied_splines, spline_products
from ident.equations.twists import twist_slopes
from ident.equations.unknowns import Columns, Point
from ident.errors import MotionError
from ident.information.cubic import cubic, slopes
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.state import State

TABLE = 20_000  # work: rows; of more, one in so many is kept: they decide, they are not fitted
BLOCKS = 20  # work: of time, in all experiments together
SMOOTH = 16.0  # numerics: samples a period of the cut-off at which sensitivities are evaluated
AT_ONCE = 32  # work: columns that are filtered in one product
ROUNDING = 1e-6  # numerics: of a number of samples
FEWEST = 4  # range: samples that a spline goes through
MADE_BYTES = 100_000_000  # work: of columns at starts that are kept
COARSE = 8.0  # numerics: the same, at least, from which formulas are screened


class MadeColumns(NamedTuple):
    """Columns of an effect at the starts of its search, that are kept."""

    effect: Effect
    starts: Sequence[Mapping[str, float]]
    C: np.ndarray  # (N, c, numbers · starts), but for corrections not weighed by `scale`
    felt: np.ndarray  # the c coordinates


@dataclass(frozen=True, eq=False)
class Table(Rows):
    """The rows of all experiments; `sample` is an index into the row's experiment."""

    experiment: np.ndarray  #: (n,) its number
    mechanism: Mechanism
    columns: Columns
    motion: Motion
    point: Point
    scenes: tuple[Scene, ...]  #: one an experiment
    scale: np.ndarray  #: (N, d) by which rows are weighed: 1, but at rest
    every: int = 1  #: of so many samples one is evaluated for columns
    made: dict[str, MadeColumns] = field(default_factory=dict)  #: by label, at starts of searches
    #: of corrections that are not linear, by label, at shapes that searches beside any model reach
    made_at_shapes: dict[str, list[MadeColumns]] = field(default_factory=dict)

    @classmethod
    def of(
        cls, mechanism: Mechanism, columns: Columns, motion: Motion, point: Point,
        keep: bool = True,
    ) -> Table:  # fmt: skip
        """Return the rows of a model at a working point; `keep`: as `rows` takes it.

        Raises:
            MotionError: if no sample is usable, as where a delay may be longer than the log is.
        """
        cutoff = motion.band.cutoff
        scenes = tuple(Scene.of(mechanism, columns, e, point, cutoff) for e in motion.experiments)
        expected = sum(len(s.e) // Decimator.of(cutoff, s.e.rate).factor for s in scenes)
        every = max(1, -(-expected // TABLE))
        parts, number, scales = [], [], []
        for i, scene in enumerate(scenes):
            for piece in rows(scene, cutoff, keep=keep):
                if every > 1:  # copies: a view would keep all rows
                    piece = piece[np.arange(0, len(piece), every)]
                scales.append(piece.scale_of(scene.e.rest, every))
                parts.append(piece.resting(scene.e.rest, every))
                number.append(np.full(len(parts[-1]), i))
        if not parts:
            names = ", ".join(e.name for e in motion.experiments)
            raise MotionError(f"{names}: no sample is usable; take a longer log")
        r = Rows.concatenated(parts)
        return cls(
            r.t, r.sample, r.A, r.b, r.tau, r.informed, r.moving, r.rest,
            np.concatenate(number),
            mechanism, columns, motion, point, scenes, np.concatenate(scales),
        )  # fmt: skip

    @cached_property
    def vary(self) -> np.ndarray:
        """(N, d) rows in motion and poses, by which torques have a size and a shape: a stretch at
        rest within a motion is one number, of which friction holds a part.
        """
        poses = np.array([scene.e.poses for scene in self.scenes])
        return (self.rest == 0) | poses[self.experiment][:, None]

    @cached_property
    def blocks(self) -> np.ndarray:
        """(N,) numbers of stretches of time, about BLOCKS in all, none over two experiments."""
        per_log = max(2, -(-BLOCKS // len(self.scenes)))
        numbers = np.empty(len(self.t), dtype=int)
        for number in range(len(self.scenes)):
            of_log = self.experiment == number
            numbers[of_log] = number * per_log + np.arange(of_log.sum()) * per_log // max(
                of_log.sum(), 1
            )
        return numbers

    @cached_property
    def predicted(self) -> np.ndarray | None:
        """(N, d) torques that the model predicts at its point, weighed as the rows are; None where
        its rows have more than these: in loops, and where effects hang on predicted torques.
        """
        if self.mechanism.closures or any(effect.implicit for effect in self.mechanism.effects):
            return None
        return self.tau - self.b + self.A @ self.point.unknowns(self.columns)

    @cached_property
    def coarse(self) -> Table:
        """The same rows, with columns from fewer samples, the rows among them. Columns with steps
        are off at reversals: of dry friction by 0.2 % (rms) on the TX40, by 7 % on a five-bar.
        """
        samples_by_log = (self.sample[self.experiment == i] for i in range(len(self.scenes)))
        step = int(np.gcd.reduce(np.concatenate([np.diff(at) for at in samples_by_log])))
        cutoff = self.motion.band.cutoff
        most = min(s.e.rate for s in self.scenes) / (COARSE * cutoff) if cutoff else 1
        return replace(
            self,
            made={},
            made_at_shapes={},
            every=max(k for k in range(1, int(max(most, 1)) + 1) if step % k == 0),
        )

    def filtered(self, number: int, x: np.ndarray) -> np.ndarray:
        """Return a series x (n, …) of an experiment's `samples`, in its rows (N_e, …)."""
        at, filters = self._products[number]
        if not filters:
            return x[at]
        flat = multiplied(filters, x.reshape(len(x), -1))
        return flat.reshape(len(flat), *x.shape[1:])

    @cached_property
    def _products(self) -> list[tuple[np.ndarray, list[Product]]]:
        """Samples (N_e,) of the rows of each experiment, and the products that filter a series."""
        filters = []
        for number, scene in enumerate(self.scenes):
            at, n = self.sample[self.experiment == number] // self.every, self.every
            decimator = Decimator.of(self.motion.band.cutoff, scene.e.rate)
            taps = None if decimator.taps is None else n * decimator.taps[decimator.half % n :: n]
            filters.append((at, [] if taps is None else products(taps, at)))
        return filters

    def effect_columns(
        self, effect: Effect, shapes: Sequence[Mapping[str, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return columns (N, c, numbers · shapes) of an effect at shapes, and the c coordinates."""
        if effect.corrects:
            S = [self._of_correction(effect, shape) for shape in shapes]
            return np.concatenate(S, axis=-1), np.arange(self.b.shape[1])  # weighed already
        C, felt = self._columns(effect, shapes)
        return C * self.scale[:, felt, None], felt

    def _columns(
        self, effect: Effect, shapes: Sequence[Mapping[str, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return those of an effect with columns of its own, that are not weighed.

        Where a torque works by the same levers at all samples, it is filtered once, by joint.
        """
        own_rows, u = effect.local and not self.mechanism.closures, len(effect.unknowns)
        levers = None if own_rows else self._levers(effect)
        if own_rows:
            felt = np.array([self.mechanism.joint(name).index for name in effect.joints])
        elif levers is not None:
            felt = np.flatnonzero(np.any(levers, axis=(0, 1)))
        else:
            felt = np.arange(self.b.shape[1])
        width = len(felt) if levers is None else len(effect.acting)
        series, step = [], max(1, AT_ONCE // max(width * u, 1))
        for number, s in enumerate(self.samples):
            pieces = []
            for first in range(0, len(shapes), step):  # one product each
                batch = shapes[first : first + step]
                out = np.zeros((width, len(batch) * u, len(s))).transpose(2, 0, 1)  # by column
                for i, shape in enumerate(batch):
                    columns = out[:, :, i * u : (i + 1) * u]
                    if own_rows or levers is not None:
                        columns[:] = s.columns(effect, shape)
                    else:
                        s.add_effect(columns, effect, np.eye(u), shape)
                pieces.append(self.filtered(number, out))
            C = np.concatenate(pieces, axis=2)
            series.append(C if levers is None else levers[number][:, felt].T @ C)
        return np.concatenate(series), felt

    def _levers(self, effect: Effect) -> list[np.ndarray] | None:
        """Return by experiment the levers W (joints, d) of the torques of an effect, where they are
        the same at all samples of a loop; else None.
        """
        index, every = self.mechanism.joint_index, [s.e.leverage for s in self.samples]
        constant = all(len(W) and W.strides[0] == 0 for W in every)
        if effect.loaded_link or not self.mechanism.closures or not constant:
            return None
        levers = [W[0, [index[name] for name in effect.acting]] for W in every]
        return levers if np.any(levers) else None

    def scale_sensitivity(self, effect: Effect) -> np.ndarray:
        """Return S (N, d) of the scale of a drive, from what the model predicts for it.

        By the error of its command, of which the torque is made, any scale would explain what is
        left: none leaves nothing.
        """
        series, (name,) = [], effect.joints
        for number, s in enumerate(self.samples):
            signals = replace(s.signals(effect.joints), shape=s.point.of(effect)[1])
            torque = effect.scale_column(signals, s.predicted(effect.joints)[0][:, 0])
            S = np.zeros((len(s), self.b.shape[1]))
            s.add_torque(S, name, -torque)
            series.append(self.filtered(number, S))
        return np.concatenate(series) * self.scale

    def _of_correction(self, effect: Effect, shape: Mapping[str, float]) -> np.ndarray:
        """Return columns (N, d, numbers) of the searched shapes of a correcting effect, at a shape:
        slopes, and of one that is not linear in its extent all of what it corrects, by its extent,
        which is kept.
        """
        names, extent = [parameter.name for parameter in effect.searched], shape.get(effect.extent)
        if not extent or effect.extent not in names:
            S = [
                self.scale_sensitivity(effect)
                if name == effect.scale
                else self.sensitivity(effect, shape, name)
                for name in names
            ]
            return np.stack(S, axis=-1)
        of_label = self.made_at_shapes.setdefault(effect.label, [])
        for old in of_label:
            if old.effect == effect and [*old.starts] == [shape]:
                return old.C
        C = self._of_extent(effect, shape)
        nbytes = sum(x.C.nbytes for made in self.made_at_shapes.values() for x in made)
        if nbytes + C.nbytes <= MADE_BYTES:
            of_label.append(MadeColumns(effect, [dict(shape)], C, np.arange(C.shape[1])))
        return C

    def _of_extent(self, effect: Effect, shape: Mapping[str, float]) -> np.ndarray:
        """Return columns (N, d, numbers) of a correction that is not linear in its extent."""
        names, extent = [parameter.name for parameter in effect.searched], shape[effect.extent]
        series: list[list[np.ndarray]] = [[] for _ in names]
        cutoff = self.motion.band.cutoff
        values = dict(zip(effect.names, (shape[p.name] for p in effect.shapes), strict=True))
        for number, scene in enumerate(self.scenes):
            grown, point = scene.mechanism + effect, self.point.with_values(values)
            bare = replace(self.thin[number], mechanism=grown, point=point)
            at_shape = residual(corrected(bare, cutoff, effect))
            for name, columns in zip(names, series, strict=True):
                if name == effect.extent:
                    S = (self._uncorrected[number] - at_shape) / extent
                else:
                    h, shifted = perturbed(bare, effect, name, cutoff, effect)
                    S = (at_shape - residual(shifted)) / h
                columns.append(S[:, :, None])
        return np.concatenate([self.smooth_columns(columns) for columns in series], axis=2)

    def start_columns(
        self, effect: Effect, starts: Sequence[Mapping[str, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return `effect_columns` at the starts of a search: those of links that twist to first
        order in the twist, which tells which starts are good. They are kept with the table.
        """
        old = self.made.get(effect.label)
        if old is None or old.effect != effect or [*old.starts] != [*starts]:
            C, felt = self._start_columns(effect, starts)
            old = MadeColumns(effect, starts, C, felt)
            kept = sum(x.C.nbytes for x in self.made.values())
            if kept + C.nbytes <= MADE_BYTES:
                self.made[effect.label] = old
        weights = 1.0 if effect.corrects else self.scale[:, old.felt, None]
        return old.C * weights, old.felt

    def _start_columns(
        self, effect: Effect, starts: Sequence[Mapping[str, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Make them, but for corrections not weighed."""
        of_links = effect.corrects and effect.extent in {p.name for p in effect.searched}
        if not of_links or not all(start[effect.extent] for start in starts):
            if effect.corrects:
                return self.effect_columns(effect, starts)
            return self._columns(effect, starts)
        (name,), d = effect.joints, self.b.shape[1]
        series, width = list[np.ndarray](), len(effect.searched)
        step = max(1, AT_ONCE // (d * width))
        for number, base in enumerate(self.thin):
            pieces = list[np.ndarray]()
            for first in range(0, len(starts), step):
                batch = starts[first : first + step]
                twists = [x for start in batch for x in self._twists(effect, start, base)]
                if name in base.e.logged:
                    S = -twist_slopes(base, name) @ np.array(twists).transpose(2, 1, 0)
                else:  # closures place it
                    S = np.zeros((len(base.e), d, len(twists)))
                piece = self._in_rows(number, S.reshape(len(S), -1))
                pieces.append(piece.reshape(len(piece), d, -1))
            series.append(np.concatenate(pieces, axis=2))
        return np.concatenate(series) * self.scale[:, :, None], np.arange(d)

    def _twists(
        self, effect: Effect, shape: Mapping[str, float], base: Samples
    ) -> list[np.ndarray]:
        """Return the twists (3, n) a unit of an effect's extent, and by its other shapes."""
        cutoff = self.motion.band.cutoff
        full = {effect.full[p.name]: shape[p.name] for p in effect.shapes}
        bare = replace(base, point=self.point.with_values(full))
        twist, twists = twist_of(bare, effect, cutoff), []
        for parameter in effect.searched:
            if parameter.name == effect.extent:
                twists.append(twist / shape[effect.extent])
            else:
                h, further = slightly_further(bare, effect, parameter.name)
                twists.append((twist_of(further, effect, cutoff) - twist) / h)
        return twists

    def smooth_columns(self, series: Sequence[np.ndarray]) -> np.ndarray:
        """Return columns (N, d, c) from smooth series (n, d, c) of the `thin` samples of each
        experiment.
        """
        d, c = self.b.shape[1], series[0].shape[2]
        flat = (x.reshape(len(x), d * c) for x in series)
        rows = np.concatenate([self._in_rows(number, x) for number, x in enumerate(flat)])
        return rows.reshape(len(rows), d, c) * self.scale[:, :, None]

    def _in_rows(self, number: int, S: np.ndarray) -> np.ndarray:
        """Return smooth series (n, c) of an experiment's `thin` samples, in its rows (N_e, c)."""
        bare, t = self.thin[number], self.scenes[number].e.t
        if len(S) != len(t) and self.every == 1 and len(S) >= FEWEST:
            felt = np.flatnonzero((S != 0).any(axis=0))
            out = np.zeros((int((self.experiment == number).sum()), S.shape[1]))
            for first in range(0, len(felt), AT_ONCE):
                at = felt[first : first + AT_ONCE]
                terms = np.stack([S[:, at], slopes(bare.e.t, S[:, at])], axis=1)
                out[:, at] = multiplied_splines(self._splines[number], terms)
            return out
        if len(S) != len(t):
            S = cubic(bare.e.t, S, t)
        return self.filtered(number, S[self.samples[number].part])

    @cached_property
    def _uncorrected(self) -> list[np.ndarray]:
        """Return r = b − A x (n, d) of the `thin` samples of each experiment."""
        return [residual(samples) for samples in self.thin]

    def sensitivity(
        self, effect: Effect, shape: Mapping[str, float], name: str, step: float | None = None
    ) -> np.ndarray:
        """Return S (N, d) of one shape of a correcting effect, at a shape, in the table's rows;
        `step` as in `slopes`.
        """
        series = [S[:, :, None] for S in self.slopes(effect, shape, name, step)]
        return self.smooth_columns(series)[:, :, 0]

    def slopes(
        self, effect: Effect, shape: Mapping[str, float], name: str, step: float | None = None
    ) -> list[np.ndarray]:
        """Return S (n, d) of one shape of a correcting effect, at a shape, in the `thin` samples of
        each experiment.

        `step`: of a central difference, in the shape's unit; default: forward and as small as
        rounding allows, where what jumps with the motion, as dry friction does, would not be seen.
        Of what shifts the motion in time it is whole samples: each reversal falls into as many.
        """
        if effect.shifts_in_time:
            spacings = [float(s.e.t[1] - s.e.t[0]) for s in self.thin if len(s.e) > 1]
            if spacing := max(spacings, default=0.0):
                step = spacing * max(1.0, np.ceil((step or spacing) / spacing - ROUNDING))
        others = {
            f: shape[shape_parameter.name]
            for f, shape_parameter in zip(effect.names, effect.shapes, strict=True)
        }
        series = []
        cutoff = self.motion.band.cutoff
        if effect.supplies_torque:  # its shapes are beyond those of the model
            others = {f: x + self.point.values.get(f, 0.0) for f, x in others.items()}
        by_drives = effect.supplies_torque or effect.through_drives
        for number, scene in enumerate(self.scenes):
            grown, point = scene.mechanism + effect, self.point.with_values(others)
            bare = replace(self.thin[number], mechanism=grown, point=point)
            if step is None:
                h, shifted = perturbed(bare, effect, name, cutoff, effect)
                # it corrects nothing yet
                still = not by_drives and not effect.unknowns and not any(shape.values())
                at = self.thin[number] if still else corrected(bare, cutoff, effect)
            else:
                h, values = step, (shape[name] - step / 2, shape[name] + step / 2)
                at, shifted = (
                    corrected(
                        replace(bare, point=point.with_values({effect.full[name]: value})),
                        cutoff, effect,
                    )
                    for value in values
                )  # fmt: skip
            base = self.thin[number]
            at, shifted = linearized(at, base), linearized(shifted, base)
            change = difference(at, shifted, base)
            change = residual(at) - residual(shifted) if change is None else change
            series.append(change / h)
        return series

    @cached_property
    def _splines(self) -> list[SplineProduct]:
        """By experiment, what makes its rows from splines through the samples of `thin`."""
        return [
            spline_products(
                Decimator.of(self.motion.band.cutoff, scene.e.rate),
                self.sample[self.experiment == number], len(scene.e), self._step_of(scene.e),
                1 / scene.e.rate,
            )
            for number, scene in enumerate(self.scenes)
        ]  # fmt: skip

    def _step_of(self, e: State) -> int:
        """Return the samples from one of `thin` to the next, in an experiment."""
        return max(1, int(e.rate / (SMOOTH * (self.motion.band.cutoff or np.inf))))

    @cached_property
    def thin(self) -> tuple[Samples, ...]:
        """The experiments with as few samples as smooth series allow, given the rows' filter."""
        states = (s.e.thinned(self._step_of(s.e)) for s in self.scenes)
        both = zip(self.scenes, states, strict=True)
        return tuple(replace(s.samples, e=e, memo={}) for s, e in both)

    @cached_property
    def samples(self) -> tuple[Samples, ...]:
        """The samples of which columns are evaluated: all, or one in so many, rows among them."""
        parts = []
        for number, scene in enumerate(self.scenes):
            first = int(self.sample[self.experiment == number][:1].sum())
            every_so_many = slice(first % self.every, None, self.every)
            parts.append(scene.samples.reduced(every_so_many if self.every > 1 else slice(None)))
        return tuple(parts)

    def starts(self, effect: Effect) -> list[Mapping[str, float]]:
        """Return the shapes at which a search starts, known ones at their values."""
        if effect.supplies_torque:
            return [{parameter.name: 0.0 for parameter in effect.shapes}]
        signals = self.pooled(effect)
        known = {s.name: effect.values[s.name] for s in effect.shapes if s.name in effect.values}
        starts = ({**start, **known} for start in effect.starts(signals))
        return [dict(x) for x in dict.fromkeys(tuple(sorted(start.items())) for start in starts)]

    def bounds(self, effect: Effect) -> dict[str, tuple[float, float]]:
        """Return the bounds of every shape, over all experiments."""
        shape = {shape_parameter.name: 0.0 for shape_parameter in effect.shapes}
        return dict(effect.bounds(replace(self.pooled(effect), shape=shape)))

    def pooled(self, effect: Effect) -> Signals:
        """Return the effect's signals of all experiments joined: for ranges, not for time."""
        of_links = effect.corrects and effect.extent  # made at few samples, as their columns are
        signals = [s.signals(effect.acting) for s in (self.thin if of_links else self.samples)]
        if len(signals) == 1:
            return signals[0]

        def concatenated(name: str) -> np.ndarray:
            return np.concatenate([getattr(s, name) for s in signals])

        everywhere = [name for name in signals[0].extra if all(name in s.extra for s in signals)]
        return replace(
            signals[0],
            t=np.concatenate([s.t - s.t[0] for s in signals]),  # of each log's own beginning
            extra={name: np.concatenate([s.extra[name] for s in signals]) for name in everywhere},
            still=np.min([s.still for s in signals], axis=0),
            predicted=lambda: (concatenated("torque"), concatenated("load")),
            slopes=lambda: np.concatenate([s.load_slopes for s in signals], axis=1),
            q=concatenated("q"),
            v=concatenated("v"),
            a=concatenated("a"),
        )
