"""The verb `monte_carlo`: the same log with ever new noise, and what estimators make of it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.errors import FitError
from ident.log import Log, read_log
from ident.mechanism.mechanism import Mechanism
from ident.montecarlo.estimators import Estimator, Find, chosen
from ident.montecarlo.montecarlo import MonteCarlo
from ident.montecarlo.noise import USUAL, touched
from ident.montecarlo.pool import made
from ident.montecarlo.sample import Plan
from ident.montecarlo.truth import truth_of
from ident.progress import Told


def monte_carlo(
    mechanism: Mechanism,
    log: Log | str | os.PathLike[str],
    *,
    snr: float | Sequence[float] = (60, 50, 40, 30),
    runs: int = 100,
    estimators: Sequence[str | Estimator | Find] = ("paper", "default"),
    truth: Mapping[str, float] | None = None,
    reactions: Log | str | os.PathLike[str] | None = None,
    channels: Sequence[str] = USUAL,
    seed: int = 0,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Told | None = None,
) -> MonteCarlo:
    """Identifies the same log with ever new white noise (the paper's Figs. 4, 7, 8).

    Args:
        mechanism: with what is unknown.
        log: without noise, best of a simulation.
        snr: signal-to-noise ratios [dB] of every channel, power of the mean included.
        runs: draws of the noise at each.
        estimators: names (`ident.montecarlo.ESTIMATORS`), an `Estimator`, or functions
            (mechanism, log) -> Fit; all meet the same noise.
        truth: true values by name; others are those of the log as it is.
        reactions: a log of the true multipliers, columns named as they are; else those of the log
            as it is.
        channels: which get noise: `q`, `v`, `a`, `tau`, `wrench`.
        seed: of all noise; the same seed, the same runs, in whatever number of processes.
        jobs: processes; None: one a core; 1: this one alone.
        scheduler: address of a Dask scheduler whose workers make the runs, in place of processes.
        progress: called with (what is being done, share done).

    Returns:
        Every run's values, standard errors and errors of the multipliers, and their statistics.
        Runs that end in an error are kept, with it, in `failures`.

    Raises:
        FitError: for an SNR, a number or an estimator that is none, or an unknown truth.
        LogError: if the log cannot be read or has no channel that gets noise.
    """
    asked = Asked.of(snr, runs, estimators, seed, jobs)
    plan = planned(mechanism, log, asked, truth, reactions, channels)
    (outcomes,) = made([plan], asked.tasks, jobs, scheduler, progress)
    return MonteCarlo.of(plan, asked.ratios, asked.runs, outcomes)


@dataclass(frozen=True)
class Asked:
    """What is to be run, checked.

    Attributes:
        ratios: SNRs [dB], highest first; runs: at each; seed: of all noise.
        estimators: that are tried.
    """

    ratios: tuple[float, ...]
    runs: int
    seed: int
    estimators: tuple[Estimator, ...]

    @classmethod
    def of(
        cls,
        snr: float | Sequence[float],
        runs: int,
        estimators: Sequence[str | Estimator | Find],
        seed: int,
        jobs: int | None,
    ) -> Asked:
        """From what `monte_carlo` is given.

        Raises:
            FitError: as `monte_carlo` says.
        """
        if jobs is not None:
            _whole("jobs", jobs, 1)
        return cls(
            _ratios(snr), _whole("runs", runs, 1), _whole("seed", seed, 0), chosen(estimators)
        )

    @property
    def tasks(self) -> list[tuple[float, int]]:
        """(SNR [dB], run), all of them."""
        return [(ratio, run) for ratio in self.ratios for run in range(self.runs)]


def planned(
    mechanism: Mechanism,
    log: Log | str | os.PathLike[str],
    asked: Asked,
    truth: Mapping[str, float] | None,
    reactions: Log | str | os.PathLike[str] | None,
    channels: Sequence[str],
) -> Plan:
    """The plan of the runs of one log.

    Args:
        mechanism, log, truth, reactions, channels: as `monte_carlo` takes them.
        asked: what is to be run.

    Raises:
        FitError, LogError: as `monte_carlo` says.
    """
    log = log if isinstance(log, Log) else read_log(log, mechanism.columns)
    columns = tuple(touched(log, channels))
    if reactions is not None and not isinstance(reactions, Log):
        reactions = read_log(reactions)
    known = truth_of(mechanism, log, truth, reactions)
    return Plan(mechanism, log, asked.estimators, known, columns, asked.seed)


def _ratios(snr: float | Sequence[float]) -> tuple[float, ...]:
    """Signal-to-noise ratios, each once, quietest log first."""
    given = list(snr) if isinstance(snr, Sequence | np.ndarray) else [snr]
    found = []
    for each in given:
        try:
            value = float(each)
        except (TypeError, ValueError):
            value = np.nan
        if isinstance(snr, str) or not np.isfinite(value):
            shown = snr if isinstance(snr, str) else each
            raise FitError(f"SNR {shown!r}; valid: numbers of dB, as snr=(60, 40, 30)")
        found.append(value)
    if not found:
        raise FitError("no SNR given; valid: numbers of dB, as snr=(60, 40, 30)")
    return tuple(sorted(dict.fromkeys(found), reverse=True))


def _whole(what: str, number: object, least: int) -> int:
    if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < least:
        raise FitError(f"{what} {number!r}; valid: a whole number, {least} or more")
    return int(number)
