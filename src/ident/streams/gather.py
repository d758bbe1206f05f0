"""Logs that need not fit into memory become one fit: the verb `gather`, its noun `Gathered`."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ident.display import Displayed, render
from ident.equations.rows import dof
from ident.equations.unknowns import Point
from ident.errors import FitError
from ident.files import check_writable
from ident.fit import Fit
from ident.fit.files import multipliers_rows, write_fit
from ident.fit.findings import note
from ident.fit.identify import estimate_of, fit_of
from ident.fit.likelihood import MATTERS, share_of_motion
from ident.fit.multipliers import Reactions, identifiable_multipliers
from ident.fit.problem import Problem, bands_of
from ident.fit.shapes import shape_bounds, stepped, working_point
from ident.information.blocks import Error, Information
from ident.information.estimate import Estimate, estimate
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Consistency
from ident.motion.closures import check_freedom
from ident.motion.recipe import AUTO
from ident.pool import Workers
from ident.streams.checkpoint import Checkpoint, Progress, SearchStep
from ident.streams.logs import Excerpt, Given, excerpt, log_paths
from ident.streams.many_logs import LogComparison, compare_logs
from ident.streams.portions import (
    Plan,
    Sum,
    absorbed,
    multipliers_of,
    stack_blocks,
    summaries,
    with_logs,
)  # fmt: skip

SAMPLES = 65_536  # of a portion
PASSES = 8  # at most, where the equations are not linear
RESTING = 0.01  # standard errors by which a step may still move predictions
ROUNDING = 1e-9  # of the sum of squares, within which two errors are the same


@dataclass(frozen=True, eq=False, repr=False)
class Gathered(Displayed):
    """One fit of many portions of logs. Made by `ident.gather`.

    Attributes:
        fit: of all logs; its motion, and with it every picture, is an excerpt.
        regression: all rows as triangles; `Block.log` is the number of the log in the plan.
        plan: what all portions had in common; its parts are the logs that were opened.
        workers: who did the work.
        worked, resumed: portions worked in this run, and those found in a checkpoint.
        checkpoint: the file of what is done, if one was kept; removed once the fit is written.
    """

    fit: Fit
    regression: Problem
    plan: Plan
    workers: Workers
    worked: int
    resumed: int
    checkpoint: Checkpoint | None = None

    @property
    def broken(self) -> Mapping[str, str]:
        """By name of a log, why it was left out."""
        return self.workers.broken

    @property
    def several(self) -> bool:
        """Whether several logs were given."""
        return not self.workers.alone

    @cached_property
    def each(self) -> LogComparison:
        """The logs one by one, and which of them disagree with the others."""
        names = {i: part.name for i, part in enumerate(self.plan.parts)}
        samples = {part.name: part.samples for part in self.plan.parts}
        return compare_logs(self.regression, names, samples, self.broken)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know before trusting the fit, logs that were left out among it."""
        return (*self.fit.warnings, *(self.each.notes if self.several else ()))

    @property
    def summary(self) -> str:
        """What `print` shows, without the notes."""
        return str(render(self, "summary"))

    def write(self, folder: str | Path, reactions: Reactions | None = None) -> list[Path]:
        """Write what `Fit.write` writes, multipliers of all samples, and end the checkpoint.

        Of several logs logs.csv too, one row a log, and a table in the report.

        Args:
            folder: made if it is not there.
            reactions: known ones, which the report draws beside the multipliers.

        Returns:
            The files written, all of them or none.

        Raises:
            IdentError: if the folder cannot be written, or a log no longer be read.
        """
        folder = Path(folder)
        check_writable(folder)
        fit, more, sections = self.fit, {}, []
        if self.several:
            more = {"logs.csv": self.each.table.write_csv().encode()}
            sections = [render(self.each, "section")]
            if self.each.odd:  # first, since other notes may follow from it
                sentence = f"{render(self.each, 'sentence')}: see Log by log"
                fit = replace(fit, findings=(note(sentence), *fit.findings))
        with self._multipliers(folder) as multipliers:
            paths = write_fit(fit, folder, reactions, multipliers, more, sections)
        if self.checkpoint is not None:
            self.checkpoint.remove()
        return paths

    @contextlib.contextmanager
    def _multipliers(self, folder: Path) -> Iterator[Path | None]:
        """Write a hidden file with the multipliers of all samples, removed unless it is moved."""
        if not self.fit.mechanism.kinematics.multipliers:
            yield None
            return
        folder.mkdir(parents=True, exist_ok=True)
        for stale in folder.glob(".multipliers.csv.*.part"):  # of a run that was killed
            stale.unlink(missing_ok=True)
        file = folder / f".multipliers.csv.{secrets.token_hex(4)}.part"
        try:
            with file.open("xb") as stream:
                for rows in self._multiplier_rows():
                    stream.write(rows)
            yield file
        finally:
            file.unlink(missing_ok=True)

    def _multiplier_rows(self) -> Iterator[bytes]:
        """Yield the rows of all portions in order, the header first, in a second pass."""
        plan = replace(self.plan, point=self.fit.point)
        names = plan.mechanism.kinematics.multipliers
        logs = [i for i, part in enumerate(plan.parts) if part.name not in self.broken]
        portions = [portion for i in logs for portion in plan.portions(i)]
        determined = identifiable_multipliers(plan.mechanism, self.fit.motion)
        of = [plan.parts[portion.log].name for portion in portions]
        nothing, several = (np.empty(0), np.empty((0, len(names)))), len(logs) > 1
        yield multipliers_rows(names, *nothing, "" if several else None, header=True)
        done = self.workers.over(multipliers_of, portions, plan, of, "multipliers")
        for log, (_, each) in zip(of, done, strict=True):
            t, values = each or nothing
            values = np.where(determined, values, np.nan)
            yield multipliers_rows(names, t, values, log if several else None, header=False)


