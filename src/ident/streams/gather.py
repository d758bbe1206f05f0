"""The verb `gather`: logs that need not fit into memory become one fit."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ident.equations.point import Point
from ident.errors import FitError
from ident.fit import Fit
from ident.fit.assemble import assemble
from ident.fit.banded import banded
from ident.fit.constrain import constrained
from ident.fit.descend import shape_bounds, stepped
from ident.fit.identify import bias_of, estimated
from ident.fit.noisy import MATTERS, share_of_motion
from ident.fit.regression import Regression
from ident.fit.settle import settled
from ident.information.blocks import Error, Information
from ident.information.covariance import covariance
from ident.information.estimate import Estimate, estimate
from ident.log.folder import expanded
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Consistency
from ident.motion.derive import AUTO
from ident.motion.freedom import check_freedom
from ident.progress import Told
from ident.streams.checkpoint import Checkpoint, Progress, SearchStep
from ident.streams.gathered import Gathered
from ident.streams.logs import Excerpt, Workers, excerpt
from ident.streams.plan import Plan, summaries, with_logs
from ident.streams.portions import Sum, absorbed, stack_blocks

SAMPLES = 65_536  # of a portion
PASSES = 8  # at most, where the equations are not linear
RESTING = 0.01  # standard errors by which a step may still move predictions
ROUNDING = 1e-9  # of the sum of squares, within which two errors are the same
Given = str | os.PathLike[str]


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
    progress: Told | None = None,
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
    paths, others = (
        expanded([given] if isinstance(given, str | os.PathLike) else given)
        for given in (logs, validate)
    )
    if scheduler is not None:  # its workers are in folders of their own
        paths, others = ([path.absolute() for path in some] for some in (paths, others))
    if not paths:
        raise FitError(f"{mechanism.name}: no log given")
    workers = Workers(None if scheduler else jobs, scheduler, len(paths) == 1, progress)
    looked_at = summaries(mechanism, paths, workers)
    some = excerpt(mechanism, looked_at, cutoff, smoothing, workers.broken)
    logged, prior = some.experiments[0].logged, Point.prior(mechanism)
    common = Plan(mechanism, logged, some.independent, some.band, smoothing, (), prior)
    plan = with_logs(common, looked_at, samples, workers)
    kept = None if checkpoint is None else Checkpoint(Path(checkpoint), plan)
    plan = replace(plan, point=settled(mechanism, some, None, progress))
    plan, regression, found, notes, worked, resumed = _iterated(plan, some, workers, kept)
    fit = _fit_of(regression, found, notes, workers, consistent)
    if others:
        x = found.solution.x
        fit = replace(fit, validation=_validation(plan, regression, x, workers, others, samples))
    return Gathered(fit, regression, plan, workers, worked, resumed, kept)


def _check_portionable(mechanism: Mechanism, consistent: bool | Consistency) -> None:
    """Raise FitError for an effect or a fit that has no meaning in portions."""
    for effect in mechanism.effects:
        if consistent is not False and not effect.linear:
            raise FitError(
                f"{mechanism.name}: effect '{effect.label}' is not linear, so a consistent fit is "
                "made again where its limits put it, for which portions are not read; leave out "
                f"--consistent or {effect.label}, or identify logs that fit into memory"
            )
        if effect.memory and effect.kind != "hysteresis":
            raise FitError(
                f"{mechanism.name}: effect '{effect.label}' counts from a log's first sample, "
                "which a portion does not have; leave it out, or cut the log"
            )


def _iterated(
    plan: Plan, some: Excerpt, workers: Workers, kept: Checkpoint | None
) -> tuple[Plan, Regression, Estimate, list[str], int, int]:
    """Pass over all portions, once where the equations are linear, else until no shape moves.

    Returns:
        The plan at the last pass' point, its equations and estimate; notes; portions worked now,
        and those found in a checkpoint.
    """
    progress, resumed, worked = Progress(0, SearchStep(plan.point)), 0, 0
    notes: list[str] = []
    if kept is not None and (before := kept.read()) is not None:
        progress, resumed = before, before.absorbed
        workers.broken.update(before.broken)
        notes.append(
            f"went on from {kept.file}: pass {before.passed + 1}, {resumed} portions were done"
        )
    elif kept is not None and kept.other:
        notes.append(f"{kept.file}: of another mechanism, log, settings or version; not used")
    linear = all(effect.linear for effect in plan.mechanism.effects)
    while True:
        plan = replace(plan, point=progress.step.point)
        total, said = _pass(plan, progress, workers, kept)
        worked, notes = worked + total.worked, notes + said
        cells, left = total.without(()), stack_blocks(plan, total.stretches)
        r = Regression(plan.mechanism, some, plan.point, plan.columns, cells, left=left)
        found = estimated(r)
        step = progress.step if linear else _next_step(r, found, progress.step)
        rests = step.moves <= RESTING
        if linear or rests or progress.passed + 1 == PASSES:
            break
        progress = Progress(progress.passed + 1, step, broken=dict(workers.broken))
        if kept is not None:
            kept.write(progress)
    if not linear:
        how = "and rest" if rests else f"and still move predictions by {step.moves:.2g} ±"
        notes.append(
            f"what is not linear was settled on the excerpt and refined in {progress.passed + 1} "
            f"passes over all samples, {how}"
        )
    return plan, r, found, [*dict.fromkeys(notes)], worked, resumed


def _pass(
    plan: Plan, progress: Progress, workers: Workers, kept: Checkpoint | None
) -> tuple[Sum, list[str]]:
    """Sum the triangles of all portions at the plan's point, without those of broken logs."""
    left = list(plan.portions())[progress.absorbed :]
    total = Sum(progress.blocks, progress.absorbed, progress.stretches)
    names = [plan.parts[portion.log].name for portion in left]
    said: dict[int, tuple[str, ...]] = {}
    what = "equations" if not progress.passed else f"equations, pass {progress.passed + 1}"
    for index, done in workers.over(absorbed, left, plan, names, what):
        total.add(progress.absorbed + index, done)
        said[index] = done.notes if done else ()
        if kept is not None and kept.due(total.absorbed):
            kept.write(
                replace(
                    progress, absorbed=total.absorbed, blocks=total.without(()),
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
    return total, [note for index in sorted(said) for note in said[index]]


def _next_step(r: Regression, found: Estimate, step: SearchStep) -> SearchStep:
    """Step of variable projection, one a pass (`fit.descend`): the triangles of a pass give the
    least error at its point, which tells whether the step before was good, and the next step.

        s ← s + δs,  [Γ E S] [p; c; s] = b + S s₀
    """
    columns = r.columns
    shapes = np.zeros(len(columns), dtype=bool)
    shapes[columns.shapes] = True
    sigma = found.sigma if step.sigma is None else step.sigma
    zeros = np.zeros(len(r.factors))
    at = estimate(r.factors, r.prior, zeros, sigma=sigma, held=found.held | shapes)
    loss = at.factor.residual_norm(at.solution.x) ** 2
    if step.best is not None and loss > step.loss * (1 + ROUNDING):
        values = {
            name: 0.5 * (step.best.values.get(name, value) + value)
            for name, value in r.point.values.items()
        }
        return replace(step, point=Point(r.point.pi, values))
    x = found.solution.x
    if shapes.any():
        bounds = shape_bounds(r.mechanism, columns, r.motion, r.point)
        x = stepped(columns, r.point, x, bounds, 1.0)
    others = [r.point.values.get(name, 0.0) for name in columns.names[len(columns.rigid) :]]
    before = np.concatenate([r.point.pi[columns.rigid], others])
    implicit = any(effect.implicit for effect in r.mechanism.effects)
    moves = np.linalg.norm(found.factor.R @ np.where(shapes | implicit, x - before, 0.0))
    return SearchStep(r.point.at(r.mechanism, columns, x), r.point, loss, sigma, float(moves))


def _fit_of(
    r: Regression,
    found: Estimate,
    notes: Sequence[str],
    workers: Workers,
    consistent: bool | Consistency,
) -> Fit:
    """Make the fit of the last pass' triangles, whose pictures are those of the excerpt."""
    assert isinstance(r.motion, Excerpt)
    r = replace(r, motion=r.motion.without(workers.broken))
    cov = covariance(Information.of(r.fitting, len(r.columns), len(found.sigma)), found)
    notes = [note for note in notes if note not in r.motion.notes]
    share = float(share_of_motion(r, found).max(initial=0.0)) if len(r.columns) else 0.0
    if share >= MATTERS:
        notes.append(
            f"noise of the motion makes up to {100 * min(share, 1.0):.3g} % of the residual; in "
            "portions the motion is taken as it is, so that parameters may be shrunk: identify "
            "from a shorter log to see how much"
        )
    notes += bias_of(r, found)
    shown = sum(len(e) for e in r.motion.experiments)
    if shown < r.motion.samples:
        notes.append(
            f"{r.motion.samples} samples were read in portions; pictures, unfiltered errors and "
            f"the table of multipliers show {shown} of them"
        )
    if consistent is False:
        fit = assemble(r, found, cov, notes=notes, progress=workers.on_progress)
    else:
        asked = consistent if isinstance(consistent, Consistency) else Consistency()
        held = constrained(r, found, r.mechanism.consistency | asked, workers.on_progress)
        fit = assemble(
            held.regression, held.estimate, cov, outside=held.outside, binding=held.binding,
            notes=[*notes, *held.notes], progress=workers.on_progress,
        )  # fmt: skip
    # the ends of an excerpt's stretches are not those of the log
    cut = {log for e in r.motion.experiments if (log := e.name.partition(", ")[0]) != e.name}
    warnings = tuple(
        each
        for each in fit.warnings
        if not (": the filter takes" in each and each.partition(", ")[0] in cut)
    )
    bands = banded(r.mechanism, r.columns, r.motion, None, r.point) if r.left else ()
    return replace(fit, warnings=warnings, bands=tuple(bands))  # λ of the excerpt


def _validation(
    plan: Plan, r: Regression, x: np.ndarray, workers: Workers, paths: Sequence[Path], samples: int
) -> dict[str, dict[str, Error]]:
    """Errors of the parameters x (k,) in other logs, by log, then joint.

    Raises:
        IdentError: if one of them is broken.
    """
    alone = replace(workers, alone=True, broken={})
    plan = with_logs(plan, summaries(r.mechanism, paths, alone), samples, alone)
    portions, names, total = list(plan.portions()), [part.name for part in plan.parts], Sum()
    logs = [names[portion.log] for portion in portions]
    for index, each in alone.over(absorbed, portions, plan, logs, "validation"):
        total.add(index, each)
    information = Information.of(total.without(()), len(x), r.d)
    return {
        name: information.of_log(i).squares(x).errors(r.motion.independent, r.units)
        for i, name in enumerate(names)
    }
