"""Simulated runs, replays, planned motions and Monte Carlo studies as text, charts and files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.display import renders
from ident.excite.excitation import Excitation, LimitUse
from ident.files import json_bytes
from ident.lazy import lazy
from ident.montecarlo import SUMS, MonteCarlo
from ident.request import PYTHON, Request
from ident.show.charts import BELOW, MEASURED, PRIOR, RESIDUAL, Chart, Level, Line, Mark, Panel
from ident.show.html import Section, Sheet, by_log, paragraph, report_page
from ident.show.motion import made_of, understood
from ident.simulate.integrate import Run
from ident.simulate.replay import Replay
from ident.text import listed, percent, shortened, significant

if TYPE_CHECKING:
    import polars as pl
else:
    pl = lazy("polars")

TRANSITIONS = 12  # that are printed
LIMITING = 0.95  # share of a limit from which it is marked as the one that limits the motion
NEAR = 2.0  # times the largest value: a limit beyond is not drawn
CHANNELS = (("q", "position"), ("v", "speed"), ("a", "acceleration"), ("tau", "torque"))


@renders(Run, "sheet")
def run_sheet(x: Run) -> Sheet:
    """Return samples, closure error, friction, and the first transitions."""
    title = (
        f"simulated {x.mechanism.name}: {len(x.t)} samples, {x.t[-1] - x.t[0]:.4g} s; "
        f"{x.evaluations} evaluations of the equations of motion"
    )
    facts = {"closure error": f"{x.closure_error:.2g}"} if x.mechanism.closures else {}
    for name, stuck in x.stuck.items():
        share, count = 100 * stuck.mean(), sum(joint.joint == name for joint in x.transitions)
        facts[f"dry friction at {name}"] = f"stuck {share:.3g} % of the time, {count} changes"
    lines = list(map(str, x.transitions[:TRANSITIONS]))
    more = len(x.transitions) - TRANSITIONS
    return Sheet(title, facts=facts, lines=lines + [f"… {more} more"] * (more > 0))


@renders(Run, "summary")
def summary(x: Run) -> str:
    """Return the same without the transitions."""
    return replace(run_sheet(x), lines=()).summary()


def _rows(x: Replay) -> list[list[str]]:
    banded = ["in the 95 % band"] * any(run.within for logs in x.runs.values() for run in logs)
    rows = [["", "rms", "of the way", *banded]]
    for model, logs in x.runs.items():
        for run in logs:
            title = [model] * (len(x.runs) > 1) + [run.name] * (len(logs) > 1)
            rows += [[" ".join(title), "", "", *[""] * len(banded)]] if title else []
            for joint, error in run.errors.items():
                rms = "–" if np.isnan(error.rms) else f"{significant(error.rms)} {error.unit}"
                inside = f"{100 * run.within[joint]:.0f} %" if joint in run.within else ""
                rows.append([joint, rms, percent(error.relative), *[inside] * len(banded)])
    return rows


@renders(Replay, "sheet")
def sheet(x: Replay) -> Sheet:
    """Return the errors by joint and notes."""
    count = sum(len(run.starts) for run in next(iter(x.runs.values())))
    title = (
        f"simulated against measured motion: {count} windows of {x.window:g} s, each from "
        "the measured state"
    )
    return Sheet(title, tables={"error by joint": _rows(x)}, notes=x.notes)


@renders(Replay, "plot")
def plot(x: Replay, experiment: int = 0) -> Chart:
    """Draw measured and simulated coordinates over time, each joint's difference below."""
    first = next(iter(x.runs.values()))[experiment]
    rows = []
    for j, (joint, unit) in enumerate(zip(first.joints, first.units, strict=True)):
        above = [Line(first.t, first.measured[:, j], "measured", MEASURED, BELOW)]
        below = []
        for i, (name, logs) in enumerate(x.runs.items()):
            run, label = logs[experiment], "simulated" if len(x.runs) == 1 else name
            above.append(Line(run.t, run.simulated[:, j], label, i))
            if run.band is not None:
                for side in (-1, 1):
                    below.append(Line(run.t, side * run.band[:, j], "", i, 0.4))
            below.append(Line(run.t, run.simulated[:, j] - run.measured[:, j], "", i, 0.8))
        rows.append((Panel(tuple(above), "t [s]", f"{joint} [{unit}]", height=1.8),))
        rows.append((Panel((Level(), *below), "t [s]", f"difference [{unit}]", height=1.4),))
    words = f"Measured and simulated coordinate of every joint over time, {first.name}"
    return Chart(words, tuple(rows), shared_x=True, clock=first.name)


