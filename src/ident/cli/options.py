"""Arguments and options that several commands share, and what they mean."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ident.errors import IdentError
from ident.files import check_writable

if TYPE_CHECKING:
    from ident.log import Log
    from ident.mechanism import Mechanism
    from ident.motion import Motion
    from ident.progress import Progress

LOGS = (".csv", ".parquet", ".npz")  # suffixes of logs that can be written
CHARTS = (".png", ".svg", ".pdf", ".html")  # suffixes of charts


def option(text: str, metavar: str | None = None, *names: str, **more: Any) -> Any:
    """Return an option with its help, the word for its value, and its names if not its own."""
    return typer.Option(*names, metavar=metavar, help=text, **more)


def argument(text: str, metavar: str, **more: Any) -> Any:
    """Return an argument with its help."""
    return typer.Argument(metavar=metavar, help=text, **more)


def kinds_beginning(incomplete: str) -> list[tuple[str, str]]:
    """Return kinds of effects for the Tab key. No joints: a colon separates words in bash."""
    from ident.effects import KINDS

    return [(kind, each.equation) for kind, each in KINDS.items() if kind.startswith(incomplete)]


def bases_beginning(incomplete: str) -> list[str]:
    """Return time bases for the Tab key."""
    from ident.mechanism.mechanism import DEGREES

    return [basis for basis in DEGREES if basis.startswith(incomplete)]


Texts = list[str] | None
Paths = list[Path] | None
MechanismPath = Annotated[
    Path,
    argument(
        "A folder with a mechanism.toml, such a file, or a .urdf, MuJoCo's .xml or an .sdf.",
        "MECHANISM",
    ),
]
LogPaths = Annotated[
    list[Path],
    argument(
        "Recorded experiments, one or several: .csv, .parquet, .npz, ROS 2 bag or .mcap; or "
        "folders of them.",
        "LOG",
    ),
]
With = Annotated[
    Texts,
    option(
        "Add an effect, as viscous:elbow, viscous for all driven joints, or one of your own, "
        "file.py:function:elbow.",
        "EFFECT", "--with", autocompletion=kinds_beginning,
    ),
]  # fmt: skip
AllowCode = Annotated[
    bool,
    option("Run the Python files that mechanism.toml or --with names.", None, "--allow-code"),
]
Cutoff = Annotated[str, option("Cut-off of the zero-phase filter: a number, auto or none.", "HZ")]
Smoothing = Annotated[
    str,
    option(
        "Knots of the smooth motion: their distance in seconds, auto, or none for the log's "
        "positions, velocities and accelerations as they are.",
        "S",
    ),
]
Basis = Annotated[
    str | None,
    option(
        "Time basis of the multipliers: free, linear, cubic or quintic.",
        "NAME",
        autocompletion=bases_beginning,
    ),
]
Spacing = Annotated[float | None, option("Distance of the basis' knots in seconds.", "S")]
Absolute = Annotated[bool, option("Work in absolute coordinates, six a body.", None, "--absolute")]
Out = Annotated[
    Path | None, option("Write fit, report and identified model into this folder.", "DIR")
]
Plot = Annotated[Path | None, option("Draw it into this .png, .svg, .pdf or .html.", "FILE")]
Seed = Annotated[int, option("Seed of the noise.", "N", min=0)]
Jobs = Annotated[int | None, option("Processes on this machine. Default: one a core.", "N")]
Scheduler = Annotated[
    str | None,
    option(
        "Address of a Dask scheduler, as tcp://host:8786: its workers do it, not this machine.",
        "ADDRESS",
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
    """Return the mechanism that the arguments describe."""
    from ident.mechanism import load, multipliers
    from ident.mechanism.absolute import absolute as in_absolute

    mechanism = load(path, allow_code=allow_code)
    for effect in effects or ():
        mechanism = with_effect(mechanism, effect, allow_code=allow_code)
    if basis is not None or spacing is not None:
        now = mechanism.multipliers
        basis = basis or now.basis
        if basis == "free" and spacing is not None:
            raise IdentError(
                f"--spacing {spacing:g}: the basis is free, which has no knots; "
                "add --basis linear, cubic or quintic"
            )
        if spacing is None:
            spacing = 0.0 if basis == "free" else now.spacing
        mechanism = replace(
            mechanism, multipliers=multipliers(basis, spacing, "--basis, --spacing")
        )
    return in_absolute(mechanism) if absolute else mechanism


def with_effect(mechanism: Mechanism, text: str, *, allow_code: bool) -> Mechanism:
    """Return the mechanism with an effect of the library, or with one of a Python file."""
    from ident.effects import parse_user, read_user_effect

    own = parse_user(text)
    if own is None:
        return mechanism.with_effect(text)
    file, name, joints = own
    return mechanism + read_user_effect(file, name, allow_code=allow_code)(joints)


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


def motion_of(
    mechanism: Mechanism,
    paths: Sequence[Path],
    cutoff: float | str | None,
    on_progress: Progress | None = None,
    torques: bool = True,
    smoothing: str = "auto",
) -> Motion:
    """Return the completed motion of some logs, those in folders among them."""
    from ident.log import read_log
    from ident.log.read import expanded
    from ident.motion import complete

    logs: list[Log] = [read_log(path, mechanism.columns) for path in expanded(paths)]
    return complete(
        mechanism, logs, cutoff=cutoff, torques=torques, smoothing=knots_of(smoothing),
        progress=on_progress,
    )  # fmt: skip


def many(paths: Sequence[Path], jobs: int | None, scheduler: str | None) -> bool:
    """Return whether logs are to be worked on one by one: a folder, or on several processes.

    Raises:
        IdentError: if both processes and a scheduler are given.
    """
    from ident.log.read import is_folder_of_logs

    if jobs is not None and scheduler is not None:
        raise IdentError(f"--jobs {jobs}: is of this machine, not of {scheduler}; give one of them")
    return not (jobs is scheduler is None) or any(map(is_folder_of_logs, paths))


def knots_of(text: str) -> str | None:
    """Return --smoothing as `complete` takes it."""
    return None if text.lower() == "none" else text


def cutoff_of(text: str) -> float | str | None:
    """Return `auto`, None for `none`, or a frequency [Hz].

    Raises:
        IdentError: for anything else.
    """
    if text in ("auto", "none"):
        return text if text == "auto" else None
    return number(text, "--cutoff", "is no frequency; valid: a number of Hz, auto or none")


def number(text: str, given: str, remedy: str) -> float:
    """Return a text as a number.

    Raises:
        IdentError: if it is none, with the option, what was given for it, and the remedy.
    """
    try:
        return float(text)
    except ValueError:
        raise IdentError(f"{given} {text}: {remedy}") from None


def named(text: str, given: str, example: str) -> tuple[str, float]:
    """Return NAME=NUMBER as a name and a finite number.

    Raises:
        IdentError: for anything else, with an example of what is valid.
    """
    name, _, value = text.rpartition("=")
    try:
        found = float(value)
        if not name.strip() or not math.isfinite(found):
            raise ValueError
    except ValueError:
        raise IdentError(f"{given} {text}: write NAME=NUMBER, as {example}") from None
    return name.strip(), found


def interval(
    text: str, given: str, remedy: str, *, ends: bool = False
) -> tuple[str, tuple[float, float]]:
    """Return NAME=LOW:HIGH as a name and two values.

    Args:
        text, given, remedy: of the option, for the error.
        ends: whether both values are needed; else one that is left out is infinite.

    Raises:
        IdentError: for anything else, with the remedy.
    """
    name, _, pair = text.partition("=")
    low, colon, high = pair.partition(":")
    try:
        if not name.strip() or not colon or not (low and high if ends else low or high):
            raise ValueError
        return name.strip(), (float(low or "-inf"), float(high or "inf"))
    except ValueError:
        raise IdentError(f"{given} {text}: {remedy}") from None
