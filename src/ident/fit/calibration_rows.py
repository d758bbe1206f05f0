"""The rows in which an error budget is made: those of the fit, with columns of causes beside them.

Least squares: the reduced rows of all logs, of long ones stretches. Where torques and motion are
weighed together: rows at the rate of the motion's knots, from which the motion is eliminated after
the causes' columns N are put beside A, so that both are whitened by the same noise,

    A β + N S η − F G B (c − ĉ) = b,    U (c − ĉ) = 0          (`equations.motion_noise`)
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ident.effects.drive import TorqueGain
from ident.equations.filter import Decimator, multiplied, products
from ident.equations.motion_noise import LinearRun, rows_cutoff
from ident.equations.problem import Problem, block_edges, blocks_of, stacks_information, triangles
from ident.equations.rows import Rows, Scene
from ident.equations.table import SMOOTH, Table
from ident.equations.unknowns import Columns, Point
from ident.errors import IdentError
from ident.fit.likelihood import Likelihood, Linearization
from ident.information.blocks import Block, Information
from ident.information.estimate import Estimate
from ident.information.linear import Array
from ident.information.stationary import rows_alike
from ident.mechanism.causes import CalibrationError, causes_of
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion

SAMPLES = 8_000  # work: that columns are made of, as few as smooth series allow
STRETCHES = 16  # work: of a log with more
TOGETHER = 8  # work: causes whose columns are filtered at once
SMALLER = (1.0, 0.1, 0.01)  # work: shares of a prior scale at which a column is taken


class FitRows(ABC):
    """Rows (N, d) of a fit, in which causes have columns."""

    problem: Problem
    tables: tuple[Table, ...]  #: the rows, one after the other
    white: bool  #: whether they are divided by their noise already

    def causes(self) -> Iterator[CalibrationError]:
        """Yield the causes of calibration errors of the fit's mechanism and logs."""
        states = self.problem.motion.experiments
        logged = dict.fromkeys(name for e in states for name in e.logged)
        rate = max(e.rate for e in states)
        mechanism = self.problem.mechanism
        zero = {  # a torque that is 0 because nothing pushes has no gain
            f"tau.{name}"
            for j, name in enumerate(mechanism.driven)
            if not any(np.any(e.tau[:, j]) for e in states)
        }
        every = causes_of(mechanism, tuple(logged), rate)
        yield from (cause for cause in every if cause.place not in zero)

    @property
    def poses(self) -> bool:
        """Whether the logs are tables of poses."""
        return self.problem.motion.poses

    @cached_property
    def informed(self) -> Array:
        """(N, d) whether a row informs."""
        return np.concatenate([table.informed for table in self.tables])

    @cached_property
    def torque(self) -> Array:
        """(d,) rms of the measured torques in the rows [N m | N]."""
        tau = np.concatenate([table.tau for table in self.tables])
        return np.asarray(np.sqrt((tau**2).mean(axis=0)))

    def columns(self, causes: Sequence[CalibrationError]) -> list[np.ndarray | None]:
        """Return by cause the change (N, d) of b − A x by one standard deviation of it, by a
        difference over a share of it: so that friction which jumps counts as it does in the mean.
        None if no difference can be made: a loop that cannot be closed with another length, say.
        """
        columns: list[np.ndarray | None] = [None] * len(causes)
        slopes = dict[int, list[list[np.ndarray]]]()  # by cause that corrects, table and experiment
        for k, cause in enumerate(causes):
            if cause.effect.corrects:
                made = self._slopes(cause)
                slopes |= {} if made is None else {k: made}
                continue
            with suppress(IdentError, np.linalg.LinAlgError):
                parts = [self._column(table, cause) for table in self.tables]
                if all(np.isfinite(part).all() for part in parts):
                    columns[k] = np.concatenate(parts)
        for first in range(0, len(slopes), TOGETHER):
            batch = [*slopes][first : first + TOGETHER]
            rows = np.concatenate([
                table.smooth_columns([
                    np.stack(of_causes, axis=2)
                    for of_causes in zip(*(slopes[k][number] for k in batch), strict=True)
                ])
                for number, table in enumerate(self.tables)
            ])  # fmt: skip
            for k, column in zip(batch, rows.transpose(2, 0, 1), strict=True):
                columns[k] = causes[k].scale * column
        return columns

    def _column(self, table: Table, cause: CalibrationError) -> np.ndarray:
        """Return the column (N, d) of a cause that is an effect in the rows of a table."""
        column, predicted = np.zeros(table.b.shape), None if self.white else table.predicted
        if isinstance(cause.effect, TorqueGain) and predicted is not None:
            (name,) = cause.effect.joints
            u = table.mechanism.joint(name).index
            column[:, u] = predicted[:, u]
        else:
            C, felt = table.effect_columns(cause.effect, [{}])
            column[:, felt] = C[:, :, 0]
        return cause.scale * column

    def _slopes(self, cause: CalibrationError) -> list[list[np.ndarray]] | None:
        """Return `Table.slopes` of a cause that corrects by table; None if none can be made."""
        for share in SMALLER:
            with suppress(IdentError, np.linalg.LinAlgError):
                slopes = [_slopes(table, cause, share) for table in self.tables]
                if all(np.isfinite(x).all() for of_table in slopes for x in of_table):
                    return slopes
        return None

    def with_causes(self, fitted: Estimate, columns: Array, known: Array) -> Rows:
        """Return the rows of [A_I, N S], `columns` (N, d, c) of causes behind those of the model,
        with what is corrected in the tables already (N, d) given back; unknowns that are held stay
        at their prior.
        """
        base, fixed = fitted.base.independent, np.flatnonzero(fitted.fixed)
        every = Rows.concatenated([_rows(table) for table in self.tables])
        b = every.b - every.A[:, :, fixed] @ fitted.x[fixed] + known
        A = np.concatenate([every.A[:, :, base], columns], axis=2)
        return replace(every, A=A, b=b)

    def repeated(self, rows: Rows, x: Array) -> Array:
        """Return (d,) of how many rows that inform what is left at x (k,) tells as much as of one:
        filtered noise is alike in neighbouring rows.
        """
        residual = np.where(self.informed, rows.b - rows.A @ x, np.nan)
        log = np.concatenate([table.experiment for table in self.tables])
        runs = [np.flatnonzero(log == number) for number in np.unique(log)]
        return np.array([rows_alike([series[run] for run in runs]) for series in residual.T])

    def _corrected(
        self, x: Array, causes: Sequence[CalibrationError], values: Array
    ) -> tuple[Mechanism, Point]:
        """Return the mechanism without causes of some `values`, in units of their prior scales, and
        the point of the parameters x (k,).
        """
        mechanism = self.problem.mechanism
        for cause, value in zip(causes, values, strict=True):
            (parameter,) = cause.effect.parameters
            known = {parameter.name: float(value * cause.scale)}
            mechanism += replace(cause.effect, values=known)
        point = self.problem.point_at(x)
        return mechanism, point.with_values(Point.prior(mechanism).values)

    def excerpt(self) -> FitRows:
        """Return rows of which columns are cheap."""
        return self

    @abstractmethod
    def jitter(self, x: Array, causes: Sequence[CalibrationError]) -> Array:
        """Return the variance (N, d) of rows by steps of friction that fall between samples: by
        parts of one, another one in each reversal, where channels are late by parts of a sample.
        """

    @abstractmethod
    def corrected(self, x: Array, causes: Sequence[CalibrationError], values: Array) -> FitRows:
        """Return the rows without causes of some values, at the parameters x (k,)."""

    @abstractmethod
    def same_as(self, rows: FitRows) -> bool:
        """Return whether least squares in these rows is the estimate of the fit with `rows`."""

    @abstractmethod
    def noise(self, scatter: Array, white: Array, now: Estimate) -> Array:
        """Return the covariance by noise, from that of the blocks' scatter and that of rows whose
        residual is as large as noise, both (n, n).
        """

    @abstractmethod
    def remaining(self, information: Information, x: Array, fitted: Estimate) -> Array:
        """Return the squared residual (d,) at x over that of the fit."""

    @abstractmethod
    def reduced(self, rows: Rows, whole: bool = False) -> Information:
        """Return rows as information; `whole`: of which the totals alone are asked."""


