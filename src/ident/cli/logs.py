"""Commands on logs: `check`, `identify`, `compare`, `diagnose`, `grow` and `explore`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ident.cli.console import notes, progress, progress_and_results, result, wrote
from ident.cli.options import (
    CHARTS,
    Absolute,
    AllowCode,
    Basis,
    Cutoff,
    Jobs,
    LogPaths,
    MechanismPath,
    Out,
    Paths,
    Plot,
    Scheduler,
    Smoothing,
    Spacing,
    Texts,
    With,
    argument,
    cutoff_of,
    interval,
    knots_of,
    many,
    mechanism_of,
    motion_of,
    option,
    output_file,
    output_folder,
)
from ident.errors import IdentError

if TYPE_CHECKING:
    from ident.diagnosis import Diagnosis
    from ident.diagnosis.grow import Step
    from ident.fit import Fit
    from ident.streams.diagnose_each import Verdicts
    from ident.streams.gather import Gathered

MOST_IN_MEMORY = 1_000_000  # samples of all logs that are read at once
ADVICE = 4  # sentences on motions that would determine more
CleanSeed = Annotated[
    int, option("Seed of the noise in the clean logs to compare with.", "N", min=0)
]


def check(
    mechanism: MechanismPath,
    logs: Annotated[Paths, argument("What these logs would let you identify.", "LOG")] = None,
    with_: With = None,
    cutoff: Cutoff = "auto",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
) -> None:
    """What was understood, and what could be identified.

    Joints, closures, degrees of freedom; of logs their columns, gaps and noise, and what smoothing
    left of each channel; base parameters.
    """
    from ident.show.fit import channels, describe, structure

    model = mechanism_of(mechanism, with_, allow_code=allow_code, absolute=absolute)
    motion = seen = None
    with progress() as on_progress:
        if logs:
            motion = motion_of(model, logs, cutoff_of(cutoff), on_progress, False, smoothing)
            seen = channels(model, motion)
        parts = [describe(model, motion), motion, seen, structure(model, motion)]
    result("\n\n".join(str(part) for part in parts if part is not None))


def identify(
    mechanism: MechanismPath,
    logs: LogPaths,
    with_: With = None,
    validate: Annotated[
        Paths, option("Report errors on this log; nothing is fitted to it.", "LOG")
    ] = None,
    basis: Basis = None,
    spacing: Spacing = None,
    cutoff: Cutoff = "auto",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    reactions: Annotated[
        Path | None, option("Known reactions to compare the multipliers with.", "LOG")
    ] = None,
    consistent: Annotated[
        bool,
        option(
            "Possible bodies, no negative friction or stiffness, bounds of [parameters].",
            None, "--consistent",
        ),
    ] = False,
    bound: Annotated[
        Texts,
        option(
            "Keep a parameter between two values, either of which may be left out; "
            "implies --consistent.",
            "NAME=LOW:HIGH",
        ),
    ] = None,
    total_mass: Annotated[
        float | None, option("Mass of all moving bodies; implies --consistent.", "KG")
    ] = None,
    refine: Annotated[
        bool,
        option(
            "Let the motion move within its noise until torques and channels agree best.",
            None, "--refine",
        ),
    ] = False,
    stream: Annotated[
        bool,
        option(
            "Read the logs in portions, never all at once; so are logs of more than a million "
            "samples anyway. With --out, a run that was interrupted goes on where it was.",
            None, "--stream",
        ),
    ] = False,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    out: Out = None,
) -> None:  # fmt: skip
    """Parameters, effects and multipliers from logs.

    Values come with their standard errors, and with the error of the torque that they predict. Of a
    folder, every log is also judged beside the others, and broken ones are left out.
    """
    from ident.log.pieces import likely_rows
    from ident.log.read import expanded
    from ident.mechanism import Consistency

    model = mechanism_of(
        mechanism, with_, allow_code=allow_code, basis=basis, spacing=spacing, absolute=absolute
    )
    remedy = (
        "is no bound; write NAME=LOW:HIGH, such as rod.m=0.4:0.6, or one of the two, rod.m=0.4:"
    )
    bounds = dict(interval(text, "--bound", remedy) for text in bound or ())
    limits = Consistency(bounds, total_mass) if bound or total_mass is not None else consistent
    output_folder(out)
    long = sum(map(likely_rows, logs)) > MOST_IN_MEMORY
    if stream or long or many(logs, jobs, scheduler):
        from ident.streams.gather import gather

        if refine:
            raise IdentError(
                "--refine: needs all samples at once; leave it out, or identify from one shorter "
                "log without --stream, --jobs and --scheduler"
            )
        if long and not stream:
            notes([f"more than {MOST_IN_MEMORY} samples: read in portions (--stream)"])
        with progress() as on_progress:
            gathered = gather(
                model, logs, cutoff=cutoff_of(cutoff), smoothing=knots_of(smoothing),
                validate=validate or (), consistent=limits, checkpoint=out, scheduler=scheduler,
                jobs=1 if jobs is None and len(expanded(logs)) == 1 else jobs,
                progress=on_progress,
            )  # fmt: skip
        _show(gathered.fit, gathered, reactions, out)
        return
    from ident.fit.identify import identify as identify_

    with progress() as on_progress:
        motion = motion_of(model, logs, cutoff_of(cutoff), on_progress, smoothing=smoothing)
        other = validate and motion_of(
            model, validate, motion.band.cutoff, on_progress, smoothing=smoothing
        )
        fit = identify_(
            model, motion, validate=other or None, consistent=limits,
            estimator="likelihood" if refine else "auto", progress=on_progress,
        )  # fmt: skip
    _show(fit, None, reactions, out)


def _show(fit: Fit, gathered: Gathered | None, reactions: Path | None, out: Path | None) -> None:
    """Write a fit to the terminal and into files."""
    from ident.show.fit import summary

    result(gathered.summary if gathered else summary(fit))
    known = None
    if reactions is not None:
        from ident.log import read_log

        known = fit.compare_multipliers(read_log(reactions))
        result(f"\n{known}")
    notes(gathered.notes if gathered else fit.warnings)
    notes(_advice(fit))
    if out is not None:
        from ident.fit.files import write_fit

        wrote(gathered.write(out, known) if gathered else write_fit(fit, out, known))


def _advice(fit: Fit) -> list[str]:
    """Return which motions would determine what this one does not."""
    try:
        advice = list(fit.unexcited.advice)
    except IdentError:
        return []
    more = [f"and {len(advice) - ADVICE} more such: fit.unexcited"] if len(advice) > ADVICE else []
    return advice[:ADVICE] + more


def compare(
    mechanism: MechanismPath,
    logs: LogPaths,
    fit: Annotated[list[Path], option("A fit; give several to compare them.", "FIT.json")],
    cutoff: Cutoff = "fit",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    plot: Plot = None,
    out: Annotated[
        Path | None, option("Write report.html and compare.json into this folder.", "DIR")
    ] = None,
    simulated: Annotated[
        bool,
        option(
            "Integrate the motion too, against the measured one; --plot draws that, --out "
            "adds replay.html and replay.json.",
            None, "--simulate",
        ),
    ] = False,
    window: Annotated[
        float | None, option("Of --simulate, from one restart to the next. Default: 0.5", "S")
    ] = None,
) -> None:  # fmt: skip
    """Models against measurement, joint by joint.

    Errors, the parts of the sum, and where each model fails: in which joint, when, in which regime
    of its motion, and on which signals what is left depends.
    """
    from ident.fit.compare import compare as compare_
    from ident.fit.files import read_fit

    model = mechanism_of(mechanism, allow_code=allow_code, absolute=absolute)
    if window is not None and not simulated:
        raise IdentError("--window: is of --simulate; add that")
    saved = [read_fit(path, model) for path in fit]
    output_file(plot, CHARTS)
    output_folder(out)
    with progress() as on_progress:
        band = saved[0].cutoff if cutoff == "fit" else cutoff_of(cutoff)
        motion = motion_of(model, logs, band, on_progress, smoothing=smoothing)
        comparison = compare_(*saved, motion=motion, progress=on_progress)
        text = str(comparison)
    result(text)
    notes(motion.notes)
    again = None
    if simulated:
        from ident.simulate.replay import WINDOW, replay

        with progress() as on_progress:
            again = replay(
                *saved,
                motion=motion,
                window=WINDOW if window is None else window,
                progress=on_progress,
            )
        result(f"\n{again}")
    if plot is not None:
        (again or comparison).save(plot)
        wrote([plot])
    if out is not None:
        wrote(comparison.write(out) + (again.write(out) if again else []))


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
