"""`diagnose` and `grow`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ident.cli.arguments import (
    Absolute,
    AllowCode,
    Basis,
    Cutoff,
    Jobs,
    LogPaths,
    MechanismPath,
    Scheduler,
    Smoothing,
    Spacing,
    With,
    cutoff_of,
    knots_of,
    many,
    mechanism_of,
    motion_of,
    output_folder,
)
from ident.cli.console import notes, progress, progress_and_results, result
from ident.diagnose import Diagnosis
from ident.diagnose import diagnose as diagnose_
from ident.diagnose import grow as grow_
from ident.diagnose.grow import Step
from ident.diagnose.ladder import head, rung
from ident.diagnose.output import refuse_own
from ident.fit import identify
from ident.streams import Verdicts, diagnose_each

Seed = Annotated[
    int, typer.Option(metavar="N", min=0, help="Of the noise in the clean logs to compare with.")
]


def diagnose(
    mechanism: MechanismPath,
    logs: LogPaths,
    with_: With = None,
    basis: Basis = None,
    spacing: Spacing = None,
    cutoff: Cutoff = "auto",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    seed: Seed = 0,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Write diagnosis.json and report.html into this folder, and suggestion.py where "
            "an expression is suggested.",
        ),
    ] = None,
) -> None:
    """Where the model fails, and which effect is missing.

    Every effect of the library at every place is judged by errors held out in time. The verdict is
    missing, nothing or unexplained; the exit status is 0 for each of them. Of a folder, each log is
    diagnosed by itself too, on many processes or machines.
    """
    model = mechanism_of(
        mechanism, with_, allow_code=allow_code, basis=basis, spacing=spacing, absolute=absolute
    )
    output_folder(out)
    found: Diagnosis | Verdicts
    with progress() as told:
        if many(logs, jobs, scheduler):
            found = diagnose_each(
                model, logs, cutoff=cutoff_of(cutoff), smoothing=knots_of(smoothing), seed=seed,
                jobs=jobs, scheduler=scheduler, progress=told,
            )  # fmt: skip
            said = found.notes
        else:
            motion = motion_of(model, logs, cutoff_of(cutoff), told, smoothing=smoothing)
            fit = identify(model, motion, estimator="least-squares", progress=told)
            found, said = diagnose_(fit, seed=seed, progress=told), fit.warnings
        text = str(found)
    result(text)
    notes(said)
    if out is not None:
        notes([f"wrote {path}" for path in found.write(out)])


def grow(
    mechanism: MechanismPath,
    logs: LogPaths,
    with_: With = None,
    validate: Annotated[
        list[Path] | None,
        typer.Option(metavar="LOG", help="Show errors on this log too; nothing is fitted to it."),
    ] = None,
    basis: Basis = None,
    spacing: Spacing = None,
    cutoff: Cutoff = "auto",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    seed: Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Write the grown mechanism into this folder, with the last fit, diagnosis and "
            "report. Refused for the mechanism's own folder.",
        ),
    ] = None,
) -> None:
    """Add the best effect, refit, and repeat until none is missing.

    Prints the ladder of held-out errors while it runs, then the diagnosis of the last model.
    """
    model = mechanism_of(
        mechanism, with_, allow_code=allow_code, basis=basis, spacing=spacing, absolute=absolute
    )
    if out is not None:
        refuse_own(model, out)
    output_folder(out)
    with progress_and_results() as (told, shown):
        motion = motion_of(model, logs, cutoff_of(cutoff), told, smoothing=smoothing)
        other = None
        if validate:
            other = motion_of(model, validate, motion.band.cutoff, told, smoothing=smoothing)

        def reached(step: Step) -> None:
            if step.added is None and not step.removed:
                shown(head(motion.independent))
            shown(rung(step, motion.independent))

        history = grow_(model, motion, validate=other, seed=seed, progress=told, step=reached)
        text = str(history.diagnosis)
    result(f"\n{text}")
    notes(history.fit.warnings)
    if out is not None:
        notes([f"wrote {path}" for path in history.write(out)])