@dataclass(frozen=True, eq=False)
class ReducedRows(FitRows):
    """Rows of least squares: of all logs, of coordinates that are weighed by their residual."""

    problem: Problem
    table: Table
    white = False

    @property
    def tables(self) -> tuple[Table, ...]:  # type: ignore[override]
        """The rows."""
        return (self.table,)

    def excerpt(self) -> FitRows:
        """Return the same of stretches of long logs."""
        problem, motion = self.problem, _excerpt(self.problem.motion)
        if motion is problem.motion:
            return self
        table = Table.of(problem.mechanism, problem.columns, motion, self.table.point)
        return ReducedRows(replace(problem, motion=motion), table)

    def same_as(self, rows: FitRows) -> bool:
        """Return whether no log is cut, and no multiplier or motion was eliminated."""
        every = rows.problem.information.rows // self.table.b.shape[1]
        return not rows.problem.stacked and len(self.table.t) == every

    def corrected(self, x: Array, causes: Sequence[CalibrationError], values: Array) -> FitRows:
        """Return the rows of corrected logs and mechanism."""
        mechanism, point = self._corrected(x, causes, values)
        table = Table.of(mechanism, Columns.of(mechanism), self.problem.motion, point)
        return ReducedRows(self.problem, table)

    def jitter(self, x: Array, causes: Sequence[CalibrationError]) -> Array:
        """Return the filtered squares of what an effect's torque changes by from sample to sample.

        A step at t is seen at the next sample, one that is late by d = k + φ samples k or k + 1
        samples later, a share φ of all: a variance of φ (1 − φ) samples².
        """
        values, table = self.problem.point_at(x).values, self.table
        point, variance = table.point.with_values(values), np.zeros(table.b.shape)
        lateness = {c.place: c.scale for c in causes if c.kind == "lateness"}
        for number, scene in enumerate(table.scenes):
            e, at = scene.e, table.sample[table.experiment == number]
            samples = replace(scene.samples.reduced(slice(None)), point=point)
            squares = np.zeros((len(e), table.b.shape[1]))  # of a step from one to the next
            for effect in table.mechanism.effects:
                places = (f"{channel}.{name}" for name in effect.joints for channel in ("q", "tau"))
                spread = e.rate * math.hypot(*(lateness.get(place, 0.0) for place in places))
                if not spread or effect.corrects or effect.implicit or effect.loaded_link:
                    continue
                if e.loop is None:
                    for name in effect.acting:
                        torque = samples.torque_of(effect, name)
                        u = table.mechanism.joint(name).index
                        squares[1:, u] += _of_a_share(spread) * np.diff(torque) ** 2
                    continue
                torques = np.zeros(squares.shape)
                samples.add_effect(torques, effect, *point.of(effect))
                squares[1:] += _of_a_share(spread) * np.diff(torques, axis=0) ** 2
            taps = Decimator.of(self.problem.motion.band.cutoff, e.rate).taps
            rows = squares[at] if taps is None else multiplied(products(taps**2, at), squares)
            variance[table.experiment == number] = rows
        return variance * table.scale**2

    def noise(self, scatter: Array, white: Array, now: Estimate) -> Array:
        """Return the blocks' covariance."""
        return scatter

    def remaining(self, information: Information, x: Array, fitted: Estimate) -> Array:
        """Return mean squares over those of the fit."""
        before = _mean_squares(self.problem.information, fitted.x)
        return _mean_squares(information, x) / np.maximum(before, 1e-300)

    def reduced(self, rows: Rows, whole: bool = False) -> Information:
        """Return the triangles of the blocks of all logs; `whole`: as one block."""
        blocks, motion = list[Block](), self.problem.motion
        supports = [np.arange(rows.A.shape[2])] * rows.b.shape[1]
        if whole:
            blocks = blocks_of(0, 0, rows, supports)
            return Information.of(blocks, rows.A.shape[2], rows.b.shape[1])
        for number, e in enumerate(motion.experiments):
            at = self.table.experiment == number
            if at.any():
                edges = block_edges(motion.band.cutoff, e.t[0], e.t[-1], len(e), e.poses)
                blocks += triangles(number, [rows[at]], edges, supports)
        return Information.of(blocks, rows.A.shape[2], rows.b.shape[1])


