"""Tidy frames of all runs, and their statistics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import polars as pl

from ident.montecarlo.sample import Outcome
from ident.montecarlo.truth import Truth

INTERVAL = 1.96  # standard errors: 95 % of a normal distribution
FORCE = ("force", "moment")  # root sum of squares over all multipliers in N, in N m
RUN = {"estimator": pl.String, "snr": pl.Float64, "run": pl.Int64}


def samples_of(outcomes: Sequence[Outcome], truth: Truth) -> pl.DataFrame:
    """One row a run and parameter."""
    rows = [
        (o.estimator, o.snr, o.run, name, value, stderr, truth.values[name], truth.units[name])
        for o in outcomes
        if not o.failure
        for name, value, stderr in zip(truth.values, o.values, o.stderrs, strict=True)
    ]
    own = {"parameter": pl.String, "value": pl.Float64, "stderr": pl.Float64, "truth": pl.Float64}
    return _frame(rows, RUN | own | {"unit": pl.String})


def errors_of(outcomes: Sequence[Outcome], truth: Truth) -> pl.DataFrame:
    """One row a run and multiplier, and the sums of those in N and in N m."""
    rows = []
    for o in outcomes:
        if o.failure:
            continue
        run = (o.estimator, o.snr, o.run)
        named = list(zip(truth.multipliers, o.errors, truth.multiplier_units, strict=True))
        rows += [(*run, name, off, unit) for name, off, unit in named]
        for total, unit in zip(FORCE, ("N", "N m"), strict=True):
            same = [off for _, off, its in named if its == unit and np.isfinite(off)]
            if same:
                rows.append((*run, total, float(np.sqrt(np.sum(np.square(same)))), unit))
    own = {"multiplier": pl.String, "rms": pl.Float64, "unit": pl.String}
    return _frame(rows, RUN | own)


def failures_of(outcomes: Sequence[Outcome]) -> pl.DataFrame:
    """One row a run that ended in an error."""
    rows = [(o.estimator, o.snr, o.run, o.failure) for o in outcomes if o.failure]
    return _frame(rows, RUN | {"error": pl.String})


def _frame(
    rows: Sequence[tuple[object, ...]], schema: dict[str, type[pl.DataType]]
) -> pl.DataFrame:
    """Rows as columns of these types, null where there is no number."""
    return pl.DataFrame(rows, schema=schema, orient="row").fill_nan(None)


def of_parameters(samples: pl.DataFrame) -> pl.DataFrame:
    """Bias, spread and honesty of the standard errors; see `MonteCarlo.table`."""
    value, truth, stderr = pl.col("value"), pl.col("truth"), pl.col("stderr")
    off = value - truth
    return samples.group_by("estimator", "snr", "parameter", maintain_order=True).agg(
        value.count().alias("runs"),
        value.mean().alias("mean"),
        off.mean().alias("bias"),
        (value.std() / value.count().sqrt()).alias("bias_stderr"),
        value.std().alias("std"),
        (off**2).mean().sqrt().alias("rms"),
        stderr.mean().alias("stderr"),
        (off.abs() <= INTERVAL * stderr).mean().alias("coverage"),
        truth.first(),
        pl.col("unit").first(),
    )


def of_multipliers(errors: pl.DataFrame, truth: Truth) -> pl.DataFrame:
    """Mean and spread of the runs' rms errors; see `MonteCarlo.multipliers`."""
    size = dict(zip(truth.multipliers, truth.sizes(), strict=True))
    for total, unit in zip(FORCE, ("N", "N m"), strict=True):
        same = [
            size[n]
            for n, u in zip(truth.multipliers, truth.multiplier_units, strict=True)
            if u == unit
        ]
        size[total] = np.sqrt(np.nansum(np.square(same)))
    rms = pl.col("rms")
    return (
        errors.group_by("estimator", "snr", "multiplier", maintain_order=True)
        .agg(
            rms.count().alias("runs"),
            rms.mean().alias("mean"),
            rms.std().alias("std"),
            pl.col("unit").first(),
        )
        .with_columns(
            pl.col("multiplier").replace_strict(size, return_dtype=pl.Float64).alias("size")
        )
        .filter(pl.col("runs") > 0)
    )