def gather(
    mechanism: Mechanism,
    logs: Given | Sequence[Given],
    *,
    cutoff: float | str | None = "auto",
    smoothing: float | str | None = AUTO,
    validate: Sequence[Given] = (),
    consistent: bool | Consistency = False,
    samples: int = SAMPLES,
    checkpoint: str | os.PathLike[str] | None = None,
    scheduler: str | None = None,
    jobs: int | None = 1,
    progress: Callable[[str, float], None] | None = None,
) -> Gathered:
    """Identify from logs that are read in portions, each a few times and never kept.

    What `complete` and `identify` decide from all samples is decided here from some stretches of
    each log (the filter, how channels are smoothed) or from a first pass (top speeds). The motion's
    noise is not weighed against the torques'; a note says where that would matter. Of several logs,
    those that are broken are left out.

    Args:
        mechanism: with what is unknown and which effects it has.
        logs: paths of logs and of folders of logs.
        cutoff, smoothing: as `complete` takes them.
        validate: logs on which errors are reported and nothing is fitted.
        consistent: as `identify` takes it.
        samples: of a portion, about.
        checkpoint: a folder for what is done; after a crash the same call goes on from there.
        scheduler: address of a Dask scheduler, whose workers do the work.
        jobs: processes that do it; 1: this one; None: one a core, or the scheduler's workers.
        progress: called with (what is being done, share done).

    Returns:
        The fit, and what it rests on. `Gathered.write` writes all files.

    Raises:
        IdentError: if no log can be identified from, or the only one is broken.
    """
    check_freedom(mechanism)
    _check_portionable(mechanism, consistent)
    paths, others = log_paths(logs, scheduler), log_paths(validate, scheduler)
    if not paths:
        raise FitError(f"{mechanism.name}: no log given")
    workers = Workers(None if scheduler else jobs, scheduler, len(paths) == 1, progress)
    looked_at = summaries(mechanism, paths, workers)
    some = excerpt(mechanism, looked_at, cutoff, smoothing, workers.broken)
    logged, prior = some.experiments[0].logged, Point.prior(mechanism)
    common = Plan(mechanism, logged, some.independent, some.band, smoothing, (), prior)
    plan = with_logs(common, looked_at, samples, workers)
    saved = None if checkpoint is None else Checkpoint(Path(checkpoint), plan)
    plan = replace(plan, point=working_point(mechanism, some, None, progress))
    plan, regression, fitted, notes, worked, resumed = _iterated(plan, some, workers, saved)
    fit = _fit_of(regression, fitted, notes, workers, consistent)
    if others:
        x = fitted.solution.x
        fit = replace(fit, validation=_validation(plan, regression, x, workers, others, samples))
    return Gathered(fit, regression, plan, workers, worked, resumed, saved)


