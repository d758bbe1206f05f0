"""The verb `gather`: logs that need not fit into memory become one fit."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ident.equations.point import Point
from ident.errors import FitError
from ident.fit.settle import settled
from ident.gather.checkpoint import Checkpoint
from ident.gather.conclude import concluded, validated
from ident.gather.crew import Crew
from ident.gather.excerpt import excerpt
from ident.gather.gathered import Gathered
from ident.gather.passes import passes
from ident.gather.plan import SAMPLES, Plan
from ident.gather.planned import looked_at, with_logs
from ident.log.folder import expanded
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Consistency
from ident.motion.derive import AUTO
from ident.motion.freedom import check_freedom
from ident.progress import Told

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
    """One fit of logs that are read in portions, each seen a few times and never kept.

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
        checkpoint: a folder in which is kept what is done; the same call goes on from there.
        scheduler: address of a Dask scheduler, whose workers do the work.
        jobs: processes that do it; 1: this one; None: one a core, or the scheduler's workers.
        progress: called with (what is being done, share done).

    Returns:
        The fit, and what it rests on. `Gathered.write` writes all files.

    Raises:
        IdentError: if no log can be identified from, or the only one is broken.
    """
    check_freedom(mechanism)
    _check_streamable(mechanism, consistent)
    paths = _paths([logs] if isinstance(logs, str | os.PathLike) else logs, scheduler)
    others = _paths(validate, scheduler)
    if not paths:
        raise FitError(f"{mechanism.name}: no log given")
    crew = Crew(None if scheduler else jobs, scheduler, len(paths) == 1, progress)
    surveys = looked_at(mechanism, paths, crew)
    some = excerpt(mechanism, surveys, cutoff, smoothing, crew.broken)
    logged, prior = some.experiments[0].logged, Point.prior(mechanism)
    common = Plan(mechanism, logged, some.independent, some.band, smoothing, (), prior)
    plan = with_logs(common, surveys, samples, crew)
    kept = None if checkpoint is None else Checkpoint(Path(checkpoint), plan)
    done = passes(plan.at(settled(mechanism, some, None, progress)), some, crew, kept)
    fit = concluded(done, crew, consistent)
    if others:
        fit = replace(fit, validation=validated(done, crew, others, samples))
    return Gathered(
        fit, done.regression, done.plan, crew.broken, done.worked, done.resumed, crew, kept
    )


def _paths(given: Sequence[Given], scheduler: str | None) -> list[Path]:
    """Of all logs; whole ones for a scheduler's workers, which are in folders of their own."""
    paths = expanded(given)
    return paths if scheduler is None else [path.absolute() for path in paths]


def _check_streamable(mechanism: Mechanism, consistent: bool | Consistency) -> None:
    """Refuse what has no meaning in portions.

    Raises:
        FitError: naming it, and what to do.
    """
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
