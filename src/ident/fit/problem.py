"""The equations of a mechanism and a motion as information: unknowns and rows.

    A x = b        A = [Γ E S]: rigid bodies, effects, sensitivities of shapes at a working point

Rows are made once, in pieces, and absorbed into triangles by log, block of time and coordinate;
where the multipliers have a time basis, the paper's stack [A | L] is eliminated beside them.

For searching shapes and judging candidates, where many columns meet the same rows, a `Table` has
the rows themselves, and further effects' columns in them:

    A x + C c = b          A, b: the model's rows, C: a candidate's, through the same filter

Rows at another point differ in the columns of effects and in nothing else: the filtered columns of
Γ stay with the motion's states (`equations.rows`), unless an effect corrects data or mechanism.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby, pairwise
from operator import itemgetter

import numpy as np

from ident.display import Progress, part, quiet
from ident.effects import Effect, Signals
from ident.equations.filter import Decimator, Product, multiplied, products
from ident.equations.motion_noise import EliminatedRun
from ident.equations.rows import Rows, Scene, beside, corrected, residual, row_supports, rows, stack
from ident.equations.terms import Samples
from ident.equations.unknowns import Columns, Point
from ident.errors import FitError
from ident.information.blocks import Block, Information
from ident.information.estimate import Estimate, estimate
from ident.information.linear import Triangle
from ident.information.time_bases import Basis
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, split
from ident.motion import Motion

FEWEST, MOST, LENGTH = 10, 96, 12  # work: blocks of a log, and rows that make one
BOUNDLESS = 1e30  # numerics: stands for infinity, with which 0 may be multiplied
TORQUE = 10.0  # range: times the largest torque, by which an effect's unknown is bounded
TABLE = 20_000  # work: rows; of more, one in so many is kept: they decide, they are not fitted
BLOCKS = 20  # work: of time, in all experiments together
FINEST = 20.0  # work: knots a sample; more say nothing, and fill the memory
SMOOTH = 16.0  # numerics: samples a period of the cut-off at which sensitivities are evaluated
COARSE = 8.0  # numerics: the same, at least, from which formulas are screened


@dataclass(frozen=True, eq=False)
class Problem:
    """The equations of a mechanism and a motion at a working point."""

    mechanism: Mechanism
    motion: Motion
    point: Point  #: where what is not linear is evaluated
    columns: Columns  #: the k unknowns
    information: Information  #: rows of the d independent coordinates, in which errors count
    bands: Sequence[EliminatedRun] = ()  #: of multipliers in a time basis, the paper's stack
    runs: Sequence[EliminatedRun] = ()  #: where the motion's noise counts, rows whitened by it

    @classmethod
    def of(
        cls, mechanism: Mechanism, motion: Motion, point: Point, on_progress: Progress = quiet
    ) -> Problem:
        """Make all rows at a point.

        Raises:
            FitError: if there are no rows, or no more than coefficients of multipliers, or all
                right sides are zero.
        """
        columns = Columns.of(mechanism)
        based = bool(mechanism.closures) and mechanism.multipliers.basis != "free"
        first = part(on_progress, 0.0, 0.5 if based else 1.0)
        information = information_of(mechanism, columns, motion, point, first)
        rest = part(on_progress, 0.5, 1.0)
        bands = bands_of(mechanism, columns, motion, point, rest) if based else []
        if bands and not any(t.rows for band in bands for t in band.elimination.factors):
            cut = motion.band.cutoff
            raise FitError(
                f"{mechanism.name}: {f'filtered at {cut:.3g} Hz, ' if cut else ''}there are no "
                "more rows than coefficients of the multipliers in their time basis; give --basis "
                "free, a larger --spacing or a higher --cutoff"
            )
        totals = [total for total in information.totals if total.rows]
        if len(columns) and totals and all(total.rhs_norm() == 0 for total in totals):
            raise FitError(
                "every torque is zero and no body is known, so parameters are free up to a common "
                "factor; log a motion that is driven, or give what is known ([parameters] unknown)"
            )
        return cls(mechanism, motion, point, columns, information, tuple(bands))

    @classmethod
    def reduced(
        cls, mechanism: Mechanism, motion: Motion, point: Point, columns: Columns | None = None
    ) -> Problem:
        """Make the reduced rows alone at a point; `columns`: by default the mechanism's."""
        columns = columns or Columns.of(mechanism)
        information = information_of(mechanism, columns, motion, point)
        return cls(mechanism, motion, point, columns, information)

    @property
    def units(self) -> list[str]:
        """Units of the torque of every independent coordinate."""
        return [self.mechanism.joint(name).force_unit for name in self.motion.independent]

    @cached_property
    def prior(self) -> np.ndarray:
        """(k,) the URDF's values; 0 for effects; shapes where they are."""
        return self.columns.prior_at(self.point.values)

    @cached_property
    def fitting(self) -> Information:
        """The rows from which parameters are estimated: reduced ones, or those of stacks."""
        stacks = [*self.bands, *self.runs]
        return stacks_information(stacks, self.motion) if stacks else self.information

    @property
    def stacked(self) -> bool:
        """Whether parameters are estimated from rows of all coordinates together."""
        return self.fitting is not self.information

    @cached_property
    def torque(self) -> np.ndarray:
        """(d,) rms of the measured torque [N m | N]."""
        return self.information.rms_torque

    @cached_property
    def plausible(self) -> np.ndarray:
        """(k,) largest plausible distance of each unknown from its prior."""
        return plausible_of(self.mechanism, self.columns, self.information)

    def point_at(self, x: np.ndarray) -> Point:
        """Return the values of all parameters with unknowns x (k,)."""
        return self.point.at(self.mechanism, self.columns, x)

    def estimate(self, *, free: bool = False, **fixed: np.ndarray) -> Estimate:
        """Solve least squares on the rows, with weights `sigma` or unknowns `held` that are fixed;
        `free`: on the reduced rows, which multipliers of any kind leave, whatever their basis.
        """
        if self.stacked and not free:  # the paper's: all rows weigh alike, misfit of the basis too
            return estimate(self.fitting.totals, self.prior, np.ones(1), self.plausible, **fixed)
        totals = self.information.totals
        return estimate(totals, self.prior, self.torque, self.plausible, **fixed)


