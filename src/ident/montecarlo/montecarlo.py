"""The noun: what estimators made of all runs, beside the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import polars as pl
from markupsafe import Markup

from ident.errors import FitError, one_of
from ident.fit import Fit
from ident.montecarlo.plots import plot_spread, plot_typical
from ident.montecarlo.report import write_monte_carlo
from ident.montecarlo.sample import Outcome, Plan
from ident.montecarlo.statistics import (
    FORCE,
    errors_of,
    failures_of,
    of_multipliers,
    of_parameters,
    samples_of,
)
from ident.montecarlo.words import multiplier_rows, parameter_rows, said
from ident.show.charts import Chart
from ident.show.html import Shown, strong, table


@dataclass(frozen=True, eq=False)
class MonteCarlo(Shown):
    """Made by `ident.monte_carlo`.

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

    plan: Plan
    snr: tuple[float, ...]
    runs: int
    samples: pl.DataFrame
    errors: pl.DataFrame
    failures: pl.DataFrame

    @classmethod
    def of(
        cls, plan: Plan, snr: tuple[float, ...], runs: int, outcomes: Sequence[Outcome]
    ) -> MonteCarlo:
        """From the outcomes of all runs.

        Args:
            plan: what was run.
            snr: signal-to-noise ratios [dB].
            runs: at each of them.
            outcomes: of all estimators, runs and ratios.
        """
        return cls(
            plan,
            snr,
            runs,
            samples_of(outcomes, plan.truth),
            errors_of(outcomes, plan.truth),
            failures_of(outcomes),
        )

    @cached_property
    def table(self) -> pl.DataFrame:
        """Statistics by estimator, SNR and parameter.

        Columns: `runs` that determine it, `mean`, `bias` (mean − truth), `bias_stderr` (of it,
        std / √runs), `std`, `rms` (of value − truth), `stderr` (mean of those that the fits claim),
        `coverage` (share of runs whose value ± 1.96 stderr holds the truth), `truth`, `unit`.
        """
        return of_parameters(self.samples)

    @cached_property
    def multipliers(self) -> pl.DataFrame:
        """Statistics by estimator, SNR and multiplier.

        Columns: `runs`, `mean` and `std` of the rms errors, `size` (rms of the true one), `unit`.
        """
        return of_multipliers(self.errors, self.plan.truth)

    @property
    def estimators(self) -> tuple[str, ...]:
        """Names."""
        return tuple(each.name for each in self.plan.estimators)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names."""
        return tuple(self.plan.truth.values)

    def fit(self, estimator: str, snr: float, run: int) -> Fit:
        """The fit of one run, made again.

        Args:
            estimator: its name.
            snr: one of `snr` [dB].
            run: its number, from 0.

        Raises:
            FitError: for an estimator, SNR or run that there is not; else what that run ended in.
        """
        self._check(estimator, snr)
        if not 0 <= run < self.runs:
            raise FitError(f"run {run}; valid: 0 to {self.runs - 1}")
        find = {each.name: each.find for each in self.plan.estimators}[estimator]
        return find(self.plan.mechanism, self.plan.log_of(snr, run))

    def typical(self, estimator: str, snr: float) -> int:
        """The run whose rms error of the multipliers is closest to the average (Figs. 5 and 9).

        Of a mechanism without multipliers, that whose parameters are off as much as on average.

        Args:
            estimator: its name.
            snr: one of `snr` [dB].

        Raises:
            FitError: for an estimator or SNR that there is not, or if all runs failed.
        """
        self._check(estimator, snr)
        here = (pl.col("estimator") == estimator) & (pl.col("snr") == snr)
        off = self.errors.filter(here & pl.col("multiplier").is_in(FORCE)).drop_nulls("rms")
        size = pl.col("rms") ** 2
        if off.is_empty():
            off = self.samples.filter(here & (pl.col("truth") != 0)).drop_nulls("value")
            size = (pl.col("value") / pl.col("truth") - 1) ** 2
        if off.is_empty():
            raise FitError(f"'{estimator}' at {snr:g} dB: every run failed, none is typical")
        by_run = off.group_by("run", maintain_order=True).agg(size.sum().sqrt().alias("size"))
        nearest = int(np.abs(by_run["size"].to_numpy() - by_run["size"].mean()).argmin())
        return int(by_run["run"][nearest])

    def _check(self, estimator: str, snr: float) -> None:
        if estimator not in self.estimators:
            raise FitError(f"estimator '{estimator}'; {one_of(estimator, self.estimators)}")
        if snr not in self.snr:
            raise FitError(f"SNR {snr:g} dB; valid: {', '.join(f'{x:g}' for x in self.snr)}")

    def plot(self, parameters: Sequence[str] | None = None) -> Chart:
        """Box plots over SNR, estimators side by side: parameters and errors of the multipliers.

        Args:
            parameters: names; default: all, but not more than 12.

        Raises:
            FitError: for a parameter that there is not.
        """
        for name in parameters or ():
            if name not in self.parameters:
                raise FitError(f"parameter '{name}'; {one_of(name, self.parameters)}")
        return plot_spread(self, parameters)

    def plot_multipliers(self, snr: float | None = None) -> Chart:
        """λ(t) of each estimator's typical run over the true one (Figs. 5 and 9).

        Args:
            snr: [dB]; default: the lowest.

        Raises:
            FitError: for an SNR that there is not, or a mechanism without multipliers.
        """
        return plot_typical(self, self.snr[-1] if snr is None else snr)

    def write(self, folder: str | Path) -> list[Path]:
        """montecarlo.json, runs.csv, multiplier_errors.csv, montecarlo.png and report.html.

        Args:
            folder: made where there is none.

        Returns:
            The files written, all of them or none.
        """
        return write_monte_carlo(self, folder)

    def __str__(self) -> str:
        return said(self)

    __repr__ = __str__

    def _blocks(self) -> tuple[Markup, ...]:
        forces = multiplier_rows(self)
        return (
            strong(f"{self.plan.mechanism.name}: {self.runs} runs at each signal-to-noise ratio"),
            table(parameter_rows(self), "Bias and spread of all runs"),
            *((table(forces, "Multipliers: rms error, mean over runs"),) if forces else ()),
        )
