"""`print(monte_carlo)`: one table of parameters and one of multipliers, estimators side by side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import polars as pl

from ident.montecarlo.statistics import FORCE
from ident.tables import shortened, table

if TYPE_CHECKING:
    from ident.montecarlo.montecarlo import MonteCarlo

MOST = 24  # parameters in the table; `MonteCarlo.table` has all
ROUNDING = 1e-9  # of the standard errors' size: a truth below it is zero

Row = Mapping[str, object]


def said(x: MonteCarlo) -> str:
    """Heading, both tables, failures."""
    plan = x.plan
    runs = "run" if x.runs == 1 else "runs"
    ratios = ", ".join(f"{each:g}" for each in x.snr)
    lines = [
        f"Monte Carlo of {plan.mechanism.name} on {plan.log.name}: {x.runs} {runs} at {ratios} dB "
        f"each, seed {plan.seed}",
        f"  noise on {', '.join(plan.columns)}",
        *(f"  truth of {words}" for words in plan.truth.words),
        *(f"  {each.name}: {each.words}" for each in plan.estimators if each.words),
        "",
        *table(parameter_rows(x)),
    ]
    left = len(x.parameters) - MOST
    if left > 0:
        lines.append(f"  … and {left} parameters more")
    if rows := multiplier_rows(x):
        lines += ["", "rms error of the multipliers, mean over runs", *table(rows)]
    return "\n".join([*lines, *(f"note: {note}" for note in notes(x))])


def parameter_rows(x: MonteCarlo) -> list[list[str]]:
    """Head and one row a parameter and SNR: bias, std, mean standard error, coverage."""
    of = {(r["estimator"], r["snr"], r["parameter"]): r for r in x.table.iter_rows(named=True)}
    first, second = ["", "", ""], ["parameter", "truth", "SNR"]
    for name in x.estimators:
        first += [name, "", "", ""]
        second += ["bias", "std", "± mean", "covers"]
    rows = [first, second]
    for name in x.parameters[:MOST]:
        for i, snr in enumerate(x.snr):
            known = f"{x.plan.truth.values[name]:.4g} {x.plan.truth.units[name]}"
            row = ["" if i else shortened(name, 40), "" if i else known, f"{snr:g} dB"]
            for estimator in x.estimators:
                row += _cells(of.get((estimator, snr, name)))
            rows.append(row)
    return rows


def _cells(r: Row | None) -> list[str]:
    if r is None or not r["runs"]:
        return ["–"] * 4
    covered = "–" if r["coverage"] is None else f"{100 * _number(r['coverage']):.0f} %"
    return [shown(r, "bias"), shown(r, "std"), shown(r, "stderr"), covered]


def shown(r: Row, what: str) -> str:
    """A statistic in percent of the truth; in its unit where the truth is zero."""
    if r[what] is None:
        return "–"
    value, truth = _number(r[what]), abs(_number(r["truth"]))
    sign = "+" if what == "bias" else ""
    spread = max(_number(r["std"] or 0.0), _number(r["rms"] or 0.0))
    if truth <= ROUNDING * spread:
        return f"{value:{sign}.2g} {r['unit']}"
    share = 100 * value / truth
    return f"{share:{sign}.{0 if abs(share) >= 100 else 1 if abs(share) >= 10 else 2}f} %"


def multiplier_rows(x: MonteCarlo) -> list[list[str]]:
    """Head and one row a multiplier and SNR; sums last; empty without multipliers."""
    of = {
        (r["estimator"], r["snr"], r["multiplier"]): r for r in x.multipliers.iter_rows(named=True)
    }
    names = [n for n in (*x.plan.truth.multipliers, *FORCE) if any(key[2] == n for key in of)]
    if not names:
        return []
    rows = [["multiplier", "rms of it", "SNR", *x.estimators]]
    for name in names:
        size = next(r for key, r in of.items() if key[2] == name)
        for i, snr in enumerate(x.snr):
            row = [
                "" if i else name,
                "" if i else f"{size['size']:.4g} {size['unit']}",
                f"{snr:g} dB",
            ]
            for estimator in x.estimators:
                r = of.get((estimator, snr, name))
                row.append("–" if r is None else f"{r['mean']:.3g} {r['unit']}")
            rows.append(row)
    return rows


def notes(x: MonteCarlo) -> list[str]:
    """Runs that failed or did not determine a parameter."""
    found = []
    failed = x.failures.group_by("estimator", "snr", maintain_order=True).agg(
        pl.len().alias("count"), pl.col("error").first()
    )
    for r in failed.iter_rows(named=True):
        found.append(
            f"{r['estimator']} at {r['snr']:g} dB: {r['count']} of {x.runs} runs failed; the "
            f"first: {r['error']}"
        )
    for r in x.table.iter_rows(named=True):
        lost = x.failures.filter(
            (pl.col("estimator") == r["estimator"]) & (pl.col("snr") == r["snr"])
        ).height
        if (less := x.runs - lost - r["runs"]) > 0:
            found.append(
                f"{r['estimator']} at {r['snr']:g} dB: {less} of {x.runs} runs do not determine "
                f"{r['parameter']}"
            )
    return found


def _number(value: object) -> float:
    assert isinstance(value, int | float)
    return float(value)