@renders(Replay, "section")
def section(x: Replay) -> Section:
    """Return the errors and charts for a report."""
    words = (
        f"Restarted from the measured state every {x.window:g} s; relative to the way from there."
    )
    logs = [run.name for run in next(iter(x.runs.values()))]
    blocks = [paragraph(words), *sheet(x).blocks(), *by_log(logs, x.plot)]
    return Section("Simulated against measured motion", blocks)


@renders(Replay, "json")
def replay_json(x: Replay) -> dict[str, Any]:
    """Return the content of `replay` of compare.json."""
    models = {
        name: [
            {
                "log": run.name, "windows": len(run.starts), "joints": run.errors,
                "failures": list(run.failures),
                **({"within": run.within} if run.within else {}),
            }
            for run in logs
        ]
        for name, logs in x.runs.items()
    }  # fmt: skip
    return {"window": x.window, "models": models}


# --- excitations --------------------------------------------------------------------------------


@renders(Excitation, "sheet")
def excitation_sheet(x: Excitation) -> Sheet:
    """Return motion, limits and expected standard errors."""
    start = ", ".join(f"{n} = {c[0] + c[1 + len(c) // 2 :].sum():.4g}" for n, c in x.series.items())
    title = (
        f"excitation of {x.name}: {x.periods} × {x.period:.4g} s, {x.harmonics} harmonics, "
        f"{len(x.log.t)} samples at {x.log.rate:.4g} Hz; seed {x.seed}"
    ) + ", the search was interrupted" * (not x.finished)
    facts = {"every period begins and ends": f"at rest, at {start}"}
    if x.home:
        share = next(item.share for item in x.uses if item.kind == "singularity")
        reaches = f"‖K⁺‖ reaches {x.home:.3g} times its value at home, "
        facts["singular positions"] = f"{reaches}{100 * share:.3g} % of its limit"
    noise = ", ".join(f"{name} {significant(value)}" for name, value in x.noise.items())
    known = [item for item in x.base if item.determined]
    rows = [["base parameter", "prior", "expected ±", "unit"]]
    rows += [
        [shortened(b.name), significant(b.prior, 4), significant(b.stderr, 2), b.unit]
        for b in known
    ]
    base = (
        f"identifies {len(known)} base parameters of {x.unknowns} unknowns; condition number "
        f"{significant(x.condition_number)}, log det {x.log_det:.4g}; with white torque noise of "
        f"{noise} [N m | N] a sample:"
    )
    lines = [] if x.separation is None else [str(x.separation)]
    unknown = [item for item in x.base if not item.determined]
    if unknown:
        lost = ", ".join(f"{b.name} (± {significant(b.stderr, 2)} {b.unit})" for b in unknown)
        lines.append(f"not determined, with errors above any plausible value: {lost}")
    if x.without_effect:
        lines.append(f"not determined, without effect on any torque: {', '.join(x.without_effect)}")
    tables = {"use of the limits": _limits(x), base: rows}
    return Sheet(title, facts=facts, tables=tables, lines=lines, notes=x.notes)


def _limits(x: Excitation) -> list[list[str]]:
    rows = [["joint", "from", "to", "of range", "speed", "", "acceleration", "", "torque", ""]]
    uses = {(use.joint, use.kind): use for use in x.uses}
    for name in dict.fromkeys(use.joint for use in x.uses if use.joint):
        position = uses[name, "position"]
        row = [name, f"{position.low:.4g}", f"{position.high:.4g}", _share(position)]
        for kind in ("speed", "acceleration", "torque"):
            row += ["", ""]
            if use := uses.get((name, kind)):
                row[-2:] = f"{significant(max(-use.low, use.high))} {use.unit}", _share(use)
        rows.append(row)
    return rows


def _share(use: LimitUse) -> str:
    """Return percent, with a star where the limit is active; a dash without a limit."""
    if not use.share:
        return "–"
    return f"{100 * use.share:.0f} %" + ("*" if use.share >= LIMITING else "")


