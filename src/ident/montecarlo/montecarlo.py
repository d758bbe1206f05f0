"""Results of Monte Carlo studies: all runs beside the truth, and their statistics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ident.display import Displayed, render
from ident.errors import FitError, one_of
from ident.files import write_all
from ident.fit import Fit
from ident.montecarlo.trial import TrialOutcome, TrialPlan, rms_of

Z95 = 1.96  # standard errors: the central 95 % of a normal distribution
SUMS = {"force": "N", "moment": "N m"}  # root sums of squares over all multipliers of a unit
RUN = {"estimator": pl.String, "snr": pl.Float64, "run": pl.Int64}
PARAMETER = {"parameter": pl.String, "value": pl.Float64, "stderr": pl.Float64,
             "truth": pl.Float64, "unit": pl.String}  # fmt: skip
MULTIPLIER = {"multiplier": pl.String, "rms": pl.Float64, "unit": pl.String}


@dataclass(frozen=True, eq=False, repr=False)
class MonteCarlo(Displayed):
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

    @classmethod
    def of(
        cls, plan: TrialPlan, snr: tuple[float, ...], runs: int, outcomes: Sequence[TrialOutcome]
    ) -> MonteCarlo:
        """Make the frames of a `plan` from `outcomes` at all ratios `snr` [dB], `runs` of each."""
        truth = plan.truth
        samples, errors, failures = [], [], []
        for o in outcomes:
            run = (o.estimator, o.snr, o.run)
            if o.failure:
                failures.append((*run, o.failure))
                continue
            for name, value, stderr in zip(truth.values, o.values, o.stderrs, strict=True):
                samples.append((*run, name, value, stderr, truth.values[name], truth.units[name]))
            every = list(zip(truth.multipliers, o.errors, truth.multiplier_units, strict=True))
            errors += [(*run, *each) for each in every]
            for name, unit in SUMS.items():
                same = [rms for _, rms, its in every if its == unit and np.isfinite(rms)]
                if same:
                    errors.append((*run, name, float(np.linalg.norm(same)), unit))
        return cls(
            plan, snr, runs, _frame(samples, RUN | PARAMETER), _frame(errors, RUN | MULTIPLIER),
            _frame(failures, RUN | {"error": pl.String}),
        )  # fmt: skip

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
        notes = []
        failed = self.failures.group_by("estimator", "snr", maintain_order=True).agg(
            pl.len().alias("count"), pl.col("error").first()
        )
        lost = {(r["estimator"], r["snr"]): r["count"] for r in failed.iter_rows(named=True)}
        for r in failed.iter_rows(named=True):
            notes.append(
                f"{r['estimator']} at {r['snr']:g} dB: {r['count']} of {self.runs} runs failed; "
                f"the first: {r['error']}"
            )
        for r in self.table.iter_rows(named=True):
            less = self.runs - lost.get((r["estimator"], r["snr"]), 0) - r["runs"]
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

    def write(self, folder: str | Path) -> list[Path]:
        """Write montecarlo.json, runs.csv, multiplier_errors.csv, montecarlo.png and report.html.

        Args:
            folder: made where there is none.

        Returns:
            The files written, all of them or none.

        Raises:
            IdentError: if the folder cannot be written.
        """
        return write_all(Path(folder), render(self, "files"))


@dataclass(frozen=True, eq=False, repr=False)
class Studies(Displayed):
    """Monte Carlo studies of many logs. Made by `ident.monte_carlo_each`.

    Attributes:
        studies: of every log, by its name.
        left_out: by name of a log without a study, the reason.
    """

    studies: Mapping[str, MonteCarlo]
    left_out: Mapping[str, str]

    @cached_property
    def table(self) -> pl.DataFrame:
        """`MonteCarlo.table` of all logs, one below the other, with a column `log`."""
        return pl.concat(
            x.table.select(pl.lit(log).alias("log"), pl.all()) for log, x in self.studies.items()
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Logs that were left out, with the reason."""
        return tuple(f"{log}: left out: {why}" for log, why in self.left_out.items())

    def write(self, folder: str | Path) -> list[Path]:
        """Write the files of `MonteCarlo.write` in a folder for each log, and logs.csv, the table.

        Args:
            folder: made where there is none.

        Returns:
            The files written, all of them or none.

        Raises:
            IdentError: if the folder cannot be written.
        """
        files = {"logs.csv": self.table.write_csv().encode()}
        for log, x in self.studies.items():
            files |= {f"{log}/{name}": content for name, content in render(x, "files").items()}
        return write_all(Path(folder), files)


def _frame(rows: Sequence[tuple[Any, ...]], schema: Mapping[str, Any]) -> pl.DataFrame:
    """Return rows as columns of these types, null where there is no number."""
    return pl.DataFrame(rows, schema=schema, orient="row").fill_nan(None)
