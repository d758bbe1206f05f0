"""Arguments and options that several commands share, and how they become nouns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ident.effects import KINDS, parse_user, read_user_effect
from ident.errors import IdentError
from ident.files import check_writable
from ident.log import Log, read_log
from ident.log.folder import expanded, is_folder_of_logs
from ident.mechanism import Mechanism, Multipliers, load, multipliers
from ident.mechanism.absolute import absolute as in_absolute
from ident.mechanism.mechanism import DEGREES
from ident.motion import Motion, complete
from ident.progress import Told

MechanismPath = Annotated[
    Path,
    typer.Argument(
        metavar="MECHANISM",
        help="A folder with a mechanism.toml, such a file, or a .urdf, MuJoCo's .xml or an .sdf.",
    ),
]
LogPaths = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG",
        help="Recorded experiments, one or several: .csv, .parquet, .npz, ROS 2 bag or .mcap; or "
        "folders of them.",
    ),
]


def kinds_beginning(incomplete: str) -> list[tuple[str, str]]:
    """Kinds of effects for the Tab key, each with what it is.

    No joints: a colon parts words in bash.
    """
    return [(kind, each.equation) for kind, each in KINDS.items() if kind.startswith(incomplete)]


With = Annotated[
    list[str] | None,
    typer.Option(
        "--with",
        metavar="EFFECT",
        autocompletion=kinds_beginning,
        help="Add an effect, as viscous:elbow, viscous for all driven joints, or one of your own, "
        "file.py:function:elbow.",
    ),
]
AllowCode = Annotated[
    bool,
    typer.Option("--allow-code", help="Run the Python files that mechanism.toml or --with names."),
]
Cutoff = Annotated[
    str,
    typer.Option(metavar="HZ", help="Cut-off of the zero-phase filter: a number, auto or none."),
]
Smoothing = Annotated[
    str,
    typer.Option(
        metavar="S",
        help="Knots of the smooth motion: their distance in seconds, auto, or none for the log's "
        "positions, velocities and accelerations as they are.",
    ),
]
Basis = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        autocompletion=lambda incomplete: [b for b in DEGREES if b.startswith(incomplete)],
        help="Time basis of the multipliers: free, linear, cubic or quintic.",
    ),
]
Spacing = Annotated[
    float | None, typer.Option(metavar="S", help="Distance of the basis' knots in seconds.")
]
Absolute = Annotated[
    bool, typer.Option("--absolute", help="Work in absolute coordinates, six a body.")
]
Out = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Write fit, report and identified model into this folder."),
]

Jobs = Annotated[
    int | None,
    typer.Option(metavar="N", help="Processes on this machine. Default: one a core."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Of a Dask scheduler, as tcp://host:8786: its workers do it, not this machine.",
    ),
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
        mechanism = grown(mechanism, effect, allow_code=allow_code)
    if basis is not None or spacing is not None:
        mechanism = replace(mechanism, multipliers=_basis(mechanism.multipliers, basis, spacing))
    return in_absolute(mechanism) if absolute else mechanism


def grown(mechanism: Mechanism, text: str, *, allow_code: bool) -> Mechanism:
    """The mechanism with an effect of the library, or with one of a Python file."""
    own = parse_user(text)
    if own is None:
        return mechanism.with_effect(text)
    file, name, joints = own
    return mechanism + read_user_effect(file, name, allow_code=allow_code)(joints)


def _basis(now: Multipliers, basis: str | None, spacing: float | None) -> Multipliers:
    """The mechanism's time basis, or what --basis and --spacing put in its place."""
    basis = basis or now.basis
    if basis == "free" and spacing is not None:
        raise IdentError(
            f"--spacing {spacing:g}: the basis is free, which has no knots; "
            "add --basis linear, cubic or quintic"
        )
    if spacing is None:
        spacing = 0.0 if basis == "free" else now.spacing
    return multipliers(basis, spacing, "--basis, --spacing")


def output_folder(out: Path | None) -> None:
    """Refuse --out before the long work, where nothing could be written into it."""
    if out is not None:
        check_writable(out)


def output_file(path: Path | None, suffixes: Sequence[str]) -> None:
    """Refuse a file to be written, before the long work, by its suffix and folder."""
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        raise IdentError(f"{path}: unknown suffix '{path.suffix}'; valid: {', '.join(suffixes)}")
    if path.is_dir():
        raise IdentError(f"{path}: is a folder; give the name of a file")
    if not path.parent.is_dir():
        raise IdentError(f"{path}: there is no folder {path.parent}; make it, or name another one")
    check_writable(path.parent)


def logs_of(paths: Sequence[Path], mechanism: Mechanism) -> list[Log]:
    """The logs under ident's names, those in folders among them."""
    return [read_log(path, mechanism.columns) for path in expanded(paths)]


def motion_of(
    mechanism: Mechanism,
    paths: Sequence[Path],
    cutoff: float | str | None,
    told: Told | None = None,
    torques: bool = True,
    smoothing: str = "auto",
) -> Motion:
    """The completed motion of some logs."""
    logs = logs_of(paths, mechanism)
    knots = knots_of(smoothing)
    return complete(mechanism, logs, cutoff=cutoff, torques=torques, smoothing=knots, progress=told)


def many(paths: Sequence[Path], jobs: int | None, scheduler: str | None) -> bool:
    """Whether logs are to be looked at one by one: of a folder, or on several processes.

    Raises:
        IdentError: if both processes and a scheduler are given.
    """
    if jobs is not None and scheduler is not None:
        raise IdentError(f"--jobs {jobs}: is of this machine, not of {scheduler}; give one of them")
    return not (jobs is scheduler is None) or any(map(is_folder_of_logs, paths))


def knots_of(text: str) -> str | None:
    """--smoothing as `complete` takes it."""
    return None if text.lower() == "none" else text


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
        raise IdentError(
            f"--cutoff {text}: is no frequency; valid: a number of Hz, auto or none"
        ) from None


def bound_of(text: str) -> tuple[str, tuple[float, float]]:
    """`rod.m=0.4:0.6` as a name and two values; one that is left out is no bound.

    Raises:
        IdentError: for anything else.
    """
    name, _, pair = text.partition("=")
    low, colon, high = pair.partition(":")
    try:
        if not name or not colon or not (low or high):
            raise ValueError
        return name, (float(low or "-inf"), float(high or "inf"))
    except ValueError:
        raise IdentError(
            f"--bound {text}: is no bound; write NAME=LOW:HIGH, such as rod.m=0.4:0.6, or one of "
            "the two, rod.m=0.4:"
        ) from None
