"""Arguments and options that several commands share, and how they become nouns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ident.errors import IdentError
from ident.log import Log, read_log
from ident.mechanism import Mechanism, load, multipliers
from ident.mechanism.absolute import absolute as in_absolute
from ident.motion import Motion, complete
from ident.progress import Told

MechanismPath = Annotated[
    Path,
    typer.Argument(
        metavar="MECHANISM", help="A folder with a mechanism.toml, such a file, or a .urdf."
    ),
]
LogPaths = Annotated[
    list[Path],
    typer.Argument(metavar="LOG…", help="Recorded experiments: .csv, .parquet or .npz."),
]
With = Annotated[
    list[str] | None,
    typer.Option("--with", metavar="EFFECT", help="Add an effect: kind:joint[,joint], or kind."),
]
AllowCode = Annotated[
    bool,
    typer.Option("--allow-code", help="Run the Python files that mechanism.toml names."),
]
Cutoff = Annotated[
    str,
    typer.Option(metavar="HZ", help="Cut-off of the zero-phase filter in Hz, or auto, or none."),
]
Basis = Annotated[
    str | None,
    typer.Option(help="Time basis of the multipliers: free, linear, cubic, quintic."),
]
Spacing = Annotated[
    float | None, typer.Option(metavar="S", help="Spacing of the multipliers' knots in seconds.")
]
Absolute = Annotated[
    bool, typer.Option("--absolute", help="Restate the mechanism in absolute coordinates.")
]
Out = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Write the results into this folder.")
]


def mechanism_of(
    path: Path,
    effects: Sequence[str] | None = None,
    *,
    allow_code: bool = False,
    basis: str | None = None,
    spacing: float | None = None,
    absolute: bool = False,
) -> Mechanism:
    """The mechanism that the arguments describe."""
    mechanism = load(path, allow_code=allow_code)
    for effect in effects or ():
        mechanism = mechanism.with_effect(effect)
    if basis is not None or spacing is not None:
        now = mechanism.multipliers
        mechanism = replace(
            mechanism,
            multipliers=multipliers(
                now.basis if basis is None else basis,
                now.spacing if spacing is None else spacing,
                "--basis, --spacing",
            ),
        )
    return in_absolute(mechanism) if absolute else mechanism


def logs_of(paths: Sequence[Path], mechanism: Mechanism) -> list[Log]:
    """The logs under ident's names."""
    return [read_log(path, mechanism.columns) for path in paths]


def motion_of(
    mechanism: Mechanism, paths: Sequence[Path], cutoff: str, told: Told | None = None
) -> Motion:
    """The completed motion of some logs."""
    logs = logs_of(paths, mechanism)
    return complete(mechanism, logs, cutoff=cutoff_of(cutoff), progress=told)


def cutoff_of(text: str) -> float | str | None:
    """`auto`, None for `none`, or a frequency [Hz].

    Raises:
        IdentError: for anything else.
    """
    if text == "auto":
        return text
    if text == "none":
        return None
    try:
        return float(text)
    except ValueError:
        raise IdentError(f"--cutoff {text}: a frequency in Hz, auto or none is expected") from None
