"""The verbs `monte_carlo` and `monte_carlo_each`: all runs of one log, or of many, in one pool."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from ident.errors import FitError, IdentError
from ident.log import Log, read_log
from ident.log.read import names_of
from ident.mechanism.mechanism import Mechanism
from ident.montecarlo.estimators import Estimate, Estimator, estimators_of
from ident.montecarlo.montecarlo import MonteCarlo, Studies
from ident.montecarlo.trial import USUAL, TrialOutcome, TrialPlan, noisy_columns, truth_of
from ident.pool import spread
from ident.progress import Progress

AnyLog = Log | str | os.PathLike[str]


def monte_carlo(
    mechanism: Mechanism,
    log: AnyLog,
    *,
    snr: float | Sequence[float] = (60, 50, 40, 30),
    runs: int = 100,
    estimators: Sequence[str | Estimator | Estimate] = ("paper", "default"),
    truth: Mapping[str, float] | None = None,
    reactions: AnyLog | None = None,
    channels: Sequence[str] = USUAL,
    seed: int = 0,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> MonteCarlo:
    """Identify the same log with ever new white noise (the paper's Figs. 4, 7, 8).

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
    tasks, applied = _checked(snr, runs, estimators, seed, jobs)
    plan = _plan((mechanism, applied, truth, reactions, channels, int(seed)), log)
    (study,) = _studies([plan], tasks, jobs, scheduler, progress)
    return study


def monte_carlo_each(
    mechanism: Mechanism,
    logs: Sequence[str | os.PathLike[str]],
    *,
    snr: float | Sequence[float] = (60, 50, 40, 30),
    runs: int = 100,
    estimators: Sequence[str | Estimator | Estimate] = ("paper", "default"),
    truth: Mapping[str, float] | None = None,
    channels: Sequence[str] = USUAL,
    seed: int = 0,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Studies:
    """Make the study of `monte_carlo` for each of many logs; a broken log is left out.

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
    tasks, applied = _checked(snr, runs, estimators, seed, jobs)
    paths = [Path(log).absolute() if scheduler else Path(log) for log in logs]
    names = names_of(paths)
    common = mechanism, applied, truth, None, tuple(channels), int(seed)
    plans: dict[int, TrialPlan] = {}
    broken: dict[int, str] = {}
    with closing(spread(_plan, paths, common=common, jobs=jobs, scheduler=scheduler)) as ended:
        for done in ended:
            if done.error is not None:
                broken[done.index] = done.error
            else:  # one mechanism for all, so that its functions are compiled once a process
                plans[done.index] = replace(done.value, mechanism=mechanism)
            if progress:
                progress("truth of each log", (len(plans) + len(broken)) / len(paths))
    left_out = {names[i]: broken[i] for i in sorted(broken)}
    if not plans:
        first = "; ".join(f"{log}: {why}" for log, why in list(left_out.items())[:1])
        raise FitError(f"none of {len(paths)} logs can be used: {first or 'none was given'}")
    order = sorted(plans)
    studies = _studies([plans[i] for i in order], tasks, jobs, scheduler, progress)
    return Studies({names[i]: each for i, each in zip(order, studies, strict=True)}, left_out)


def _checked(
    snr: float | Sequence[float],
    runs: int,
    estimators: Sequence[str | Estimator | Estimate],
    seed: int,
    jobs: int | None,
) -> tuple[list[tuple[float, int]], tuple[Estimator, ...]]:
    """Return all pairs (SNR [dB], run) and the estimators; refuse an argument that is not valid."""
    for name, number, least in (("jobs", jobs, 1), ("runs", runs, 1), ("seed", seed, 0)):
        whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
        if (name, number) != ("jobs", None) and (not whole or number < least):  # type: ignore[operator]
            raise FitError(f"{name} {number!r}; valid: a whole number, {least} or more")
    return [(ratio, run) for ratio in _ratios(snr) for run in range(runs)], estimators_of(
        estimators
    )


def _plan(common: tuple[Any, ...], log: AnyLog) -> TrialPlan:
    """Read a log and identify its truth."""
    mechanism, estimators, truth, reactions, channels, seed = common
    log = log if isinstance(log, Log) else read_log(log, mechanism.columns)
    columns = noisy_columns(log, channels)
    if reactions is not None and not isinstance(reactions, Log):
        reactions = read_log(reactions)
    known = truth_of(mechanism, log, truth, reactions)
    return TrialPlan(mechanism, log, estimators, known, columns, seed)


def _ratios(snr: float | Sequence[float]) -> tuple[float, ...]:
    """Return signal-to-noise ratios, each once, highest first."""
    valid = "valid: numbers of dB, as snr=(60, 40, 30)"
    if isinstance(snr, str):
        raise FitError(f"SNR {snr!r}; {valid}")
    ratios = []
    for each in snr if isinstance(snr, Sequence | np.ndarray) else [snr]:
        try:
            ratios.append(float(each))
        except (TypeError, ValueError):
            ratios.append(np.nan)
        if not np.isfinite(ratios[-1]):
            raise FitError(f"SNR {each!r}; {valid}")
    if not ratios:
        raise FitError(f"no SNR given; {valid}")
    return tuple(sorted(dict.fromkeys(ratios), reverse=True))


def _studies(
    plans: Sequence[TrialPlan],
    runs: Sequence[tuple[float, int]],
    jobs: int | None,
    scheduler: str | None,
    progress: Progress | None,
) -> list[MonteCarlo]:
    """Make the runs (SNR [dB], number) of all plans in one pool."""
    tasks = [(number, snr, run) for number in range(len(plans)) for snr, run in runs]
    outcomes: list[list[TrialOutcome]] = [[] for _ in tasks]
    pool = spread(_trial, tasks, common=tuple(plans), jobs=jobs, scheduler=scheduler)
    with closing(pool) as ended:
        for count, done in enumerate(ended, start=1):
            if done.error is not None:
                number, snr, run = tasks[done.index]
                raise IdentError(f"{plans[number].log.name}: run {run} at {snr:g} dB: {done.error}")
            outcomes[done.index] = done.value
            if progress:
                progress(f"run {count} of {len(tasks)}", count / len(tasks))
    each, ratios = len(runs), tuple(dict.fromkeys(snr for snr, _ in runs))
    return [
        MonteCarlo.of(
            plan, ratios, each // len(ratios), [*chain(*outcomes[i * each : (i + 1) * each])]
        )
        for i, plan in enumerate(plans)
    ]


def _trial(plans: Sequence[TrialPlan], task: tuple[int, float, int]) -> list[TrialOutcome]:
    number, snr, run = task
    return list(plans[number].outcomes(snr, run))
