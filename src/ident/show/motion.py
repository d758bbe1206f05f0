"""Motions as text, tables and 3-D view, and the sections of reports that say what went in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from ident.display import renders
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.show.html import (
    Section,
    definitions,
    folded,
    headed,
    in_frame,
    items,
    origin,
    strong,
    table,
)


@renders(Motion, "summary")
def summary(x: Motion) -> str:
    """Return logs, independent coordinates, bandwidth and filter, without the notes."""
    lines = [f"motion: {len(x.experiments)} experiment(s), {x.samples} samples"]
    for e in x.experiments:
        lines.append(f"  {e.name}: {len(e)} samples, {e.t[-1] - e.t[0]:.3g} s at {e.rate:.4g} Hz")
    lines.append(f"  independent: {', '.join(x.independent)}")
    lines.append(f"  bandwidth of the motion: {x.band.motion:.3g} Hz; filter: {_filter(x)}")
    if x.closure_error > 0:
        lines.append(f"  closure error: {x.closure_error:.2g}")
    return "\n".join(lines)


@renders(Motion, "text")
def text(x: Motion) -> str:
    """Return the summary and all notes."""
    return "\n".join([x.summary, *(f"  note: {note}" for note in x.notes)])


@renders(Motion, "html")
def html(x: Motion) -> str:
    """Return the logs and the filter as tables for Jupyter."""
    notes = folded("Repaired, derived or left out", items(x.notes)) if x.notes else ""
    title = f"Motion of {x.samples} samples"
    blocks = [strong(title), table(x.rows, "Logs"), definitions(_facts(x)), Markup(notes)]
    return in_frame(blocks)


def _facts(x: Motion) -> dict[str, str]:
    return {
        "Compared in": ", ".join(x.independent),
        "Bandwidth of the motion": f"{x.band.motion:.3g} Hz",
        "Zero-phase filter": _filter(x),
        "Closure error": f"{x.closure_error:.2g}" if x.closure_error > 0 else "",
    }


def _filter(x: Motion) -> str:
    return "none" if x.band.cutoff is None else f"{x.band.cutoff:.3g} Hz"


def understood(mechanism: Mechanism, motion: Motion) -> Section:
    """Return joints with their travel, closures, logs, the filter, and repairs."""
    said = {
        "Mechanism": mechanism.name,
        "Degrees of freedom": str(mechanism.degrees_of_freedom),
        "Closures": ", ".join(f"{c.name} ({c.kind})" for c in mechanism.closures) or "none",
        "Effects in the model": ", ".join(e.label for e in mechanism.effects) or "none",
        "Unknown": f"{len(mechanism.unknown)} of {len(mechanism.bodies.names)} dynamic parameters",
        **_facts(motion),
    }
    notes = [*mechanism.notes, *motion.notes]
    return Section(
        "What was understood",
        (
            definitions(said),
            table(motion.rows, "Logs"),
            table(_joints(mechanism, motion), "Joints, and how far this motion takes them"),
            *((headed("Repaired, derived or left out"), items(notes)) if notes else ()),
        ),
    )


def _joints(mechanism: Mechanism, motion: Motion) -> list[list[str]]:
    rows = [["joint", "", "from", "to", "top speed", "limits"]]
    for i, joint in enumerate(mechanism.joints):
        state = "driven" if joint.name in mechanism.driven else "passive"
        y = np.concatenate([e.y[:, i] for e in motion.experiments])
        speed = max(float(np.abs(e.yd[:, i]).max()) for e in motion.experiments)
        free = not (np.isfinite(joint.lower) or np.isfinite(joint.upper))
        limits = "–" if free else f"{joint.lower:.4g} to {joint.upper:.4g} {joint.unit}"
        ends = [f"{x:.4g} {joint.unit}" for x in (y.min(), y.max())]
        rows.append([joint.name, state, *ends, f"{speed:.3g} {joint.unit}/s", limits])
    return rows


def made_of(mechanism: Mechanism, motion: Motion, more: Sequence[Path] = ()) -> Section:
    """Return the command, the versions, and hashes of all files that went in, `more` among them."""
    files = [path for path in (mechanism.urdf, mechanism.toml) if path and path != Path()]
    return origin([*files, *more], [(log.name, log.sha256) for log in motion.logs])