def information_of(
    mechanism: Mechanism,
    columns: Columns,
    motion: Motion,
    point: Point | None = None,
    on_progress: Progress = quiet,
) -> Information:
    """Return the information of all experiments; rows are seen once, in pieces, and never kept."""
    blocks, cutoff = list[Block](), motion.band.cutoff
    for number, e in enumerate(motion.experiments):
        supports = row_supports(mechanism, columns, e)
        edges = block_edges(cutoff, e.t[0], e.t[-1], len(e))
        scene = Scene.of(mechanism, columns, e, point, cutoff)
        for block in triangles(number, rows(scene, cutoff), edges, supports):
            blocks.append(block)
            done = number + (block.span[1] - e.t[0]) / (e.t[-1] - e.t[0])
            on_progress(f"equations of {e.name}", float(done / len(motion.experiments)))
    if not blocks:
        raise too_short(motion)
    return Information.of(blocks, len(columns), motion.experiments[0].leverage.shape[2])


def too_short(motion: Motion) -> FitError:
    """Return the error of a motion of which the filter leaves no row."""
    cutoff, rate = motion.band.cutoff, max(e.rate for e in motion.experiments)
    least = (2 * Decimator.of(cutoff, rate).half + 1) / rate
    return FitError(
        f"{', '.join(motion.names)}: no stretch is long enough for the filter "
        f"({cutoff:.3g} Hz), which needs more than {least:.3g} s without a gap, and a fit many "
        "times that; give a longer log or a higher --cutoff"
    )