@dataclass(frozen=True, eq=False)
class WhitenedRows(FitRows):
    """Rows of torques and motion together, linear about parameters and motion."""

    problem: Problem
    likelihood: Likelihood
    linear: Linearization
    white = True

    @cached_property
    def tables(self) -> tuple[Table, ...]:  # type: ignore[override]
        """The rows of torques, one table an experiment."""
        linear, problem, tables = self.linear, self.linear.problem, []
        for number, (e, fine) in enumerate(zip(linear.experiments, linear.fine, strict=True)):
            runs = [run.rows for run in linear.parts if run.experiment == number]
            if not runs:
                continue
            rows, cutoff = Rows.concatenated(runs), rows_cutoff(fine, e.rate)
            band = replace(problem.motion.band, cutoff=cutoff)
            motion = replace(problem.motion, experiments=(e,), band=band)
            scene = Scene.of(problem.mechanism, problem.columns, e, problem.point, cutoff)
            tables.append(
                Table(
                    **vars(rows), experiment=np.zeros(len(rows), dtype=int),
                    mechanism=problem.mechanism, columns=problem.columns, motion=motion,
                    point=problem.point, scenes=(scene,), scale=np.ones(rows.b.shape),
                )
            )  # fmt: skip
        return tuple(tables)

    def same_as(self, rows: FitRows) -> bool:
        """Return true: these are the rows of the fit."""
        return True

    def corrected(self, x: Array, causes: Sequence[CalibrationError], values: Array) -> FitRows:
        """Return the rows linear about corrected logs and mechanism."""
        mechanism, point = self._corrected(x, causes, values)
        grown = replace(
            self.problem, mechanism=mechanism, columns=Columns.of(mechanism), point=point
        )
        linear = self.linear.again(grown, x)
        return replace(self, linear=linear)

    def jitter(self, x: Array, causes: Sequence[CalibrationError]) -> Array:
        """Return zeros: the noise of the motion holds it."""
        return np.zeros(self.informed.shape)

    def noise(self, scatter: Array, white: Array, now: Estimate) -> Array:
        """Return the mean of both."""
        squares = self.linear.squares_per_row(now)
        return self.likelihood.mean_covariance(scatter, white, squares)

    def remaining(self, information: Information, x: Array, fitted: Estimate) -> Array:
        """Return ones: the motion has moved, residuals are no measure."""
        return np.ones(self.problem.information.d)

    def reduced(self, rows: Rows, whole: bool = False) -> Information:
        """Return the rows after the motion is eliminated."""
        runs, first = [], 0
        for run in self._runs():
            rows_of_run, first = rows[first : first + len(run.rows)], first + len(run.rows)
            runs.append(replace(run, rows=rows_of_run).eliminated(self.likelihood.sigma))
        return stacks_information(runs, self.problem.motion)

    def _runs(self) -> list[LinearRun]:
        """Return the runs in the order of the tables."""
        return sorted(self.linear.parts, key=lambda run: run.experiment)


