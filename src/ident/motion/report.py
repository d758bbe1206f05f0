"""What was understood of a mechanism and its logs, and what a report was made of, as sections."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.motion.motion import Motion
from ident.show.html import Section, definitions, headed, items, origin, table


def understood(mechanism: Mechanism, motion: Motion) -> Section:
    """Joints with the way they went, closures, logs, the filter, and what was repaired."""
    cut = motion.band.cutoff
    said = {
        "Mechanism": mechanism.name,
        "Degrees of freedom": str(mechanism.degrees_of_freedom),
        "Closures": ", ".join(f"{c.name} ({c.kind})" for c in mechanism.closures) or "none",
        "Effects in the model": ", ".join(e.label for e in mechanism.effects) or "none",
        "Unknown": f"{len(mechanism.unknown)} of {len(mechanism.bodies.names)} dynamic parameters",
        "Compared in": ", ".join(motion.independent),
        "Bandwidth of the motion": f"{motion.band.motion:.3g} Hz",
        "Zero-phase filter": "none" if cut is None else f"{cut:.3g} Hz",
        "Closure error": f"{motion.closure_error:.2g}" if motion.closure_error > 0 else "",
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
    """The command, the versions, and hashes of all files that went in, `more` among them."""
    files = [path for path in (mechanism.urdf, mechanism.toml) if path and path != Path()]
    return origin([*files, *more], [(log.name, log.sha256) for log in motion.logs])