@renders(Excitation, "plot")
def plot_excitation(x: Excitation) -> Chart:
    """Draw position, speed, acceleration and torque of every drive in one period; limits dashed."""
    one = x.log.t <= x.period
    t = x.log.t[one]
    rows: list[tuple[Panel, ...]] = []
    for name in (c.removeprefix("tau.") for c in x.log.columns if c.startswith("tau.")):
        row = []
        for channel, kind in CHANNELS:
            use = x.use(name, kind)
            y = x.log.columns[f"{channel}.{name}"][one]
            near = NEAR * float(np.abs(y).max())
            limits = [b for b in (use.lower, use.upper) if np.isfinite(b) and abs(b) < near]
            marks: list[Mark] = [Line(t, y)]
            marks += [Level(b, dashed=True, colour=RESIDUAL) for b in limits]
            label = f"{name} [{use.unit}]" if channel == "q" else f"[{use.unit}]"
            row.append(Panel(tuple(marks), "t [s]", label, kind if not rows else "", height=1.9))
        rows.append(tuple(row))
    words = "One period of the motion: position, speed, acceleration and torque of every drive"
    return Chart(words, tuple(rows), shared_x=True, width=13, clock=x.log.name)


SCHEMA = "ident.montecarlo/1"
ROWS = 24  # parameters in the printed table; `MonteCarlo.table` has all
PANELS, ACROSS = 12, 3  # parameters in one chart, and panels side by side
QUANTILES = {0.05: 0.6, 0.5: 1.8, 0.95: 0.6}  # and the width of their lines
BIAS, FORCES = "bias and spread of all runs", "rms error of the multipliers, mean over runs"
ZERO = 1e-9  # of the spread: a truth below it is zero, so that percentages of it mean nothing


@renders(MonteCarlo, "sheet")
def study_sheet(x: MonteCarlo, most: int | None = ROWS) -> Sheet:
    """Return a heading, the tables of `most` parameters and of multipliers, and notes."""
    plan = x.plan
    runs = "run" if x.runs == 1 else "runs"
    ratios = ", ".join(f"{item:g}" for item in x.snr)
    title = (
        f"Monte Carlo of {plan.mechanism.name} on {plan.log.name}: {x.runs} {runs} at {ratios} dB "
        f"each, seed {plan.seed}"
    )
    tables = {BIAS: parameter_rows(x, most)}
    if rows := multiplier_rows(x):
        tables[FORCES] = rows
    more = len(x.parameters) - (most or len(x.parameters))
    lines = [f"… and {more} parameters more"] * (more > 0)
    basis = {"noise": ", ".join(plan.columns), "truth": "; ".join(plan.truth.words)}
    facts = basis | {item.name: item.words for item in plan.estimators}
    return Sheet(title, facts=facts, tables=tables, lines=lines, notes=x.notes)


def parameter_rows(x: MonteCarlo, most: int | None = None) -> list[list[str]]:
    """Return a head and a row for each parameter and SNR: bias, std, mean stderr, coverage."""
    truth = x.plan.truth
    sizes = {n: f"{significant(truth.values[n], 4)} {truth.units[n]}" for n in x.parameters[:most]}

    def cells(r: Mapping[str, Any]) -> list[str]:
        if not r.get("runs"):
            return ["–"] * 4
        covered = "–" if r["coverage"] is None else f"{100 * r['coverage']:.0f} %"
        return [*(_relative(r, column) for column in ("bias", "std", "stderr")), covered]

    heads = [h for name in x.estimators for h in (f"{name}: bias", "std", "± mean", "covers")]
    return [["parameter", "truth", "SNR", *heads], *_study_rows(x, x.table, sizes, cells)]


def multiplier_rows(x: MonteCarlo) -> list[list[str]]:
    """Return a head and a row for each multiplier and SNR, sums last; empty without multipliers."""
    rows = x.multipliers.rows(named=True)[::-1]
    known = {r["multiplier"]: f"{significant(r['size'], 4)} {r['unit']}" for r in rows}
    sizes = {n: known[n] for n in (*x.plan.truth.multipliers, *SUMS) if n in known}

    def cells(r: Mapping[str, Any]) -> list[str]:
        return [f"{significant(r['mean'])} {r['unit']}" if r else "–"]

    head = ["multiplier", "rms of it", "SNR", *x.estimators]
    return [head, *_study_rows(x, x.multipliers, sizes, cells)] if sizes else []


