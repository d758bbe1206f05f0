"""Simulated runs and replays as text, charts and files."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import polars as pl

from ident.display import renders
from ident.files import json_bytes
from ident.log import Log
from ident.show.charts import MEASURED, Chart, Level, Line, Panel
from ident.show.html import Page, Section, by_log, items, paragraph
from ident.show.html import table as html_table
from ident.show.sheet import Sheet
from ident.simulate.integrate import Run
from ident.simulate.replay import Replay, ReplayedLog
from ident.text import percent

TRANSITIONS = 12  # that are printed
SCHEMA = "ident.replay/1"


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
        above = [Line(first.t, first.measured[:, j], "measured", MEASURED, 2.4)]
        below = []
        for i, (name, logs) in enumerate(x.runs.items()):
            run, label = logs[experiment], "simulated" if len(x.runs) == 1 else name
            above.append(Line(run.t, run.simulated[:, j], label, i))
            below.append(Line(run.t, run.simulated[:, j] - run.measured[:, j], "", i, 0.8))
        rows.append((Panel(tuple(above), "t [s]", f"{joint} [{unit}]", height=1.8),))
        rows.append((Panel((Level(), *below), "t [s]", f"difference [{unit}]", height=1.4),))
    words = f"Measured and simulated coordinate of every joint over time, {first.name}"
    return Chart(words, tuple(rows), shared_x=True, clock=first.name)


@renders(Replay, "files")
def files(x: Replay) -> dict[str, bytes]:
    """Return the page and the data by file name."""
    words = (
        f"Restarted from the measured state every {x.window:g} s; relative to the way from there."
    )
    logs = [run.name for run in next(iter(x.runs.values()))]
    sections = (
        Section("Error of the motion", (paragraph(words), html_table(_rows(x), "By joint"))),
        Section("Measured against simulated", by_log(logs, x.plot)),
        Section("Warnings", (items(x.notes),) if x.notes else ()),
    )
    page = Page("Simulated against measured motion", ", ".join(x.runs), sections)
    return {"replay.html": page.html(), "replay.json": json_bytes(replay_json(x))}


def replay_json(x: Replay) -> dict[str, Any]:
    """Return the content of replay.json."""
    models = {name: [_data(run) for run in logs] for name, logs in x.runs.items()}
    return {"schema": SCHEMA, "window": x.window, "models": models}


def _data(run: ReplayedLog) -> dict[str, Any]:
    return {
        "log": run.name,
        "windows": len(run.starts),
        "joints": {joint: asdict(error) for joint, error in run.errors.items()},
        "failures": list(run.failures),
    }
