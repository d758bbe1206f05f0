"""Monte Carlo studies as text, HTML, charts and files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl

from ident.display import renders
from ident.files import json_bytes
from ident.montecarlo import SUMS, MonteCarlo
from ident.motion import complete
from ident.show.charts import PRIOR, Chart, Level, Line, Mark, Panel
from ident.show.html import Page, Section
from ident.show.motion import made_of, understood
from ident.show.sheet import Sheet
from ident.text import listed, shortened

SCHEMA = "ident.montecarlo/1"
ROWS = 24  # parameters in the printed table; `MonteCarlo.table` has all
PANELS, ACROSS = 12, 3  # parameters in one chart, and panels side by side
QUANTILES = {0.05: 0.6, 0.5: 1.8, 0.95: 0.6}  # and the width of their lines
BIAS, FORCES = "bias and spread of all runs", "rms error of the multipliers, mean over runs"
ZERO = 1e-9  # of the spread: a truth below it is zero, so that percentages of it mean nothing


@renders(MonteCarlo, "sheet")
def sheet(x: MonteCarlo, most: int | None = ROWS) -> Sheet:
    """Return a heading, the tables of `most` parameters and of multipliers, and notes."""
    plan = x.plan
    runs = "run" if x.runs == 1 else "runs"
    ratios = ", ".join(f"{each:g}" for each in x.snr)
    title = (
        f"Monte Carlo of {plan.mechanism.name} on {plan.log.name}: {x.runs} {runs} at {ratios} dB "
        f"each, seed {plan.seed}"
    )
    tables = {BIAS: parameter_rows(x, most)}
    if rows := multiplier_rows(x):
        tables[FORCES] = rows
    more = len(x.parameters) - (most or len(x.parameters))
    lines = [f"… and {more} parameters more"] if more > 0 else []
    return Sheet(title, facts=_basis(x), tables=tables, lines=lines, notes=x.notes)


def _basis(x: MonteCarlo) -> dict[str, str]:
    estimators = {each.name: each.words for each in x.plan.estimators}
    basis = {"noise": ", ".join(x.plan.columns), "truth": "; ".join(x.plan.truth.words)}
    return basis | estimators


def parameter_rows(x: MonteCarlo, most: int | None = None) -> list[list[str]]:
    """Return a head and a row for each parameter and SNR: bias, std, mean stderr, coverage."""
    of = {(r["estimator"], r["snr"], r["parameter"]): r for r in x.table.iter_rows(named=True)}
    heads = [h for name in x.estimators for h in (f"{name}: bias", "std", "± mean", "covers")]
    rows = [["parameter", "truth", "SNR", *heads]]
    for name in x.parameters[:most]:
        true = f"{x.plan.truth.values[name]:.4g} {x.plan.truth.units[name]}"
        for i, snr in enumerate(x.snr):
            row = ["", ""] if i else [shortened(name, 40), true]
            cells = [_cells(of.get((estimator, snr, name))) for estimator in x.estimators]
            rows.append([*row, f"{snr:g} dB", *(cell for each in cells for cell in each)])
    return rows


def _cells(r: Mapping[str, Any] | None) -> list[str]:
    if r is None or not r["runs"]:
        return ["–"] * 4
    covered = "–" if r["coverage"] is None else f"{100 * r['coverage']:.0f} %"
    return [*(_relative(r, name) for name in ("bias", "std", "stderr")), covered]


def _relative(r: Mapping[str, Any], name: str) -> str:
    """Return a statistic in percent of the truth; in its unit where the truth is zero."""
    if r[name] is None:
        return "–"
    sign = "+" if name == "bias" else ""
    if abs(r["truth"]) <= ZERO * max(r["std"] or 0.0, r["rms"] or 0.0):
        return f"{r[name]:{sign}.2g} {r['unit']}"
    share = 100 * r[name] / abs(r["truth"])
    digits = 0 if abs(share) >= 100 else 1 if abs(share) >= 10 else 2
    return f"{share:{sign}z.{digits}f} %"  # z: no minus sign where it rounds to zero


def multiplier_rows(x: MonteCarlo) -> list[list[str]]:
    """Return a head and a row for each multiplier and SNR, sums last; empty without multipliers."""
    of: dict[str, dict[tuple[str, float], Mapping[str, Any]]] = {}
    for r in x.multipliers.iter_rows(named=True):
        of.setdefault(r["multiplier"], {})[r["estimator"], r["snr"]] = r
    rows = [["multiplier", "rms of it", "SNR", *x.estimators]]
    for name in (n for n in (*x.plan.truth.multipliers, *SUMS) if n in of):
        one = next(iter(of[name].values()))
        size = f"{one['size']:.4g} {one['unit']}"
        for i, snr in enumerate(x.snr):
            found = [of[name].get((estimator, snr)) for estimator in x.estimators]
            means = ["–" if r is None else f"{r['mean']:.3g} {r['unit']}" for r in found]
            rows.append([*(["", ""] if i else [name, size]), f"{snr:g} dB", *means])
    return rows if len(rows) > 1 else []


@renders(MonteCarlo, "plot")
def plot(x: MonteCarlo, parameters: Sequence[str] | None = None) -> Chart:
    """Draw a panel for each parameter and multiplier: median of all runs at each SNR, 5, 95 %."""
    names = list(parameters or x.parameters[:PANELS])
    drawn = set(x.errors.drop_nulls("rms")["multiplier"])
    panels = []
    for name in names:
        own = x.samples.filter(pl.col("parameter") == name)
        truth = Level(x.plan.truth.values[name], colour=PRIOR, dashed=True)
        marks: tuple[Mark, ...] = (truth, *_quantiles(x, own, "value"))
        panels.append(_panel(x, marks, shortened(name, 40), x.plan.truth.units[name]))
    for name in (n for n in (*x.plan.truth.multipliers, *SUMS) if n in drawn):
        own = x.errors.filter(pl.col("multiplier") == name)
        marks, title = _quantiles(x, own, "rms"), f"rms error of {name}"
        panels.append(_panel(x, marks, title, own["unit"][0], logarithmic=True))
    rows = tuple(tuple(panels[i : i + ACROSS]) for i in range(0, len(panels), ACROSS))
    words = f"{x.plan.mechanism.name}: {x.runs} runs at each SNR; thin lines: the lowest and "
    words += "highest 5 % of them; dashed: the truth"
    if parameters is None and len(x.parameters) > len(names):
        words += f"; {len(x.parameters) - len(names)} parameters more are not drawn"
    return Chart(words, rows, width=13)


def _panel(
    x: MonteCarlo, marks: tuple[Mark, ...], title: str, unit: str, logarithmic: bool = False
) -> Panel:
    names = tuple(f"{snr:g}" for snr in x.snr)
    return Panel(marks, "SNR [dB]", f"[{unit}]", title, names, (), logarithmic, height=3.0)


def _quantiles(x: MonteCarlo, rows: pl.DataFrame, column: str) -> tuple[Line, ...]:
    """Return the median of each estimator over the SNRs, and thinner 5 and 95 %."""
    lines = []
    for i, name in enumerate(x.estimators):
        own = rows.filter(estimator=name).drop_nulls(column)
        known = [k for k, snr in enumerate(x.snr) if len(own.filter(snr=snr))]
        for share, width in QUANTILES.items():
            y = [own.filter(snr=x.snr[k])[column].quantile(share, "linear") for k in known]
            label = name if share == 0.5 else ""
            lines.append(Line(np.array(known, float), np.array(y), label, i, width, dotted=True))
    return tuple(lines)


@renders(MonteCarlo, "files")
def files(x: MonteCarlo) -> dict[str, bytes]:
    """Return the contents of all files by name."""
    return {
        "montecarlo.json": json_bytes(_data(x)),
        "runs.csv": x.samples.write_csv().encode(),
        "multiplier_errors.csv": x.errors.write_csv().encode(),
        "montecarlo.png": plot(x).image("png"),
        "report.html": _page(x),
    }


def _data(x: MonteCarlo) -> dict[str, Any]:
    """Return the statistics for JSON."""
    plan = x.plan
    return {
        "schema": SCHEMA,
        "mechanism": plan.mechanism.name,
        "log": plan.log.name,
        "snr": list(x.snr),
        "runs": x.runs,
        "seed": plan.seed,
        "noise_on": list(plan.columns),
        "estimators": [{"name": each.name, "words": each.words} for each in plan.estimators],
        "truth": list(plan.truth.words),
        "parameters": x.table.to_dicts(),
        "multipliers": x.multipliers.to_dicts(),
        "failures": x.failures.to_dicts(),
    }


def _page(x: MonteCarlo) -> bytes:
    plan = x.plan
    source = plan.mechanism, complete(plan.mechanism, [plan.log])
    sections = (
        Section("What noise does", (*sheet(x, None).blocks(), plot(x))),
        understood(*source),
        made_of(*source),
    )
    title = f"{plan.mechanism.name} on {plan.log.name}: Monte Carlo"
    return Page(title, _headline(x), sections).html()


def _headline(x: MonteCarlo) -> str:
    """Return how often the last estimator's intervals hold the truth."""
    line = f"{x.runs} runs at each of {', '.join(f'{snr:g}' for snr in x.snr)} dB"
    rows = x.table.filter(pl.col("estimator") == x.estimators[-1], pl.col("coverage").is_not_null())
    held = rows.group_by("snr", maintain_order=True).agg(pl.col("coverage").mean()).rows()
    shares = listed([f"{100 * share:.0f} % at {snr:g} dB" for snr, share in held])
    words = f"With {x.estimators[-1]}, intervals of 95 % hold the truth in {shares}, over all runs."
    return f"{line}. {words}" if held else line