def block_edges(cutoff: float | None, first: float, last: float, samples: int) -> np.ndarray:
    """Return the times [s] that part a log of so many samples from t = first to last in blocks."""
    rate = cutoff * 4 if cutoff else (samples - 1) / (last - first)
    count = int(np.clip((last - first) * rate / LENGTH, FEWEST, MOST))
    return np.linspace(first, last, count + 1)[1:-1]


def triangles(
    log: int, pieces: Iterable[Rows], edges: np.ndarray, supports: Sequence[np.ndarray]
) -> Iterator[Block]:
    """Yield the blocks of a log's rows in their order, parted at the times `edges` [s]."""

    def parted() -> Iterator[tuple[int, Rows]]:
        for piece in pieces:
            block = np.searchsorted(edges, piece.t, side="right")
            cuts = [0, *(np.flatnonzero(np.diff(block)) + 1), len(block)]
            yield from ((int(block[i]), piece[i:j]) for i, j in pairwise(cuts) if j > i)

    for block, group in groupby(parted(), itemgetter(0)):
        yield from blocks_of(log, block, Rows.joined([part for _, part in group]), supports)


def blocks_of(log: int, block: int, rows: Rows, supports: Sequence[np.ndarray]) -> list[Block]:
    """Return the blocks of some rows of one block of time, one a coordinate."""
    span, blocks = (float(rows.t[0]), float(rows.t[-1])), []
    for u, support in enumerate(supports):
        A, b, tau = rows.A[:, u, support], rows.b[:, u], rows.tau[:, u]
        informs, moves = rows.informed[:, u], rows.moving[:, u]
        some, rest, still = (
            Triangle.of(A[mask], b[mask]) if mask.any() else Triangle.empty(len(support))
            for mask in (informs, ~informs, informs & ~moves)
        )
        torque = float(tau[moves] @ tau[moves]), float(tau[~moves] @ tau[~moves])
        blocks.append(Block(log, block, u, some, rest, still, support, torque, span))
    return blocks


def bands_of(
    mechanism: Mechanism, columns: Columns, motion: Motion, point: Point, on_progress: Progress
) -> list[EliminatedRun]:
    """Return the stacks of all runs of samples, the multipliers of each eliminated."""
    if mechanism.unmeasured:
        raise FitError(
            f"{mechanism.name}: unmeasured: {', '.join(mechanism.unmeasured)}: a time basis of the "
            "multipliers needs all torques; give --basis free"
        )
    found, cutoff, settings = [], motion.band.cutoff, mechanism.multipliers
    for number, e in enumerate(motion.experiments):
        if settings.spacing * FINEST < 1 / e.rate:
            raise FitError(
                f"{e.name}: knots every {settings.spacing:g} s for samples every "
                f"{1 / e.rate:.3g} s; give a spacing of a few samples, or basis free"
            )
        scene = Scene.of(mechanism, columns, e, point, cutoff)
        on_progress(f"eliminating multipliers of {e.name}", number / len(motion.experiments))
        for segment in e.segments():
            if segment.stop - segment.start < 3:
                continue
            first, last = float(e.t[segment.start]), float(e.t[segment.stop - 1])
            basis = Basis.spanning(first, last, settings.spacing, settings.degree)
            if chunks := list(stack(scene, cutoff, segment, basis)):
                found.append(EliminatedRun.of(number, segment, basis, chunks))
    return found


def stacks_information(stacks: Sequence[EliminatedRun], motion: Motion) -> Information:
    """Return the equations that stacks leave as information of one coordinate: of all joints."""
    blocks: list[Block] = []
    for each in stacks:
        t = motion.experiments[each.experiment].t[each.segment]
        before = sum(block.log == each.experiment for block in blocks)
        edges = np.linspace(t[0], t[-1], len(each.elimination.factors) + 1).tolist()
        for i, found in enumerate(each.elimination.factors):
            support, none = np.arange(found.k), Triangle.empty(found.k)
            key, span = (each.experiment, before + i, 0), (edges[i], edges[i + 1])
            torque = found.rhs_norm() ** 2, 0.0
            blocks.append(Block(*key, found, none, none, support, torque, span))
    return Information.of(blocks, blocks[0].triangle.k, 1)


