"""`check`, `identify` and `compare`."""

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
    Out,
    Scheduler,
    Smoothing,
    Spacing,
    With,
    bound_of,
    cutoff_of,
    knots_of,
    many,
    mechanism_of,
    motion_of,
    output_file,
    output_folder,
)
from ident.cli.console import notes, progress, result
from ident.compare import compare as compare_
from ident.errors import IdentError
from ident.fit import Fit
from ident.fit import identify as identify_
from ident.fit.output import write_fit
from ident.fit.reactions import compare_multipliers
from ident.fit.saved import read_fit
from ident.fit.structure import channels, describe, structure
from ident.fit.summary import summary
from ident.log import read_log
from ident.log.folder import expanded
from ident.log.pieces import likely_rows
from ident.mechanism import Consistency
from ident.show.charts import SUFFIXES
from ident.simulate import replay
from ident.simulate.replay import WINDOW
from ident.streams import Gathered, gather

MOST_IN_MEMORY = 1_000_000  # samples of all logs that are read at once
ADVICE = 4  # sentences on what another motion would tell


def check(
    mechanism: MechanismPath,
    logs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="LOG", help="What these logs would let you identify."),
    ] = None,
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
    model = mechanism_of(mechanism, with_, allow_code=allow_code, absolute=absolute)
    motion = None
    with progress() as told:
        if logs:
            motion = motion_of(model, logs, cutoff_of(cutoff), told, False, smoothing)
        seen = channels(model, motion) if motion is not None else None
        parts = [describe(model, motion), motion, seen, structure(model, motion)]
    result("\n\n".join(str(part) for part in parts if part is not None))


def identify(
    mechanism: MechanismPath,
    logs: LogPaths,
    with_: With = None,
    validate: Annotated[
        list[Path] | None,
        typer.Option(metavar="LOG", help="Report errors on this log; nothing is fitted to it."),
    ] = None,
    basis: Basis = None,
    spacing: Spacing = None,
    cutoff: Cutoff = "auto",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    reactions: Annotated[
        Path | None,
        typer.Option(metavar="LOG", help="Known reactions to compare the multipliers with."),
    ] = None,
    consistent: Annotated[
        bool,
        typer.Option(
            "--consistent",
            help="Possible bodies, no negative friction or stiffness, bounds of [parameters].",
        ),
    ] = False,
    bound: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOW:HIGH",
            help="Keep a parameter between two values, either of which may be left out; "
            "implies --consistent.",
        ),
    ] = None,
    total_mass: Annotated[
        float | None,
        typer.Option(metavar="KG", help="Mass of all moving bodies; implies --consistent."),
    ] = None,
    refine: Annotated[
        bool,
        typer.Option(
            "--refine",
            help="Let the motion move within its noise until torques and channels agree best.",
        ),
    ] = False,
    stream: Annotated[
        bool,
        typer.Option(
            "--stream",
            help="Read the logs in portions, never all at once; so are logs of more than a million "
            "samples anyway. With --out, a run that was interrupted goes on where it was.",
        ),
    ] = False,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    out: Out = None,
) -> None:
    """Parameters, effects and multipliers from logs.

    Values come with their standard errors, and with the error of the torque that they predict. Of a
    folder, every log is also judged beside the others, and broken ones are left out.
    """
    model = mechanism_of(
        mechanism, with_, allow_code=allow_code, basis=basis, spacing=spacing, absolute=absolute
    )
    limits = Consistency(dict(map(bound_of, bound or ())), total_mass)
    asked = limits if bound or total_mass is not None else consistent
    output_folder(out)
    long = sum(map(likely_rows, logs)) > MOST_IN_MEMORY
    if stream or long or many(logs, jobs, scheduler):
        if refine:
            raise IdentError(
                "--refine: needs all samples at once; leave it out, or identify from one shorter "
                "log without --stream, --jobs and --scheduler"
            )
        if long and not stream:
            notes([f"more than {MOST_IN_MEMORY} samples: read in portions (--stream)"])
        with progress() as told:
            gathered = gather(
                model, logs, cutoff=cutoff_of(cutoff), smoothing=knots_of(smoothing),
                validate=validate or (), consistent=asked, checkpoint=out, scheduler=scheduler,
                jobs=1 if jobs is None and len(expanded(logs)) == 1 else jobs, progress=told,
            )  # fmt: skip
        _told(gathered.fit, gathered, reactions, out)
        return
    with progress() as told:
        motion = motion_of(model, logs, cutoff_of(cutoff), told, smoothing=smoothing)
        other = None
        if validate:
            other = motion_of(model, validate, motion.band.cutoff, told, smoothing=smoothing)
        fit = identify_(
            model, motion, validate=other, consistent=asked,
            estimator="likelihood" if refine else "auto", progress=told,
        )  # fmt: skip
    _told(fit, None, reactions, out)


def _told(fit: Fit, gathered: Gathered | None, reactions: Path | None, out: Path | None) -> None:
    """What was found, as text and as files."""
    result(gathered.summary if gathered else summary(fit))
    known = None
    if reactions is not None:
        known = compare_multipliers(fit, read_log(reactions))
        result(f"\n{known}")
    notes(gathered.notes if gathered else fit.warnings)
    notes(_advice(fit))
    if out is not None:
        for path in gathered.write(out, known) if gathered else write_fit(fit, out, known):
            notes([f"wrote {path}"])


def _advice(fit: Fit) -> list[str]:
    """Which motion would tell what this one does not, where one can be made up."""
    try:
        said = list(fit.unexcited.advice)
    except IdentError:
        return []
    more = [f"and {len(said) - ADVICE} more such: fit.unexcited"] if len(said) > ADVICE else []
    return said[:ADVICE] + more


def compare(
    mechanism: MechanismPath,
    logs: LogPaths,
    fit: Annotated[
        list[Path], typer.Option(metavar="FIT.json", help="A fit; give several to compare them.")
    ],
    cutoff: Cutoff = "fit",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw it into this .png, .svg, .pdf or .html."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write report.html and compare.json into this folder."),
    ] = None,
    simulated: Annotated[
        bool,
        typer.Option(
            "--simulate",
            help="Integrate the motion too, against the measured one; --plot draws that, --out "
            "adds replay.html and replay.json.",
        ),
    ] = False,
    window: Annotated[
        float | None,
        typer.Option(metavar="S", help="Of --simulate, from one restart to the next. Default: 0.5"),
    ] = None,
) -> None:
    """Models against measurement, joint by joint.

    Errors, the parts of the sum, and where each model fails: in which joint, when, in which regime
    of its motion, and on which signals what is left depends.
    """
    model = mechanism_of(mechanism, allow_code=allow_code, absolute=absolute)
    if window is not None and not simulated:
        raise IdentError("--window: is of --simulate; add that")
    saved = [read_fit(path, model) for path in fit]
    output_file(plot, SUFFIXES)
    output_folder(out)
    with progress() as told:
        band = saved[0].cutoff if cutoff == "fit" else cutoff_of(cutoff)
        motion = motion_of(model, logs, band, told, smoothing=smoothing)
        comparison = compare_(*saved, motion=motion, progress=told)
        text = str(comparison)
    result(text)
    notes(motion.notes)
    again = None
    if simulated:
        with progress() as told:
            again = replay(
                *saved, motion=motion, window=WINDOW if window is None else window, progress=told
            )
        result(f"\n{again}")
    if plot is not None:
        (again or comparison).save(plot)
        notes([f"wrote {plot}"])
    if out is not None:
        written = comparison.write(out) + (again.write(out) if again else [])
        notes([f"wrote {path}" for path in written])
