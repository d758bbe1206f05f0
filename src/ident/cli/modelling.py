"""`add`, `effects` and `simulate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ident.cli.arguments import (
    AllowCode,
    MechanismPath,
    With,
    grown,
    mechanism_of,
    output_file,
)
from ident.cli.console import notes, result
from ident.effects import KINDS
from ident.effects.describe import described, kind_called
from ident.errors import IdentError
from ident.fit.saved import read_fit
from ident.log import Log, read_log
from ident.mechanism.write import add_effects
from ident.simulate import Noise
from ident.simulate import simulate as simulate_
from ident.simulate.write import csv_text

LOGS = (".csv", ".parquet", ".npz")


def add(
    mechanism: MechanismPath,
    effect: Annotated[
        str,
        typer.Argument(
            metavar="EFFECT",
            help="As viscous:elbow, viscous for all driven joints, or file.py:function:elbow.",
        ),
    ],
    allow_code: AllowCode = False,
) -> None:
    """Write an effect into mechanism.toml.

    A bare URDF gets a mechanism.toml beside it.
    """
    before = mechanism_of(mechanism, allow_code=allow_code)
    after = grown(before, effect, allow_code=allow_code)
    new = [each for each in after.effects if each not in before.effects]
    path = add_effects(before, new)
    result(f"{path}: added {', '.join(each.label for each in new)}")


def effects(
    kind: Annotated[
        str | None, typer.Argument(metavar="KIND", help="One of them, as viscous; else all.")
    ] = None,
) -> None:
    """The library of effects.

    Equation, unknowns and shapes with units, where an effect sits, and what a residual looks like
    when it is missing.
    """
    kinds = KINDS.values() if kind is None else [kind_called(kind)]
    result("\n\n".join(described(each) for each in kinds))


def simulate(
    mechanism: MechanismPath,
    motion: Annotated[
        Path, typer.Argument(metavar="MOTION", help="A log whose positions are the motion.")
    ],
    fit: Annotated[
        Path | None, typer.Option(metavar="FIT.json", help="Parameters and effects of a fit.")
    ] = None,
    with_: With = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Give a parameter its value: rod.Izz=0.2, viscous.elbow.Fv=0.4.",
        ),
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CHANNEL=LEVEL",
            help="White noise, its standard deviation: q=1e-5 in SI units, tau=2% of the column's.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of the noise.")] = 0,
    columns: Annotated[
        str, typer.Option(metavar="LIST", help="Which channels the log gets.")
    ] = "q,v,a,tau",
    joints: Annotated[
        str | None,
        typer.Option(metavar="LIST", help="Whose q, v and a it gets. Default: those in MOTION."),
    ] = None,
    multipliers: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write the true multipliers here, a .csv, .parquet or .npz."
        ),
    ] = None,
    allow_code: AllowCode = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write a .csv, .parquet or .npz; else CSV to the screen."
        ),
    ] = None,
) -> None:
    """A log of the model itself, on a given motion.

    The torques that the motion needs, exactly; then noise.
    """
    model = mechanism_of(mechanism, with_, allow_code=allow_code)
    output_file(out, LOGS)
    output_file(multipliers, LOGS)
    values = dict(_assignment(text) for text in set_ or ())
    pi: np.ndarray | None = None
    if fit is not None:
        saved = read_fit(fit, model)
        model, pi = saved.mechanism, saved.dynamic_parameters
        values = {**saved.point.values, **values}
    log, prediction = simulate_(
        model,
        read_log(motion, model.columns),
        values=values,
        pi=pi,
        noise=[_noise(text) for text in noise or ()],
        seed=seed,
        columns=[part.strip() for part in columns.split(",")],
        joints=None if joints is None else [part.strip() for part in joints.split(",")],
    )
    notes(log.repairs)
    if out is None:
        result(csv_text(log).rstrip("\n"))
    else:
        log.write(out)
        notes([f"wrote {out}"])
    if multipliers is not None:
        names = model.kinematics.multipliers
        series = {name: prediction.multipliers[:, i] for i, name in enumerate(names)}
        Log.from_arrays(multipliers.name, prediction.t, series).write(multipliers)
        notes([f"wrote {multipliers}"])


def _assignment(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    try:
        if not equals or not name:
            raise ValueError
        number = float(value)
        if not math.isfinite(number):
            raise ValueError
        return name.strip(), number
    except ValueError:
        raise IdentError(f"--set {text}: write NAME=NUMBER, as viscous.elbow.Fv=0.4") from None


def _noise(text: str) -> Noise:
    channel, equals, level = text.partition("=")
    try:
        if not equals or not channel:
            raise ValueError
        value = float(level.removesuffix("%"))
        if not 0 <= value < math.inf:
            raise ValueError
    except ValueError:
        raise IdentError(f"--noise {text}: write CHANNEL=LEVEL, as tau=2% or q=1e-5") from None
    relative = level.endswith("%")
    return Noise(channel.strip(), value / 100 if relative else value, relative)
