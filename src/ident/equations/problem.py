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

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby, pairwise
from operator import itemgetter

import numpy as np

from ident.display import Progress, no_progress, part
from ident.equations.filter import Decimator
from ident.equations.motion_noise import EliminatedRun
from ident.equations.rows import Rows, Scene, row_supports, rows, stack
from ident.equations.unknowns import Columns, Point
from ident.errors import FitError
from ident.information.blocks import Block, Information
from ident.information.estimate import Estimate, estimate
from ident.information.linear import Triangle
from ident.information.time_bases import Basis
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, split
from ident.motion import Motion

FEWEST_BLOCKS, MOST_BLOCKS, LENGTH = 10, 96, 12  # work: blocks of a log, and rows that make one
BOUNDLESS = 1e30  # numerics: stands for infinity, with which 0 may be multiplied
TORQUE = 10.0  # range: times the largest torque, by which an effect's unknown is bounded
FINEST = 20.0  # work: knots a sample; more say nothing, and fill the memory


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
    sigma: np.ndarray | None = None  #: (d,) noise of coordinates, where rows at rest count too

    @classmethod
    def of(
        cls, mechanism: Mechanism, motion: Motion, point: Point, on_progress: Progress = no_progress
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
        """Make the reduced rows alone at a point, for estimates: a log is one block of time.

        `columns`: by default the mechanism's.
        """
        columns = columns or Columns.of(mechanism)
        information = information_of(mechanism, columns, motion, point, parted=False)
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
        return (
            self.with_rest_rows(stacks_information(stacks, self.motion))
            if stacks
            else self.information
        )

    def with_rest_rows(self, stacks: Information) -> Information:
        """Add the rows at rest, divided by their noise, to information of one coordinate."""
        if self.sigma is None:
            return stacks
        blocks, numbers = [*stacks], dict[int, int]()
        for block in self.information:
            if block.rest_rows is None or not block.resting:
                continue
            numbers[block.log] = numbers.get(block.log, max(b.block for b in blocks)) + 1
            rows = block.rest_rows.scaled(1 / self.sigma[block.coordinate])
            rows, none = rows.embedded(block.support, stacks.k), Triangle.empty(stacks.k)
            key, every = (block.log, numbers[block.log], 0), np.arange(stacks.k)
            torque = rows.rhs_norm() ** 2, 0.0
            block = Block(*key, rows, none, none, every, torque, block.span)
            blocks.append(replace(block, rest_rows=rows, stretches=1.0, resting=True))
        return Information.of(blocks, stacks.k, 1)

    @property
    def stacked(self) -> bool:
        """Whether parameters are estimated from rows of all coordinates together."""
        return bool(self.bands or self.runs)

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
        totals, weights = self.information.totals, None if "sigma" in fixed else self.sigma
        return estimate(totals, self.prior, self.torque, self.plausible, weights=weights, **fixed)


def information_of(
    mechanism: Mechanism,
    columns: Columns,
    motion: Motion,
    point: Point | None = None,
    on_progress: Progress = no_progress,
    parted: bool = True,
) -> Information:
    """Return the information of all experiments; rows are seen once, in pieces, and never kept.

    `parted`: in blocks of time, which may be left out; else a log is one.
    """
    blocks, cutoff = list[Block](), motion.band.cutoff
    for number, e in enumerate(motion.experiments):
        supports = row_supports(mechanism, columns, e)
        edges = np.zeros(0)
        if parted:
            edges = block_edges(cutoff, e.t[0], e.t[-1], len(e), e.poses)
        scene = Scene.of(mechanism, columns, e, point, cutoff)
        for block in triangles(number, rows(scene, cutoff), edges, supports):
            blocks.append(block if e.rest is None else block.with_rest(e.rest[block.coordinate]))
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


def block_edges(
    cutoff: float | None, first: float, last: float, samples: int, poses: bool = False
) -> np.ndarray:
    """Return the times [s] that part a log of so many samples from t = first to last in blocks; of
    poses each is one.
    """
    rate = cutoff * 4 if cutoff else (samples - 1) / (last - first)
    count = int(np.clip((last - first) * rate / LENGTH, FEWEST_BLOCKS, MOST_BLOCKS))
    count = min(samples, MOST_BLOCKS) if poses else count
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
        yield from blocks_of(log, block, Rows.concatenated([part for _, part in group]), supports)


def blocks_of(log: int, block: int, rows: Rows, supports: Sequence[np.ndarray]) -> list[Block]:
    """Return the blocks of some rows of one block of time, one a coordinate."""
    span, blocks = (float(rows.t[0]), float(rows.t[-1])), []
    by_coordinate = rows.A.transpose(1, 2, 0)  # samples are contiguous, as LAPACK wants them
    informs, at_rest = rows.informed, rows.rest > 0
    still, opened = informs & ~rows.moving & ~at_rest, ~informs
    squares, stretches = rows.tau**2, (rows.rest**2).sum(axis=0)
    in_motion, standing = ((squares * x).sum(axis=0) for x in (rows.moving, ~rows.moving))
    kinds = np.stack([x.any(axis=0) for x in (still, opened, at_rest, informs)], axis=1)
    for u, (support, has) in enumerate(zip(supports, kinds, strict=True)):
        columns = np.empty((len(support) + 1, len(rows)))
        np.take(by_coordinate[u], support, axis=0, out=columns[:-1], mode="clip")
        columns[-1] = rows.b[:, u]
        none = Triangle.empty(len(support))
        standing_still, open_rows = (
            Triangle.of_columns(columns[:, mask[:, u]]) if any_of else none
            for mask, any_of in ((still, has[0]), (opened, has[1]))
        )
        rest_rows, resting = None, False
        if has[2]:
            resting_now = at_rest[:, u]
            resting = bool(informs[resting_now, u].all())  # they are weighed already
            weight = np.ones(1) if resting else rows.rest[resting_now, u]
            rest_rows = Triangle.of_columns(columns[:, resting_now] * weight)
        informing_rows = none
        if has[3]:
            informing_rows = Triangle.of_columns(columns[:, informs[:, u]] if has[1] else columns)
        blocks.append(
            Block(
                log, block, u, informing_rows, open_rows, standing_still, support,
                (float(in_motion[u]), float(standing[u])), span, rest_rows, float(stretches[u]),
                resting,
            )
        )  # fmt: skip
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
    stacks, cutoff, settings = [], motion.band.cutoff, mechanism.multipliers
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
                stacks.append(EliminatedRun.of(number, segment, basis, chunks))
    return stacks


def stacks_information(stacks: Sequence[EliminatedRun], motion: Motion) -> Information:
    """Return the equations that stacks leave as information of one coordinate: of all joints."""
    blocks: list[Block] = []
    for stack_run in stacks:
        t = motion.experiments[stack_run.experiment].t[stack_run.segment]
        before = sum(block.log == stack_run.experiment for block in blocks)
        edges = np.linspace(t[0], t[-1], len(stack_run.elimination.factors) + 1).tolist()
        for i, factor in enumerate(stack_run.elimination.factors):
            support, none = np.arange(factor.k), Triangle.empty(factor.k)
            key, span = (stack_run.experiment, before + i, 0), (edges[i], edges[i + 1])
            torque = factor.rhs_norm() ** 2, 0.0
            blocks.append(Block(*key, factor, none, none, support, torque, span))
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
    bodies = mechanism.plausible_prior.reshape(count, COUNT)
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