def plausible_of(mechanism: Mechanism, columns: Columns, information: Information) -> np.ndarray:
    """Return the largest plausible deviation (k,) of every unknown from its prior, in its own unit:
    a combination of parameters that the data know no better than this stays there.

    Of a body with mass m and size l (centre of mass, radius of gyration, or a mean link's length):
    m, m l, m l². Of an effect: ten times the largest torque per unit of its column.
    """
    squares = [t.column_norms() ** 2 / max(t.rows, 1) for t in information.totals]
    size = np.sqrt(np.sum(squares, axis=0))[len(columns.rigid) :]
    m, length = body_scales(mechanism)
    bodies = np.stack([m, *[m * length] * 3, *[m * length**2] * 6], axis=1).ravel()
    largest = float(information.rms_torque.max(initial=0.0)) or np.inf
    effects = np.minimum(TORQUE * largest, BOUNDLESS) / np.maximum(size, 1 / BOUNDLESS)
    return np.concatenate([bodies[columns.rigid], effects])


def body_scales(mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray]:
    """Return mass [kg] and size [m] of all bodies (bodies,): the URDF's, a mean link's at least."""
    model = mechanism.model
    count = len(mechanism.bodies.links)
    steps = [model.jointPlacements[i].translation for i in range(1, model.njoints)]
    for closure in mechanism.closures:  # in absolute coordinates these are all the steps there are
        if closure.frames:
            ends = (frame.placement.translation for frame in closure.frames)
            steps.append(max(ends, key=np.linalg.norm))
    mean = sum(float(np.linalg.norm(step)) for step in steps) / count
    bodies = mechanism.prior.reshape(count, COUNT)
    total = float(bodies[:, 0].sum())
    masses, sizes = [], []
    for m, moments, L in map(split, bodies):
        length = mean
        if m > 0:
            gyration = np.sqrt(max(np.trace(L), 0) / m)
            length = max(length, float(np.linalg.norm(moments)) / m, gyration)
        masses.append(max(m, total / count) or 100.0)
        sizes.append(length or 1.0)
    return np.array(masses), np.array(sizes)