def _study_rows(
    x: MonteCarlo, table: pl.DataFrame, sizes: Mapping[str, str],
    cells: Callable[[Mapping[str, Any]], list[str]],
) -> Iterator[list[str]]:  # fmt: skip
    """Yield a row a name and SNR: the name and its size in the first, the cells of estimators."""
    of = table.rows_by_key(table.columns[:3], named=True, unique=True)
    for name, size in sizes.items():
        for i, snr in enumerate(x.snr):
            row = [
                cell
                for estimator in x.estimators
                for cell in cells(of.get((estimator, snr, name), {}))
            ]
            yield [*(["", ""] if i else [shortened(name, 40), size]), f"{snr:g} dB", *row]


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


@renders(MonteCarlo, "plot")
def plot_study(x: MonteCarlo, parameters: Sequence[str] | None = None) -> Chart:
    """Draw a panel for each parameter and multiplier: median of all runs at each SNR, 5, 95 %."""
    names = list(parameters or x.parameters[:PANELS])
    drawn = set(x.errors.drop_nulls("rms")["multiplier"])
    panels = []
    for name in names:
        samples = x.samples.filter(pl.col("parameter") == name)
        truth = Level(x.plan.truth.values[name], colour=PRIOR, dashed=True)
        marks: tuple[Mark, ...] = (truth, *_quantiles(x, samples, "value"))
        panels.append(_panel(x, marks, shortened(name, 40), x.plan.truth.units[name]))
    for name in (n for n in (*x.plan.truth.multipliers, *SUMS) if n in drawn):
        samples = x.errors.filter(pl.col("multiplier") == name)
        marks, title = _quantiles(x, samples, "rms"), f"rms error of {name}"
        panels.append(_panel(x, marks, title, samples["unit"][0], logarithmic=True))
    rows = tuple(tuple(panels[i : i + ACROSS]) for i in range(0, len(panels), ACROSS))
    words = f"{x.plan.mechanism.name}: {x.runs} runs at each SNR; thin lines: the lowest and "
    words += "highest 5 % of them; dashed: the truth"
    if parameters is None and (more := len(x.parameters) - len(names)) > 0:
        words += f"; {more} parameters more are not drawn"
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
        samples = rows.filter(estimator=name).drop_nulls(column)
        known = [k for k, snr in enumerate(x.snr) if len(samples.filter(snr=snr))]
        for share, width in QUANTILES.items():
            y = [samples.filter(snr=x.snr[k])[column].quantile(share, "linear") for k in known]
            label = name if share == 0.5 else ""
            lines.append(Line(np.array(known, float), np.array(y), label, i, width, dotted=True))
    return tuple(lines)


@renders(MonteCarlo, "files")
def study_files(x: MonteCarlo, request: Request = PYTHON) -> dict[str, bytes]:
    """Return the contents of all files by name."""
    plan = x.plan
    data = {
        "schema": SCHEMA, "mechanism": plan.mechanism.name, "log": plan.log.name,
        "snr": list(x.snr), "runs": x.runs, "seed": plan.seed, "noise_on": list(plan.columns),
        "estimators": [{"name": item.name, "words": item.words} for item in plan.estimators],
        "truth": list(plan.truth.words), "parameters": x.table.to_dicts(),
        "multipliers": x.multipliers.to_dicts(), "failures": x.failures.to_dicts(),
    }  # fmt: skip
    chart = plot_study(x)
    sections = (
        Section("What noise does", study_sheet(x, None).blocks(), unfolded=True),
        understood(plan.mechanism, plan.motion),
        made_of(plan.mechanism, plan.motion, command=request.command),
    )
    title = f"{plan.mechanism.name} on {plan.log.name}: Monte Carlo"
    return {
        "montecarlo.json": json_bytes(data),
        "runs.csv": x.samples.write_csv().encode(),
        "multiplier_errors.csv": x.errors.write_csv().encode(),
        "montecarlo.png": chart.image("png"),
        "report.html": report_page(title, _headline(x), sections, [chart]),
    }


def _headline(x: MonteCarlo) -> str:
    """Return how often the last estimator's intervals hold the truth."""
    line = f"{x.runs} runs at each of {', '.join(f'{snr:g}' for snr in x.snr)} dB"
    rows = x.table.filter(pl.col("estimator") == x.estimators[-1], pl.col("coverage").is_not_null())
    coverage = rows.group_by("snr", maintain_order=True).agg(pl.col("coverage").mean()).rows()
    shares = listed([f"{100 * share:.0f} % at {snr:g} dB" for snr, share in coverage])
    words = f"With {x.estimators[-1]}, intervals of 95 % hold the truth in {shares}, over all runs."
    return f"{line}. {words}" if coverage else line
