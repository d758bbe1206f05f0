"""Monte Carlo studies: how noise of a log changes parameters, estimator beside estimator."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import polars as pl

from ident.display import Displayed, Progress, render
from ident.errors import FitError, check_whole, one_of
from ident.files import Written
from ident.fit import Fit
from ident.log import Log, read_log
from ident.mechanism.mechanism import Mechanism
from ident.montecarlo.trial import (
    ESTIMATORS,
    SUMS,
    USUAL,
    Estimate,
    Estimator,
    TrialPlan,
    TrialRows,
    estimators_of,
    noisy_columns,
    paper,
    rms_of,
    truth_of,
)
from ident.pool import Workers

__all__ = ["ESTIMATORS", "Estimator", "MonteCarlo", "monte_carlo", "paper"]

Z95 = 1.96  # standard errors: the central 95 % of a normal distribution
RUN = {"estimator": pl.String, "snr": pl.Float64, "run": pl.Int64}
PARAMETER = {"parameter": pl.String, "value": pl.Float64, "stderr": pl.Float64,
             "truth": pl.Float64, "unit": pl.String}  # fmt: skip
MULTIPLIER = {"multiplier": pl.String, "rms": pl.Float64, "unit": pl.String}
AnyLog = Log | str | os.PathLike[str]


@dataclass(frozen=True, eq=False, repr=False)
class MonteCarlo(Displayed, Written):
    """Identifications of one log with ever new noise. Made by `ident.monte_carlo`.

    Attributes:
        plan: mechanism, log, estimators, truth and seed of all runs.
        snr: signal-to-noise ratios [dB], highest first; runs: draws of the noise at each.
        samples: one row an estimator, SNR, run and parameter: `value`, `stderr`, null where that
            run does not determine it, with `truth` and `unit`.
        errors: one row an estimator, SNR, run and multiplier: `rms` error over time, 2 % at either
            end left out, and `unit`; `force` and `moment` are the root sum of squares over all
            multipliers of that unit.
        failures: one row a run that ended in an error: estimator, SNR, run, `error`.
    """

    plan: TrialPlan
    snr: tuple[float, ...]
    runs: int
    samples: pl.DataFrame
    errors: pl.DataFrame
    failures: pl.DataFrame

    @cached_property
    def table(self) -> pl.DataFrame:
        """Statistics by estimator, SNR and parameter.

        Columns: `runs` that determine it, `mean`, `bias` (mean − truth), `bias_stderr` (of it,
        std / √runs), `std`, `rms` (of value − truth), `stderr` (mean of those that the fits claim),
        `coverage` (share of runs whose value ± 1.96 stderr holds the truth), `truth`, `unit`.
        """
        value, truth, stderr = pl.col("value"), pl.col("truth"), pl.col("stderr")
        off = value - truth
        return self.samples.group_by("estimator", "snr", "parameter", maintain_order=True).agg(
            value.count().alias("runs"),
            value.mean().alias("mean"),
            off.mean().alias("bias"),
            (value.std() / value.count().sqrt()).alias("bias_stderr"),
            value.std().alias("std"),
            (off**2).mean().sqrt().alias("rms"),
            stderr.mean().alias("stderr"),
            (off.abs() <= Z95 * stderr).mean().alias("coverage"),
            truth.first(),
            pl.col("unit").first(),
        )

    @cached_property
    def multipliers(self) -> pl.DataFrame:
        """Statistics by estimator, SNR and multiplier.

        Columns: `runs`, `mean` and `std` of the rms errors, `size` (rms of the true one), `unit`.
        """
        truth, rms = self.plan.truth, pl.col("rms")
        sizes = dict(zip(truth.multipliers, rms_of(truth.reactions), strict=True))
        units = dict(zip(truth.multipliers, truth.multiplier_units, strict=True))
        sums = {
            total: float(np.sqrt(np.nansum([sizes[n] ** 2 for n in units if units[n] == unit])))
            for total, unit in SUMS.items()
        }
        size = pl.col("multiplier").replace_strict(sizes | sums, return_dtype=pl.Float64)
        return (
            self.errors.group_by("estimator", "snr", "multiplier", maintain_order=True)
            .agg(
                rms.count().alias("runs"),
                rms.mean().alias("mean"),
                rms.std().alias("std"),
                pl.col("unit").first(),
            )
            .with_columns(size.alias("size"))
            .filter(pl.col("runs") > 0)
        )

    @property
    def estimators(self) -> tuple[str, ...]:
        """Names."""
        return tuple(each.name for each in self.plan.estimators)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names."""
        return tuple(self.plan.truth.values)

    @property
    def notes(self) -> tuple[str, ...]:
        """Runs that failed or did not determine a parameter."""
        key, notes, failed = ("estimator", "snr"), [], {}
        for own, frame in self.failures.group_by(*key, maintain_order=True):
            failed[own] = frame.height
            notes.append(
                f"{own[0]} at {own[1]:g} dB: {frame.height} of {self.runs} runs failed; the first: "
                f"{frame['error'][0]}"
            )
        for r in self.table.iter_rows(named=True):
            less = self.runs - failed.get((r["estimator"], r["snr"]), 0) - r["runs"]
            if less > 0:
                notes.append(
                    f"{r['estimator']} at {r['snr']:g} dB: {less} of {self.runs} runs do not "
                    f"determine {r['parameter']}"
                )
        return tuple(notes)

    def fit(self, estimator: str, snr: float, run: int) -> Fit:
        """Repeat one run and return its fit.

        Args:
            estimator: its name.
            snr: one of `snr` [dB].
            run: its number, from 0.

        Raises:
            FitError: for an unknown estimator, SNR or run; else the error in which that run ended.
        """
        self._check(estimator, snr)
        if not 0 <= run < self.runs:
            raise FitError(f"run {run}; valid: 0 to {self.runs - 1}")
        find = {each.name: each.find for each in self.plan.estimators}[estimator]
        return find(self.plan.mechanism, self.plan.log_of(snr, run))

    def typical(self, estimator: str, snr: float) -> int:
        """Return the run whose rms error of the multipliers is closest to the average (Figs. 5, 9).

        Without multipliers it is the run whose parameters are off as much as on average.

        Args:
            estimator: its name.
            snr: one of `snr` [dB].

        Raises:
            FitError: for an unknown estimator or SNR, or if all runs failed.
        """
        self._check(estimator, snr)
        same = (pl.col("estimator") == estimator) & (pl.col("snr") == snr)
        off = self.errors.filter(same & pl.col("multiplier").is_in(list(SUMS))).drop_nulls("rms")
        square = pl.col("rms") ** 2
        if off.is_empty():
            off = self.samples.filter(same & (pl.col("truth") != 0)).drop_nulls("value")
            square = (pl.col("value") / pl.col("truth") - 1) ** 2
        if off.is_empty():
            raise FitError(f"'{estimator}' at {snr:g} dB: every run failed, none is typical")
        by_run = off.group_by("run", maintain_order=True).agg(square.sum().sqrt().alias("size"))
        nearest = int(np.abs(by_run["size"].to_numpy() - by_run["size"].mean()).argmin())
        return int(by_run["run"][nearest])

    def _check(self, estimator: str, snr: float) -> None:
        if estimator not in self.estimators:
            raise FitError(f"estimator '{estimator}'; {one_of(estimator, self.estimators)}")
        if snr not in self.snr:
            raise FitError(f"SNR {snr:g} dB; valid: {', '.join(f'{x:g}' for x in self.snr)}")

    def plot(self, parameters: Sequence[str] | None = None) -> Any:
        """Draw box plots over SNR, estimators side by side: parameters, errors of multipliers.

        Args:
            parameters: names; default: all, but not more than 12.

        Raises:
            FitError: for an unknown parameter.
        """
        for name in parameters or ():
            if name not in self.parameters:
                raise FitError(f"parameter '{name}'; {one_of(name, self.parameters)}")
        return render(self, "plot", parameters)

    def plot_multipliers(self, snr: float | None = None) -> Any:
        """Draw λ(t) of each estimator's typical run over the true one (Figs. 5 and 9).

        Args:
            snr: [dB]; default: the lowest.

        Raises:
            FitError: for an unknown SNR, or a mechanism without multipliers.
        """
        return render(self, "multipliers", self.snr[-1] if snr is None else snr)


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
        Every run's values, standard errors and errors of the multipliers, and their statistics;
        after Ctrl-C those of the runs that are done. Runs that end in an error are kept, with it,
        in `failures`.

    Raises:
        FitError: for an SNR, a number or an estimator that is none, or an unknown truth.
        LogError: if the log cannot be read or has no channel that gets noise.
    """
    ratios, applied = _checked(snr, runs, seed), estimators_of(estimators)
    log = log if isinstance(log, Log) else read_log(log, mechanism.columns)
    columns = noisy_columns(log, channels)
    if reactions is not None and not isinstance(reactions, Log):
        reactions = read_log(reactions)
    known = truth_of(mechanism, log, truth, reactions)
    plan = TrialPlan(mechanism, log, applied, known, columns, int(seed))
    return _study(plan, ratios, runs, Workers(jobs, scheduler, False, progress))


def _checked(snr: float | Sequence[float], runs: int, seed: int) -> tuple[float, ...]:
    """Return signal-to-noise ratios, each once, highest first; refuse an invalid argument."""
    check_whole("runs", runs, 1)
    check_whole("seed", seed)
    valid = "valid: numbers of dB, as snr=(60, 40, 30)"
    ratios = np.atleast_1d(np.asarray(snr, dtype=object))
    for each in ratios:
        if not (isinstance(each, int | float | np.number) and np.isfinite(each)):
            raise FitError(f"SNR {each!r}; {valid}")
    if not len(ratios):
        raise FitError(f"no SNR given; {valid}")
    return tuple(sorted(set(map(float, ratios)), reverse=True))


def _study(plan: TrialPlan, ratios: tuple[float, ...], runs: int, workers: Workers) -> MonteCarlo:
    """Make all runs of a plan; Ctrl-C ends it with the runs that are done at every ratio."""
    tasks = [(snr, run) for run in range(runs) for snr in ratios]
    names = [f"run {run} at {snr:g} dB" for snr, run in tasks]
    rows: TrialRows = ([], [], [])
    done = workers.over(_trial, tasks, plan, names, "runs")
    count = 0
    try:
        for name, ((snr, run), each) in zip(names, done, strict=True):
            if each is None:  # the process died
                why = workers.broken[name]
                each = [], [], [(one.name, snr, run, why) for one in plan.estimators]
            for mine, new in zip(rows, each, strict=True):
                mine += new
            count += 1
    except KeyboardInterrupt:
        runs = count // len(ratios)
        if not runs:
            raise
    order = pl.col("snr"), pl.col("run")
    types = (RUN | PARAMETER, RUN | MULTIPLIER, RUN | {"error": pl.String})
    frames = (
        pl.DataFrame(frame, schema=kinds, orient="row")
        .fill_nan(None)
        .filter(order[1] < runs)
        .sort(*order, descending=[True, False], maintain_order=True)
        for frame, kinds in zip(rows, types, strict=True)
    )
    return MonteCarlo(plan, ratios, runs, *frames)


def _trial(plan: TrialPlan, task: tuple[float, int]) -> TrialRows:
    return plan.rows(*task)
