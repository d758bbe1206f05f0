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
    LogPaths,
    MechanismPath,
    Out,
    Spacing,
    With,
    cutoff_of,
    mechanism_of,
    motion_of,
    output_file,
    output_folder,
)
from ident.cli.console import notes, progress, result
from ident.fit import identify as identify_
from ident.fit.output import write_fit
from ident.fit.reactions import compare_multipliers
from ident.fit.saved import read_fit
from ident.fit.structure import describe, structure
from ident.fit.summary import summary
from ident.log import read_log
from ident.residual import compare as compare_


def check(
    mechanism: MechanismPath,
    logs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="LOG", help="What these logs would let you identify."),
    ] = None,
    with_: With = None,
    cutoff: Cutoff = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
) -> None:
    """What was understood, and what could be identified.

    Joints, closures, degrees of freedom; of logs their columns and gaps; base parameters.
    """
    model = mechanism_of(mechanism, with_, allow_code=allow_code, absolute=absolute)
    motion = None
    with progress() as told:
        if logs:
            motion = motion_of(model, logs, cutoff_of(cutoff), told, torques=False)
        parts = [describe(model, motion), motion, structure(model, motion)]
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
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    reactions: Annotated[
        Path | None,
        typer.Option(metavar="LOG", help="Known reactions to compare the multipliers with."),
    ] = None,
    out: Out = None,
) -> None:
    """Parameters, effects and multipliers from logs.

    Values come with their standard errors, and with the error of the torque that they predict.
    """
    model = mechanism_of(
        mechanism, with_, allow_code=allow_code, basis=basis, spacing=spacing, absolute=absolute
    )
    output_folder(out)
    with progress() as told:
        motion = motion_of(model, logs, cutoff_of(cutoff), told)
        other = None
        if validate:
            other = motion_of(model, validate, motion.band.cutoff, told)
        fit = identify_(model, motion, validate=other, progress=told)
    result(summary(fit))
    known = None
    if reactions is not None:
        known = compare_multipliers(fit, read_log(reactions))
        result(f"\n{known}")
    notes(fit.warnings)
    if out is not None:
        for path in write_fit(fit, out, known):
            notes([f"wrote {path}"])


def compare(
    mechanism: MechanismPath,
    logs: LogPaths,
    fit: Annotated[
        list[Path], typer.Option(metavar="FIT.json", help="A fit; give several to compare them.")
    ],
    cutoff: Cutoff = "fit",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw it into this .png, .svg or .pdf.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write report.html and compare.json into this folder."),
    ] = None,
) -> None:
    """Models against measurement, joint by joint.

    Errors, the parts of the sum, and where each model fails: in which joint, when, in which regime
    of its motion, and on which signals what is left depends.
    """
    model = mechanism_of(mechanism, allow_code=allow_code, absolute=absolute)
    saved = [read_fit(path, model) for path in fit]
    output_file(plot, (".png", ".svg", ".pdf"))
    output_folder(out)
    with progress() as told:
        band = saved[0].cutoff if cutoff == "fit" else cutoff_of(cutoff)
        motion = motion_of(model, logs, band, told)
        comparison = compare_(*saved, motion=motion, progress=told)
        text = str(comparison)
    result(text)
    notes(motion.notes)
    if plot is not None:
        comparison.save(plot)
        notes([f"wrote {plot}"])
    if out is not None:
        notes([f"wrote {path}" for path in comparison.write(out)])
