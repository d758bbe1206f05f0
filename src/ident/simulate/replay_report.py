"""Pictures, page and JSON of a replay."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from ident.fit.report import figure_html, page, table_html, text

if TYPE_CHECKING:
    from ident.simulate.replayed import Replay, Replayed

SCHEMA = "ident.replay/1"


def plot_replay(replay: Replay, experiment: int) -> Figure:
    """Measured and simulated coordinates over time, each joint's difference below."""
    first = next(iter(replay.runs.values()))[experiment]
    rows = 2 * len(first.joints)
    figure = Figure(figsize=(9, 1.2 + 1.4 * rows), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    for j, (joint, unit) in enumerate(zip(first.joints, first.units, strict=True)):
        above, below = axes[2 * j], axes[2 * j + 1]
        above.plot(first.t, first.measured[:, j], color="0.6", lw=2.5, label="measured")
        for i, (name, logs) in enumerate(replay.runs.items()):
            run, label = logs[experiment], "simulated" if len(replay.runs) == 1 else name
            above.plot(run.t, run.simulated[:, j], color=f"C{i}", lw=1.0, label=label)
            below.plot(run.t, run.simulated[:, j] - run.measured[:, j], color=f"C{i}", lw=0.8)
        above.set_ylabel(f"{joint} [{unit}]")
        below.set_ylabel(f"difference [{unit}]")
        above.grid(alpha=0.3)
        below.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    axes[-1].set_xlabel("t [s]")
    return figure


def replay_html(replay: Replay) -> bytes:
    """One file that opens without a network."""
    parts = ["<h1>Simulated against measured motion</h1>", table_html(replay.rows())]
    parts.append(
        f"<p>Restarted from the measured state every {replay.window:g} s; relative to the way "
        "from there.</p>"
    )
    for number, run in enumerate(next(iter(replay.runs.values()))):
        label = "measured and simulated coordinate of every joint"
        parts += [f"<h2>{text(run.name)}</h2>", figure_html(replay.plot(number), label)]
    if replay.notes:
        parts.append(f"<pre>{text(chr(10).join(replay.notes))}</pre>")
    return page("simulated against measured motion", parts).encode()


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
