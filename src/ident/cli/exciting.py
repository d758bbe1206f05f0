"""`excite`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from ident.cli.arguments import AllowCode, MechanismPath, With, mechanism_of, output_file
from ident.cli.console import notes, progress, result
from ident.errors import IdentError
from ident.excite import Limits
from ident.excite import excite as excite_
from ident.show.charts import SUFFIXES

LOGS = (".csv", ".parquet", ".npz")
BOUND = "VALUE|JOINT=VALUE"


def excite(
    mechanism: MechanismPath,
    with_: With = None,
    separate: Annotated[
        tuple[str, str] | None,
        typer.Option(
            metavar="EFFECT EFFECT",
            help="Tell these two best apart, as coulomb:crank coulomb:rocker.",
        ),
    ] = None,
    duration: Annotated[float, typer.Option(metavar="S", help="Of the whole log.")] = 30.0,
    periods: Annotated[int, typer.Option(metavar="N", help="That the motion is repeated.")] = 3,
    rate: Annotated[float, typer.Option(metavar="HZ", help="Samples a second.")] = 100.0,
    harmonics: Annotated[int, typer.Option(metavar="N", help="Of the Fourier series.")] = 5,
    range_: Annotated[
        list[str] | None,
        typer.Option("--range", metavar="JOINT=LOWER:UPPER", help="In place of the URDF's."),
    ] = None,
    speed: Annotated[
        list[str] | None,
        typer.Option(metavar=BOUND, help="At most, of all drives or of one joint."),
    ] = None,
    acceleration: Annotated[
        list[str] | None,
        typer.Option(metavar=BOUND, help="The same; a URDF has no such limit."),
    ] = None,
    torque: Annotated[
        list[str] | None, typer.Option(metavar=BOUND, help="The same; of a drive.")
    ] = None,
    reserve: Annotated[
        str, typer.Option(metavar="SHARE", help="Of the torque, left to what is not modelled.")
    ] = "20%",
    singular: Annotated[
        float,
        typer.Option(metavar="X", help="Times its value at the start that ‖K⁺‖ may reach."),
    ] = 3.0,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=VALUE", help="Expected of a torque. Default: 1 % of its limit."
        ),
    ] = None,
    balance: Annotated[
        float,
        typer.Option(metavar="W", help="Weight of the condition number beside log det."),
    ] = 0.5,
    tries: Annotated[int, typer.Option(metavar="N", help="Searches; the best one counts.")] = 4,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of the searches.")] = 0,
    allow_code: AllowCode = False,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw it into this .png, .svg, .pdf or .html."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the motion, a .csv, .parquet or .npz."),
    ] = None,
) -> None:
    """A periodic motion that tells most, inside all limits.

    What it uses of the limits, and the standard errors to be expected of a log of it.
    """
    model = mechanism_of(mechanism, with_, allow_code=allow_code)
    output_file(out, LOGS)
    output_file(plot, SUFFIXES)
    limits = Limits(
        range=dict(_range(text) for text in range_ or ()),
        speed=_limit("--speed", speed),
        acceleration=_limit("--acceleration", acceleration),
        torque=_limit("--torque", torque),
        reserve=_share(reserve),
        singular=singular,
    )
    with progress() as told:
        found = excite_(
            model, duration=duration, periods=periods, rate=rate, harmonics=harmonics,
            limits=limits, separate=separate, noise=dict(_named("--noise", noise)), balance=balance,
            tries=tries,
            seed=seed, progress=told,
        )  # fmt: skip
    result(found)
    if out is not None:
        found.write(out)
        notes([f"wrote {out}"])
    if plot is not None:
        found.plot().save(plot)
        notes([f"wrote {plot}"])


def _limit(option: str, given: Sequence[str] | None) -> float | dict[str, float] | None:
    """One number for all drives, or numbers by joint."""
    texts = list(given or ())
    bare = [text for text in texts if "=" not in text]
    if not texts:
        return None
    if bare and len(texts) > 1:
        raise IdentError(
            f"{option} {' '.join(texts)}: give one number for all drives, or JOINT=NUMBER for each"
        )
    return _number(option, bare[0]) if bare else dict(_named(option, texts))


def _named(option: str, texts: Sequence[str] | None) -> list[tuple[str, float]]:
    found = []
    for text in texts or ():
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise IdentError(f"{option} {text}: write JOINT=NUMBER, as elbow=1.5")
        found.append((name.strip(), _number(option, value)))
    return found


def _number(option: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise IdentError(f"{option} {text}: is no number; write 1.5 or elbow=1.5") from None


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, _, pair = text.partition("=")
    low, _, high = pair.partition(":")
    try:
        return name.strip(), (float(low), float(high))
    except ValueError:
        raise IdentError(f"--range {text}: write JOINT=LOWER:UPPER, as elbow=-1:1.5") from None


def _share(text: str) -> float:
    try:
        return float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
    except ValueError:
        raise IdentError(f"--reserve {text}: write a share, as 20% or 0.2") from None
