"""Simulated runs, replays and excitations as text, charts and files."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl

from ident.display import renders
from ident.excite.excitation import Excitation, LimitUse
from ident.log import Log
from ident.show.charts import BELOW, MEASURED, RESIDUAL, Chart, Level, Line, Mark, Panel
from ident.show.html import Section, by_log, paragraph
from ident.show.sheet import Sheet
from ident.simulate.integrate import Run
from ident.simulate.replay import Replay, ReplayedLog
from ident.text import percent, shortened

TRANSITIONS = 12  # that are printed
LIMITING = 0.95  # share of a limit from which it is marked as the one that limits the motion
NEAR = 2.0  # times the largest value: a limit beyond is not drawn
CHANNELS = (("q", "position"), ("v", "speed"), ("a", "acceleration"), ("tau", "torque"))


def csv_text(log: Log) -> str:
    """Return the log as `Log.write` writes it into a .csv."""
    return pl.DataFrame({"t": log.t, **log.columns}).fill_nan(None).write_csv()


@renders(Run, "sheet")
def run_sheet(x: Run) -> Sheet:
    """Return samples, closure error, friction, and the first transitions."""
    title = (
        f"simulated {x.mechanism.name}: {len(x.t)} samples, {x.t[-1] - x.t[0]:.4g} s; "
        f"{x.evaluations} evaluations of the equations of motion"
    )
    facts = {"closure error": f"{x.closure_error:.2g}"} if x.mechanism.closures else {}
    for name, stuck in x.stuck.items():
        count = sum(each.joint == name for each in x.transitions)
        facts[f"dry friction at {name}"] = (
            f"stuck {100 * stuck.mean():.3g} % of the time, {count} changes"
        )
    lines = list(map(str, x.transitions[:TRANSITIONS]))
    more = len(x.transitions) - TRANSITIONS
    return Sheet(title, facts=facts, lines=[*lines, *([f"… {more} more"] if more > 0 else [])])


@renders(Run, "summary")
def summary(x: Run) -> str:
    """Return the same without the transitions."""
    return replace(run_sheet(x), lines=()).summary()


def _rows(x: Replay) -> list[list[str]]:
    rows = [["", "rms", "of the way"]]
    for model, logs in x.runs.items():
        for run in logs:
            title = " ".join(
                ([model] if len(x.runs) > 1 else []) + ([run.name] if len(logs) > 1 else [])
            )
            rows += [[title, "", ""]] if title else []
            for joint, error in run.errors.items():
                rms = "–" if np.isnan(error.rms) else f"{error.rms:.3g} {error.unit}"
                rows.append([joint, rms, percent(error.relative)])
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
    blocks = (paragraph(words), *sheet(x).blocks(), *by_log(logs, x.plot))
    return Section("Simulated against measured motion", blocks)


@renders(Replay, "json")
def replay_json(x: Replay) -> dict[str, Any]:
    """Return the content of `replay` of compare.json."""
    models = {name: [_data(run) for run in logs] for name, logs in x.runs.items()}
    return {"window": x.window, "models": models}


def _data(run: ReplayedLog) -> dict[str, Any]:
    return {
        "log": run.name,
        "windows": len(run.starts),
        "joints": run.errors,
        "failures": list(run.failures),
    }


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
        size = next(each for each in x.uses if each.kind == "singularity")
        facts["singular positions"] = (
            f"‖K⁺‖ reaches {x.home:.3g} times its value at home, {100 * size.share:.3g} % of its "
            "limit"
        )
    noise = ", ".join(f"{name} {value:.3g}" for name, value in x.noise.items())
    known = [each for each in x.base if each.determined]
    rows = [["base parameter", "prior", "expected ±", "unit"]]
    rows += [[shortened(b.name), f"{b.prior:.4g}", f"{b.stderr:.2g}", b.unit] for b in known]
    base = (
        f"identifies {len(known)} base parameters of {x.unknowns} unknowns; condition number "
        f"{x.condition_number:.3g}, log det {x.log_det:.4g}; with white torque noise of {noise} "
        "[N m | N] a sample:"
    )
    lines = [] if x.separation is None else [str(x.separation)]
    if lost := [f"{b.name} (± {b.stderr:.2g} {b.unit})" for b in x.base if not b.determined]:
        lines.append(f"not determined, with errors above any plausible value: {', '.join(lost)}")
    if x.without_effect:
        lines.append(f"not determined, without effect on any torque: {', '.join(x.without_effect)}")
    tables = {"use of the limits": _limits(x), base: rows}
    return Sheet(title, facts=facts, tables=tables, lines=lines, notes=x.notes)


def _limits(x: Excitation) -> list[list[str]]:
    rows = [["joint", "from", "to", "of range", "speed", "", "acceleration", "", "torque", ""]]
    uses = {(each.joint, each.kind): each for each in x.uses}
    for name in dict.fromkeys(each.joint for each in x.uses if each.joint):
        position = uses[name, "position"]
        row = [name, f"{position.low:.4g}", f"{position.high:.4g}", _share(position)]
        for kind in ("speed", "acceleration", "torque"):
            use = uses.get((name, kind))
            if use is None:
                row += ["", ""]
            else:
                row += [f"{max(-use.low, use.high):.3g} {use.unit}", _share(use)]
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
