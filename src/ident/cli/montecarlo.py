"""`montecarlo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ident.cli.arguments import (
    AllowCode,
    Jobs,
    MechanismPath,
    Scheduler,
    With,
    mechanism_of,
    output_folder,
)
from ident.cli.console import notes, progress, result
from ident.errors import IdentError
from ident.log.folder import is_folder_of_logs, logs_in
from ident.montecarlo import (
    Estimator,
    MonteCarlo,
    Studies,
    monte_carlo,
    monte_carlo_each,
    paper,
)
from ident.montecarlo.trial import USUAL


def montecarlo(
    mechanism: MechanismPath,
    log: Annotated[
        Path,
        typer.Argument(
            metavar="LOG", help="Without noise, best of a simulation; or a folder of such logs."
        ),
    ],
    snr: Annotated[
        str, typer.Option(metavar="LIST", help="Signal-to-noise ratios of every channel, in dB.")
    ] = "60,50,40,30",
    runs: Annotated[int, typer.Option(metavar="N", help="Draws of the noise at each.")] = 100,
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="paper, default, least-squares, likelihood or consistent; may be repeated. "
            "Default: paper and default.",
        ),
    ] = None,
    spacing: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="Of the paper's hats. Default: the mechanism's time basis, else 5 samples.",
        ),
    ] = None,
    truth: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="A true value, as rod.Ixx=0.004. Default: that of the log as it is.",
        ),
    ] = None,
    reactions: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG", help="The true multipliers. Default: those of the log as it is."
        ),
    ] = None,
    wrench: Annotated[
        bool, typer.Option("--wrench", help="Noise on external wrenches too.")
    ] = False,
    seed: Annotated[int, typer.Option(metavar="N", help="Of the noise.")] = 0,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    with_: With = None,
    allow_code: AllowCode = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write table, all runs, picture and report there."),
    ] = None,
) -> None:
    """What noise makes of the estimates: bias and spread.

    The same log is identified with ever new noise, which shows whether standard errors are honest.
    Estimators meet the same noise and stand side by side, the paper's method among them.
    """
    output_folder(out)
    model = mechanism_of(mechanism, with_, allow_code=allow_code)
    ratios, tried = _ratios(snr), _estimators(estimator or ["paper", "default"], spacing)
    known = dict(_value(text) for text in truth or ())
    channels = (*USUAL, "wrench") if wrench else USUAL
    found: MonteCarlo | Studies
    with progress() as told:
        if is_folder_of_logs(log):
            if reactions is not None:
                raise IdentError(f"--reactions {reactions}: are of one log, and {log} is a folder")
            found = monte_carlo_each(
                model, logs_in(log), snr=ratios, runs=runs, estimators=tried, truth=known,
                channels=channels, seed=seed, jobs=jobs, scheduler=scheduler, progress=told,
            )  # fmt: skip
            notes(found.notes)
        else:
            found = monte_carlo(
                model, log, snr=ratios, runs=runs, estimators=tried, truth=known,
                reactions=reactions, channels=channels, seed=seed, jobs=jobs, scheduler=scheduler,
                progress=told,
            )  # fmt: skip
    result(found)
    if out is not None:
        notes(f"wrote {path}" for path in found.write(out))
    for study in found.studies.values() if isinstance(found, Studies) else (found,):
        if study.samples.is_empty():
            raise IdentError(
                f"every run ended in an error, the first: {study.failures['error'][0]}"
            )


def _ratios(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise IdentError(f"--snr {text}: write numbers of dB with commas, as 60,40,30") from None


def _estimators(names: list[str], spacing: float | None) -> list[str | Estimator]:
    """By name, the paper's with its spacing."""
    if spacing is not None and "paper" not in names:
        raise IdentError(
            f"--spacing {spacing:g}: is of the paper's hats; add --estimator paper, or leave it out"
        )
    return [paper(spacing) if name == "paper" else name for name in names]


def _value(text: str) -> tuple[str, float]:
    name, equals, value = text.rpartition("=")
    try:
        if not equals or not name:
            raise ValueError
        return name.strip(), float(value)
    except ValueError:
        raise IdentError(f"--truth {text}: write NAME=NUMBER, as rod.Ixx=0.004") from None