@dataclass(frozen=True, eq=False)
class Table(Rows):
    """The rows of all experiments; `sample` is an index into the row's experiment."""

    experiment: np.ndarray  #: (n,) its number
    mechanism: Mechanism
    columns: Columns
    motion: Motion
    point: Point
    scenes: tuple[Scene, ...]  #: one an experiment
    every: int = 1  #: of so many samples one is evaluated for columns

    @classmethod
    def of(cls, mechanism: Mechanism, columns: Columns, motion: Motion, point: Point) -> Table:
        """Return the rows of a model at a working point."""
        cutoff = motion.band.cutoff
        scenes = tuple(Scene.of(mechanism, columns, e, point, cutoff) for e in motion.experiments)
        expected = sum(len(s.e) // Decimator.of(cutoff, s.e.rate).factor for s in scenes)
        every = max(1, -(-expected // TABLE))
        parts, number = [], []
        for i, scene in enumerate(scenes):
            for piece in rows(scene, cutoff):
                parts.append(piece[::every])
                number.append(np.full(len(parts[-1]), i))
        r = Rows.joined(parts)
        return cls(
            r.t, r.sample, r.A, r.b, r.tau, r.informed, r.moving, np.concatenate(number),
            mechanism, columns, motion, point, scenes,
        )  # fmt: skip

    @cached_property
    def blocks(self) -> np.ndarray:
        """(N,) numbers of stretches of time, about BLOCKS in all, none over two experiments."""
        each = max(2, -(-BLOCKS // len(self.scenes)))
        found = np.empty(len(self.t), dtype=int)
        for number in range(len(self.scenes)):
            mine = self.experiment == number
            found[mine] = number * each + np.arange(mine.sum()) * each // max(mine.sum(), 1)
        return found

    @cached_property
    def coarse(self) -> Table:
        """The same rows, with columns from fewer samples, the rows among them. Columns with steps
        are off at reversals: of dry friction by 0.2 % (rms) on the TX40, by 7 % on a five-bar.
        """
        own = (self.sample[self.experiment == i] for i in range(len(self.scenes)))
        step = int(np.gcd.reduce(np.concatenate([np.diff(at) for at in own])))
        cutoff = self.motion.band.cutoff
        most = min(s.e.rate for s in self.scenes) / (COARSE * cutoff) if cutoff else 1
        return replace(self, every=max(k for k in range(1, int(max(most, 1)) + 1) if step % k == 0))

    def filtered(self, number: int, x: np.ndarray) -> np.ndarray:
        """Return a series x (n, …) of an experiment's `samples`, in its rows (N_e, …)."""
        at, found = self._products[number]
        if not found:
            return x[at]
        flat = multiplied(found, x.reshape(len(x), -1))
        return flat.reshape(len(flat), *x.shape[1:])

    @cached_property
    def _products(self) -> list[tuple[np.ndarray, list[Product]]]:
        """Samples (N_e,) of the rows of each experiment, and the products that filter a series."""
        found = []
        for number, scene in enumerate(self.scenes):
            at, n = self.sample[self.experiment == number] // self.every, self.every
            whole = Decimator.of(self.motion.band.cutoff, scene.e.rate)
            taps = None if whole.taps is None else n * whole.taps[whole.half % n :: n]
            found.append((at, [] if taps is None else products(taps, at)))
        return found

    def effect_columns(
        self, effect: Effect, shapes: Sequence[Mapping[str, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return columns (N, c, numbers · shapes) of an effect at shapes, and the c coordinates."""
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
                out = s.columns(effect, shape) if own_rows else np.zeros((len(s), len(felt), u))
                if not own_rows:
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
            still = not effect.unknowns and not any(shape.values())  # it corrects nothing yet
            at = self.thin[number] if still else corrected(bare, cutoff, effect)
            S, t = (residual(at) - residual(moved)) / h, scene.e.t
            if len(S) != len(t):
                from scipy.interpolate import CubicSpline  # takes 0.2 s to import

                S = CubicSpline(bare.e.t, S)(t)
            series.append(self.filtered(number, S[self.samples[number].part]))
        return np.concatenate(series)

    @cached_property
    def thin(self) -> tuple[Samples, ...]:
        """The experiments with as few samples as smooth series allow, given the rows' filter."""
        most = SMOOTH * (self.motion.band.cutoff or np.inf)  # samples a second
        states = (s.e.thinned(max(1, int(s.e.rate / most))) for s in self.scenes)
        both = zip(self.scenes, states, strict=True)
        return tuple(replace(s.whole, e=e, memo={}) for s, e in both)

    @cached_property
    def samples(self) -> tuple[Samples, ...]:
        """The samples of which columns are evaluated: all, or one in so many, rows among them."""
        found = []
        for number, scene in enumerate(self.scenes):
            first = int(self.sample[self.experiment == number][:1].sum())
            some = slice(first % self.every, None, self.every)
            found.append(scene.whole.reduced(some if self.every > 1 else slice(None)))
        return tuple(found)

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

        everywhere = [name for name in each[0].extra if all(name in s.extra for s in each)]
        return replace(
            each[0],
            t=np.concatenate([s.t - s.t[0] for s in each]),  # of each log's own beginning
            extra={name: np.concatenate([s.extra[name] for s in each]) for name in everywhere},
            still=np.min([s.still for s in each], axis=0),
            predicted=lambda: (joined("torque"), joined("load")),
            q=joined("q"),
            v=joined("v"),
            a=joined("a"),
        )
