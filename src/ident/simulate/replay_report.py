"""Pictures, page and JSON of a replay."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.residual.report import by_log
from ident.show.charts import MEASURED, Chart, Level, Line, Panel
from ident.show.html import Page, Section, items, paragraph, table

if TYPE_CHECKING:
    from ident.simulate.replayed import Replay, Replayed

SCHEMA = "ident.replay/1"


def plot_replay(replay: Replay, experiment: int) -> Chart:
    """Measured and simulated coordinates over time, each joint's difference below."""
    first = next(iter(replay.runs.values()))[experiment]
    rows = []
    for j, (joint, unit) in enumerate(zip(first.joints, first.units, strict=True)):
        above = [Line(first.t, first.measured[:, j], "measured", MEASURED, 2.4)]
        below = []
        for i, (name, logs) in enumerate(replay.runs.items()):
            run, label = logs[experiment], "simulated" if len(replay.runs) == 1 else name
            above.append(Line(run.t, run.simulated[:, j], label, i))
            below.append(Line(run.t, run.simulated[:, j] - run.measured[:, j], "", i, 0.8))
        rows.append((Panel(tuple(above), "t [s]", f"{joint} [{unit}]", height=1.8),))
        rows.append((Panel((Level(), *below), "t [s]", f"difference [{unit}]", height=1.4),))
    words = f"Measured and simulated coordinate of every joint over time, {first.name}"
    return Chart(words, tuple(rows), shared_x=True, clock=first.name)


def replay_html(replay: Replay) -> bytes:
    """One file that opens without a network."""
    words = (
        f"Restarted from the measured state every {replay.window:g} s; relative to the way from "
        "there."
    )
    logs = [run.name for run in next(iter(replay.runs.values()))]
    sections = (
        Section("Error of the motion", (paragraph(words), table(replay.rows(), "By joint"))),
        Section("Measured against simulated", by_log(logs, replay.plot)),
        Section("Warnings", (items(replay.notes),) if replay.notes else ()),
    )
    return Page("Simulated against measured motion", ", ".join(replay.runs), sections).html()


def replay_json(replay: Replay) -> bytes:
    """The same as data."""
    models = {name: [_run(run) for run in logs] for name, logs in replay.runs.items()}
    content = {"schema": SCHEMA, "window": replay.window, "models": models}
    return json.dumps(content, indent=1, ensure_ascii=False).encode() + b"\n"


def _run(run: Replayed) -> dict[str, Any]:
    errors, within = run.errors, run.within
    joints = {
        joint: {
            "rms": None if np.isnan(error.rms) else error.rms,
            "relative": error.relative,
            "unit": error.unit,
            "within": within[joint],
        }
        for joint, error in errors.items()
    }
    return {
        "log": run.name,
        "windows": len(run.starts),
        "without_restarts": run.lasted,
        "joints": joints,
        "failures": list(run.failures),
    }