def _check_portionable(mechanism: Mechanism, consistent: bool | Consistency) -> None:
    """Raise FitError for an effect or a fit that has no meaning in portions."""
    for effect in mechanism.effects:
        if consistent is not False and not effect.linear:
            raise FitError(
                f"{mechanism.name}: effect '{effect.label}' is not linear, so a consistent fit is "
                "made again where its limits put it, for which portions are not read; leave out "
                f"--consistent or {effect.label}, or identify logs that fit into memory"
            )
        if effect.memory and not effect.fades:
            raise FitError(
                f"{mechanism.name}: effect '{effect.label}' counts from a log's first sample, "
                "which a portion does not have; leave it out, or cut the log"
            )


def _iterated(
    plan: Plan, some: Excerpt, workers: Workers, saved: Checkpoint | None
) -> tuple[Plan, Problem, Estimate, list[str], int, int]:
    """Pass over all portions, once where the equations are linear, else until no shape moves."""
    progress, resumed, worked = Progress(0, SearchStep(plan.point)), 0, 0
    notes: list[str] = []
    if saved is not None and (before := saved.read()) is not None:
        progress, resumed = before, before.absorbed
        workers.broken.update(before.broken)
        notes.append(
            f"went on from {saved.file}: pass {before.passed + 1}, {resumed} portions were done"
        )
    elif saved is not None and saved.other:
        notes.append(f"{saved.file}: of another mechanism, log, settings or version; not used")
    linear = all(effect.linear for effect in plan.mechanism.effects)
    while True:
        plan = replace(plan, point=progress.step.point)
        total, messages = _pass(plan, progress, workers, saved)
        worked, notes = worked + total.absorbed - progress.absorbed, notes + messages
        stacks = stack_blocks(plan, total.stretches)
        k, d = len(plan.columns), dof(plan.mechanism, some.experiments[0])
        r = Problem(
            plan.mechanism, some, plan.point, plan.columns,
            Information.of(total.blocks.values(), k, d),
            stacked_information=Information.of(stacks, k, 1) if stacks else None,
        )  # fmt: skip
        fitted = estimate_of(r)
        step = progress.step if linear else _next_step(r, fitted, progress.step)
        rests = step.moves <= RESTING
        if linear or rests or progress.passed + 1 == PASSES:
            break
        progress = Progress(progress.passed + 1, step, broken=dict(workers.broken))
        if saved is not None:
            saved.write(progress)
    if not linear:
        how = "and rest" if rests else f"and still move predictions by {step.moves:.2g} ±"
        notes.append(
            f"what is not linear was settled on the excerpt and refined in {progress.passed + 1} "
            f"passes over all samples, {how}"
        )
    return plan, r, fitted, [*dict.fromkeys(notes)], worked, resumed


def _pass(
    plan: Plan, progress: Progress, workers: Workers, saved: Checkpoint | None
) -> tuple[Sum, list[str]]:
    """Sum the triangles of all portions at the plan's point, without those of broken logs."""
    remaining = list(plan.portions())[progress.absorbed :]
    total = Sum(progress.blocks, progress.absorbed, progress.stretches)
    names = [plan.parts[portion.log].name for portion in remaining]
    messages: list[str] = []
    what = "equations" if not progress.passed else f"equations, pass {progress.passed + 1}"
    for _, done in workers.over(absorbed, remaining, plan, names, what):
        total.add(done)
        messages += done.notes if done else ()
        if saved is not None and saved.due(total.absorbed):
            saved.write(
                replace(
                    progress, absorbed=total.absorbed, blocks=tuple(total.blocks.values()),
                    stretches=dict(total.stretches), broken=dict(workers.broken),
                )
            )  # fmt: skip
    out = {i for i, part in enumerate(plan.parts) if part.name in workers.broken}
    total.blocks = {key: each for key, each in total.blocks.items() if key.log not in out}
    total.stretches = {log: each for log, each in total.stretches.items() if log not in out}
    if not total.blocks:
        cut = plan.band.cutoff
        why = "; ".join(f"{name}: {each}" for name, each in list(workers.broken.items())[:1])
        raise FitError(
            f"{plan.mechanism.name}: no equations in {len(plan.parts)} log(s)"
            + (f" filtered at {cut:.3g} Hz" if cut else "")
            + f"; {why or 'give a longer log or a higher --cutoff'}"
        )
    return total, messages


