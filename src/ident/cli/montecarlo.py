"""`montecarlo`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ident.cli.console import notes, progress, result, wrote
from ident.cli.options import (
    AllowCode,
    Jobs,
    MechanismPath,
    Scheduler,
    Seed,
    Texts,
    With,
    argument,
    mechanism_of,
    named,
    option,
    output_folder,
)
from ident.errors import IdentError

if TYPE_CHECKING:
    from ident.montecarlo import Estimator, MonteCarlo, Studies


def montecarlo(
    mechanism: MechanismPath,
    log: Annotated[
        Path,
        argument("Without noise, best of a simulation; or a folder of such logs.", "LOG"),
    ],
    snr: Annotated[
        str, option("Signal-to-noise ratios of every channel, in dB.", "LIST")
    ] = "60,50,40,30",
    runs: Annotated[int, option("Draws of the noise at each.", "N")] = 100,
    estimator: Annotated[
        Texts,
        option(
            "paper, default, least-squares, likelihood or consistent; may be repeated. "
            "Default: paper and default.",
            "NAME",
        ),
    ] = None,
    spacing: Annotated[
        float | None,
        option("Of the paper's hats. Default: the mechanism's time basis, else 5 samples.", "S"),
    ] = None,
    truth: Annotated[
        Texts,
        option("A true value, as rod.Ixx=0.004. Default: that of the log as it is.", "NAME=VALUE"),
    ] = None,
    reactions: Annotated[
        Path | None,
        option("The true multipliers. Default: those of the log as it is.", "LOG"),
    ] = None,
    wrench: Annotated[bool, option("Noise on external wrenches too.", None, "--wrench")] = False,
    seed: Seed = 0,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    with_: With = None,
    allow_code: AllowCode = False,
    out: Annotated[
        Path | None,
        option("Write table, all runs, picture and report there.", "DIR"),
    ] = None,
) -> None:
    """What noise makes of the estimates: bias and spread.

    The same log is identified with ever new noise, which shows whether standard errors are honest.
    Estimators meet the same noise and stand side by side, the paper's method among them.
    """
    from ident.log.read import is_folder_of_logs, logs_in
    from ident.montecarlo import Studies, monte_carlo, monte_carlo_each
    from ident.montecarlo.trial import USUAL

    output_folder(out)
    model = mechanism_of(mechanism, with_, allow_code=allow_code)
    ratios, tried = _ratios(snr), _estimators(estimator or ["paper", "default"], spacing)
    known = dict(named(text, "--truth", "rod.Ixx=0.004") for text in truth or ())
    channels = (*USUAL, "wrench") if wrench else USUAL
    found: MonteCarlo | Studies
    with progress() as on_progress:
        if is_folder_of_logs(log):
            if reactions is not None:
                raise IdentError(f"--reactions {reactions}: are of one log, and {log} is a folder")
            found = monte_carlo_each(
                model, logs_in(log), snr=ratios, runs=runs, estimators=tried, truth=known,
                channels=channels, seed=seed, jobs=jobs, scheduler=scheduler, progress=on_progress,
            )  # fmt: skip
            notes(found.notes)
        else:
            found = monte_carlo(
                model, log, snr=ratios, runs=runs, estimators=tried, truth=known,
                reactions=reactions, channels=channels, seed=seed, jobs=jobs, scheduler=scheduler,
                progress=on_progress,
            )  # fmt: skip
    result(found)
    if out is not None:
        wrote(found.write(out))
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
    """Return estimators by name, the paper's with its spacing."""
    from ident.montecarlo import paper

    if spacing is not None and "paper" not in names:
        raise IdentError(
            f"--spacing {spacing:g}: is of the paper's hats; add --estimator paper, or leave it out"
        )
    return [paper(spacing) if name == "paper" else name for name in names]
