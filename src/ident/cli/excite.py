"""`excite`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from ident.cli.console import progress, result, wrote
from ident.cli.options import (
    CHARTS,
    LOGS,
    AllowCode,
    MechanismPath,
    Plot,
    Texts,
    With,
    interval,
    mechanism_of,
    named,
    number,
    option,
    output_file,
)
from ident.errors import IdentError

BOUND = "VALUE|JOINT=VALUE"


def excite(
    mechanism: MechanismPath,
    with_: With = None,
    separate: Annotated[
        tuple[str, str] | None,
        option("Tell these two best apart, as coulomb:crank coulomb:rocker.", "EFFECT EFFECT"),
    ] = None,
    duration: Annotated[float, option("Length of the whole log.", "S")] = 30.0,
    periods: Annotated[int, option("How often the motion is repeated.", "N")] = 3,
    rate: Annotated[float, option("Samples a second.", "HZ")] = 100.0,
    harmonics: Annotated[int, option("Harmonics of the Fourier series.", "N")] = 5,
    range_: Annotated[
        Texts, option("Range in place of the URDF's.", "JOINT=LOWER:UPPER", "--range")
    ] = None,
    speed: Annotated[Texts, option("Largest speed of all drives or of one joint.", BOUND)] = None,
    acceleration: Annotated[
        Texts, option("Largest acceleration; a URDF has no such limit.", BOUND)
    ] = None,
    torque: Annotated[Texts, option("Largest torque of a drive.", BOUND)] = None,
    reserve: Annotated[
        str, option("Share of the torque left to what is not modelled.", "SHARE")
    ] = "20%",
    singular: Annotated[
        float, option("Times its value at the start that ‖K⁺‖ may reach.", "X")
    ] = 3.0,
    noise: Annotated[
        Texts, option("Expected noise of a torque. Default: 1 % of its limit.", "JOINT=VALUE")
    ] = None,
    balance: Annotated[float, option("Weight of the condition number beside log det.", "W")] = 0.5,
    tries: Annotated[int, option("Searches; the best one counts.", "N")] = 4,
    seed: Annotated[int, option("Seed of the searches.", "N", min=0)] = 0,
    allow_code: AllowCode = False,
    plot: Plot = None,
    out: Annotated[
        Path | None, option("Write the motion, a .csv, .parquet or .npz.", "FILE")
    ] = None,
) -> None:
    """A periodic motion that tells most, inside all limits.

    What it uses of the limits, and the standard errors to be expected of a log of it.
    """
    from ident.excite import Limits
    from ident.excite import excite as excite_

    model = mechanism_of(mechanism, with_, allow_code=allow_code)
    output_file(out, LOGS)
    output_file(plot, CHARTS)
    remedy = "write JOINT=LOWER:UPPER, as elbow=-1:1.5"
    limits = Limits(
        range=dict(interval(text, "--range", remedy, ends=True) for text in range_ or ()),
        speed=_limit("--speed", speed),
        acceleration=_limit("--acceleration", acceleration),
        torque=_limit("--torque", torque),
        reserve=number(reserve.removesuffix("%"), "--reserve", "write a share, as 20% or 0.2")
        / (100 if reserve.endswith("%") else 1),
        singular=singular,
    )
    with progress() as on_progress:
        found = excite_(
            model, duration=duration, periods=periods, rate=rate, harmonics=harmonics,
            limits=limits, separate=separate,
            noise=dict(named(text, "--noise", "elbow=1.5") for text in noise or ()),
            balance=balance, tries=tries, seed=seed, progress=on_progress,
        )  # fmt: skip
    result(found)
    if out is not None:
        found.write(out)
        wrote([out])
    if plot is not None:
        found.plot().save(plot)
        wrote([plot])


def _limit(given: str, texts: Texts) -> float | dict[str, float] | None:
    """Return one number for all drives, or numbers by joint."""
    bare = [text for text in texts or () if "=" not in text]
    if not texts:
        return None
    if bare and len(texts) > 1:
        raise IdentError(
            f"{given} {' '.join(texts)}: give one number for all drives, or JOINT=NUMBER for each"
        )
    if bare:
        return number(bare[0], given, "is no number; write 1.5 or elbow=1.5")
    return dict(named(text, given, "elbow=1.5") for text in texts)
