"""The verb `monte_carlo_each`: a study of each of many logs, all runs in one pool."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import polars as pl
from markupsafe import Markup

from ident.errors import FitError
from ident.files import write_all
from ident.log.folder import names_of
from ident.mechanism.mechanism import Mechanism
from ident.montecarlo.estimators import Estimator, Find
from ident.montecarlo.montecarlo import MonteCarlo
from ident.montecarlo.noise import USUAL
from ident.montecarlo.pool import made
from ident.montecarlo.report import study_files
from ident.montecarlo.run import Asked, planned
from ident.montecarlo.sample import Plan
from ident.pool import spread
from ident.progress import Told
from ident.show.html import Shown, items

Settings = tuple[Mechanism, Asked, Mapping[str, float] | None, Sequence[str]]


@dataclass(frozen=True, eq=False)
class Studies(Shown):
    """Made by `ident.monte_carlo_each`.

    Attributes:
        studies: of every log, by its name.
        left_out: by name of a log, why it has none.
    """

    studies: Mapping[str, MonteCarlo]
    left_out: Mapping[str, str]

    @cached_property
    def table(self) -> pl.DataFrame:
        """`MonteCarlo.table` of all logs, one below the other, with a column `log`."""
        return pl.concat(
            x.table.select(pl.lit(log).alias("log"), pl.all()) for log, x in self.studies.items()
        )

    def write(self, folder: str | Path) -> list[Path]:
        """What `MonteCarlo.write` writes, in a folder for each log, and logs.csv, the table.

        Args:
            folder: made where there is none.

        Returns:
            The files written, all of them or none.

        Raises:
            IdentError: if the folder cannot be written.
        """
        files = {"logs.csv": self.table.write_csv().encode()}
        for log, x in self.studies.items():
            files |= {f"{log}/{name}": content for name, content in study_files(x).items()}
        return write_all(Path(folder), files)

    @property
    def notes(self) -> tuple[str, ...]:
        """Which logs were left out, and why."""
        return tuple(f"{log}: left out: {why}" for log, why in self.left_out.items())

    def __str__(self) -> str:
        return "\n\n".join(str(x) for x in self.studies.values())

    __repr__ = __str__

    def _blocks(self) -> tuple[Markup, ...]:
        blocks = [block for x in self.studies.values() for block in x._blocks()]
        return (*blocks, *((items(self.notes),) if self.left_out else ()))


def monte_carlo_each(
    mechanism: Mechanism,
    logs: Sequence[str | os.PathLike[str]],
    *,
    snr: float | Sequence[float] = (60, 50, 40, 30),
    runs: int = 100,
    estimators: Sequence[str | Estimator | Find] = ("paper", "default"),
    truth: Mapping[str, float] | None = None,
    channels: Sequence[str] = USUAL,
    seed: int = 0,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Told | None = None,
) -> Studies:
    """The study that `monte_carlo` makes, of each of many logs; a broken log is left out.

    Args:
        mechanism: with what is unknown.
        logs: their paths.
        snr, runs, estimators, channels, seed, jobs, scheduler: as `monte_carlo` takes them.
        truth: true values by name, of all logs; others are those of each log as it is.
        progress: called with (what is being done, share done).

    Returns:
        One study a log.

    Raises:
        FitError: for an SNR, a number or an estimator that is none, or if no log can be used.
    """
    asked = Asked.of(snr, runs, estimators, seed, jobs)
    paths = [Path(log).absolute() if scheduler else Path(log) for log in logs]
    names = names_of(paths)
    settings = mechanism, asked, truth, tuple(channels)
    plans: dict[int, Plan] = {}
    broken: dict[int, str] = {}
    with closing(spread(_planned, paths, common=settings, jobs=jobs, scheduler=scheduler)) as ended:
        for done in ended:
            if done.error is not None:
                broken[done.index] = done.error
            else:  # one mechanism for all, so that its functions are compiled once a process
                plans[done.index] = replace(done.value, mechanism=mechanism)
            if progress:
                progress("truth of each log", (len(plans) + len(broken)) / len(paths))
    left_out = {names[i]: broken[i] for i in sorted(broken)}
    if not plans:
        said = "; ".join(f"{log}: {why}" for log, why in list(left_out.items())[:1])
        raise FitError(f"none of {len(paths)} logs can be used: {said or 'none was given'}")
    order = sorted(plans)
    found = made([plans[i] for i in order], asked.tasks, jobs, scheduler, progress)
    studies = {
        names[i]: MonteCarlo.of(plans[i], asked.ratios, asked.runs, outcomes)
        for i, outcomes in zip(order, found, strict=True)
    }
    return Studies(studies, left_out)


def _planned(settings: Settings, path: Path) -> Plan:
    mechanism, asked, truth, channels = settings
    return planned(mechanism, path, asked, truth, None, channels)