def _slopes(table: Table, cause: CalibrationError, share: float) -> list[np.ndarray]:
    """Return by experiment slopes (n, d) of a cause that corrects, over a share of its scale."""
    (parameter,) = cause.effect.parameters
    none = {parameter.name: 0.0}
    return table.slopes(cause.effect, none, parameter.name, share * cause.scale)


def _of_a_share(spread: float) -> float:
    """Return the mean of φ (1 − φ), φ the part beyond whole samples of a normal lateness whose
    standard deviation is `spread` samples: by E|d| − E d² where it is small, at most that of all φ.
    """
    return min(1 / 6, max(0.0, np.sqrt(2 / np.pi) * spread - min(spread, 0.25) ** 2))


def _rows(table: Table) -> Rows:
    """Return the rows of a table alone."""
    names = ("t", "sample", "A", "b", "tau", "informed", "moving", "rest")
    return Rows(**{name: getattr(table, name) for name in names})


def _mean_squares(information: Information, x: Array) -> Array:
    """Return the mean squared residual (d,) of unknowns x (k,)."""
    return np.array([t.residual_norm(x) ** 2 / max(t.rows, 1) for t in information.totals])


def _excerpt(motion: Motion) -> Motion:
    """Return a motion of no more samples than budgets are made of: of longer ones, stretches."""
    cutoff = motion.band.cutoff
    steps = [max(1, int(e.rate / (SMOOTH * cutoff))) if cutoff else 1 for e in motion.experiments]
    share = SAMPLES / sum(len(e) / k for e, k in zip(motion.experiments, steps, strict=True))
    if share >= 1:
        return motion
    states = []
    for e in motion.experiments:
        length = len(e) / STRETCHES
        cuts = (int(i * length) for i in range(STRETCHES))
        pieces = (e.at_samples(slice(a, a + max(3, int(share * length)))) for a in cuts)
        states += [piece for piece in pieces if piece.usable.any()]
    return replace(motion, experiments=tuple(states))
