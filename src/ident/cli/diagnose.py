"""`diagnose`, `grow` and `explore`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ident.cli.console import notes, progress, progress_and_results, result, wrote
from ident.cli.options import (
    Absolute,
    AllowCode,
    Basis,
    Cutoff,
    Jobs,
    LogPaths,
    MechanismPath,
    Paths,
    Scheduler,
    Smoothing,
    Spacing,
    With,
    cutoff_of,
    knots_of,
    many,
    mechanism_of,
    motion_of,
    option,
    output_folder,
)

if TYPE_CHECKING:
    from ident.diagnosis import Diagnosis
    from ident.diagnosis.grow import Step
    from ident.streams.diagnose_each import Verdicts

CleanSeed = Annotated[
    int, option("Seed of the noise in the clean logs to compare with.", "N", min=0)
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
    seed: CleanSeed = 0,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    out: Annotated[
        Path | None,
        option(
            "Write diagnosis.json and report.html into this folder, and suggestion.py where "
            "an expression is suggested.",
            "DIR",
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
    with progress() as on_progress:
        if many(logs, jobs, scheduler):
            from ident.streams.diagnose_each import diagnose_each

            found = diagnose_each(
                model, logs, cutoff=cutoff_of(cutoff), smoothing=knots_of(smoothing), seed=seed,
                jobs=jobs, scheduler=scheduler, progress=on_progress,
            )  # fmt: skip
            remarks = found.notes
        else:
            from ident.diagnosis import diagnose as diagnose_
            from ident.fit import identify

            motion = motion_of(model, logs, cutoff_of(cutoff), on_progress, smoothing=smoothing)
            fit = identify(model, motion, estimator="least-squares", progress=on_progress)
            found, remarks = diagnose_(fit, seed=seed, progress=on_progress), fit.warnings
        text = str(found)
    result(text)
    notes(remarks)
    if out is not None:
        wrote(found.write(out))


def grow(
    mechanism: MechanismPath,
    logs: LogPaths,
    with_: With = None,
    validate: Annotated[
        Paths, option("Show errors on this log too; nothing is fitted to it.", "LOG")
    ] = None,
    basis: Basis = None,
    spacing: Spacing = None,
    cutoff: Cutoff = "auto",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    seed: CleanSeed = 0,
    out: Annotated[
        Path | None,
        option(
            "Write the grown mechanism into this folder, with the last fit, diagnosis and "
            "report. Refused for the mechanism's own folder.",
            "DIR",
        ),
    ] = None,
) -> None:
    """Add the best effect, refit, and repeat until none is missing.

    Prints the ladder of held-out errors while it runs, then the diagnosis of the last model.
    """
    from ident.diagnosis import grow as grow_
    from ident.show.diagnosis import head, rung
    from ident.show.diagnosis_report import refuse_own

    model = mechanism_of(
        mechanism, with_, allow_code=allow_code, basis=basis, spacing=spacing, absolute=absolute
    )
    if out is not None:
        refuse_own(model, out)
    output_folder(out)
    with progress_and_results() as (on_progress, shown):
        motion = motion_of(model, logs, cutoff_of(cutoff), on_progress, smoothing=smoothing)
        other = validate and motion_of(
            model, validate, motion.band.cutoff, on_progress, smoothing=smoothing
        )

        def reached(step: Step) -> None:
            if step.added is None and not step.removed:
                shown(head(motion.independent))
            shown(rung(step, motion.independent))

        history = grow_(
            model, motion, validate=other or None, seed=seed, progress=on_progress, step=reached
        )
        text = str(history.diagnosis)
    result(f"\n{text}")
    notes(history.fit.warnings)
    if out is not None:
        wrote(history.write(out))


def explore(
    mechanism: MechanismPath,
    logs: LogPaths,
    with_: With = None,
    basis: Basis = None,
    spacing: Spacing = None,
    cutoff: Cutoff = "auto",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    port: Annotated[int, option("Port of the page; 0 is a free one.", "N", min=0, max=65535)] = 0,
    no_browser: Annotated[
        bool, option("Say the address, and open no browser.", None, "--no-browser")
    ] = False,
    out: Annotated[
        Path | None, option("The folder that the page proposes for saving.", "DIR")
    ] = None,
) -> None:
    """Add effects by hand, in a browser; watch the error fall.

    Serves a page on 127.0.0.1 until Ctrl-C. It lists every effect of the library with the fall of
    the held-out error that it would bring; a click adds it and refits everything.
    """
    from ident.show.explore import Exploration, check_panel, serve
    from ident.show.port import free_port

    check_panel()
    port = free_port(port)
    model = mechanism_of(
        mechanism, with_, allow_code=allow_code, basis=basis, spacing=spacing, absolute=absolute
    )
    with progress() as on_progress:
        motion = motion_of(model, logs, cutoff_of(cutoff), on_progress, smoothing=smoothing)
        found = Exploration.of(model, motion, on_progress).screened(on_progress)
    notes(found.fit.warnings)

    def ready(address: str) -> None:
        result(f"{model.name}: {address}")
        notes(["the page lives until Ctrl-C"])

    serve(found, port=port, browser=not no_browser, folder=out, ready=ready)