def _next_step(r: Problem, fitted: Estimate, step: SearchStep) -> SearchStep:
    """Step of variable projection, one a pass (`fit.descend`): the triangles of a pass give the
    least error at its point, which tells whether the step before was good, and the next step.

        s ← s + δs,  [Γ E S] [p; c; s] = b + S s₀
    """
    columns = r.columns
    shapes = np.zeros(len(columns), dtype=bool)
    shapes[columns.shapes] = True
    sigma = fitted.sigma if step.sigma is None else step.sigma
    zeros = np.zeros(r.d)
    at = estimate(r.information.totals, r.prior, zeros, sigma=sigma, held=fitted.held | shapes)
    loss = at.triangle.residual_norm(at.x) ** 2
    if step.best is not None and loss > step.loss * (1 + ROUNDING):
        values = {
            name: 0.5 * (step.best.values.get(name, value) + value)
            for name, value in r.point.values.items()
        }
        return replace(step, point=Point(r.point.pi, values))
    x = fitted.solution.x
    if shapes.any():
        bounds = shape_bounds(r.mechanism, columns, r.motion, r.point)
        x = stepped(columns, r.point, x, bounds, 1.0)
    implicit = any(effect.implicit for effect in r.mechanism.effects)
    moved = np.where(shapes | implicit, x - r.point.unknowns(columns), 0.0)
    moves = np.linalg.norm(fitted.triangle.R @ moved)
    return SearchStep(r.point.at(r.mechanism, columns, x), r.point, loss, sigma, float(moves))


def _fit_of(
    r: Problem,
    fitted: Estimate,
    notes: Sequence[str],
    workers: Workers,
    consistent: bool | Consistency,
) -> Fit:
    """Make the fit of the last pass' triangles, whose pictures are those of the excerpt."""
    assert isinstance(r.motion, Excerpt)
    r = replace(r, motion=r.motion.without(workers.broken))
    notes = [note for note in notes if note not in r.motion.notes]
    share = float(share_of_motion(r, fitted).max(initial=0.0)) if len(r.columns) else 0.0
    if share >= MATTERS:
        notes.append(
            f"noise of the motion makes up to {100 * min(share, 1.0):.3g} % of the residual; in "
            "portions the motion is taken as it is, so that parameters may be shrunk: identify "
            "from a shorter log to see how much"
        )
    shown = sum(len(e) for e in r.motion.experiments)
    if shown < r.motion.samples:
        notes.append(
            f"{r.motion.samples} samples were read in portions; pictures, unfiltered errors and "
            f"the table of multipliers show {shown} of them"
        )
    fit = fit_of(r, fitted, consistent, [*map(note, notes)], on_progress=workers.on_progress)
    if r.stacked_information is None:
        return fit
    bands = bands_of(r.mechanism, r.columns, r.motion, r.point)  # λ of the excerpt
    return replace(fit, problem=replace(fit.problem, bands=tuple(bands)))


def _validation(
    plan: Plan, r: Problem, x: np.ndarray, workers: Workers, paths: Sequence[Path], samples: int
) -> dict[str, dict[str, Error]]:
    """Errors of the parameters x (k,) in other logs, by log, then joint."""
    alone = replace(workers, alone=True, broken={})
    plan = with_logs(plan, summaries(r.mechanism, paths, alone), samples, alone)
    portions, names, total = list(plan.portions()), [part.name for part in plan.parts], Sum()
    logs = [names[portion.log] for portion in portions]
    for _, each in alone.over(absorbed, portions, plan, logs, "validation"):
        total.add(each)
    information = Information.of(total.blocks.values(), len(x), r.d)
    return {
        name: information.of_log(i).squares(x).errors(r.motion.independent, r.units)
        for i, name in enumerate(names)
    }
