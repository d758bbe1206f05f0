"""`check`, `identify` and `compare`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ident.cli.console import notes, progress, result, wrote
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
    from ident.fit import Fit
    from ident.streams.gather import Gathered

MOST_IN_MEMORY = 1_000_000  # samples of all logs that are read at once
ADVICE = 4  # sentences on motions that would determine more


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
