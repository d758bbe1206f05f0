"""Motions as text, tables and 3-D view; what a motion determines; what went into a report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ident.display import renders
from ident.equations.unknowns import Columns
from ident.fit.determined import excitation
from ident.fit.problem import information_of
from ident.fit.shapes import initial
from ident.fit.values import absorbed_by, base_names
from ident.information.estimate import estimate
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.closures import LoopSolver
from ident.show.html import Section, definitions, headed, items, origin, table
from ident.show.sheet import Sheet
from ident.text import table as text_table


@renders(Motion, "sheet")
def sheet(x: Motion) -> Sheet:
    """Return the logs, and how the motion was smoothed and filtered."""
    return Sheet(
        f"motion of {x.samples} samples", facts=_facts(x), tables={"Logs": x.rows}, notes=x.notes
    )


@renders(Motion, "summary")
def summary(x: Motion) -> str:
    """Return the same without the notes."""
    return sheet(x).summary()


def _facts(x: Motion) -> dict[str, str]:
    return {
        "independent": ", ".join(x.independent),
        "bandwidth of the motion": f"{x.band.motion:.3g} Hz",
        "zero-phase filter": "none" if x.band.cutoff is None else f"{x.band.cutoff:.3g} Hz",
        "closure error": f"{x.closure_error:.2g}" if x.closure_error > 0 else "",
    }


def joint_rows(mechanism: Mechanism, motion: Motion | None = None) -> list[list[str]]:
    """Return a row a joint: its state, its limits, and how far a motion takes it."""
    rows = [["joint", "", "unit", "lower", "upper"]]
    if motion is not None:
        rows[0] += ["from", "to", "top speed"]
    for i, joint in enumerate(mechanism.joints):
        state = "driven" if joint.name in mechanism.driven else "passive"
        if joint.name.startswith("closure."):
            state = "of a closure"
        ends = ("–" if np.isinf(x) else f"{x:.4g}" for x in (joint.lower, joint.upper))
        rows.append([joint.name, state, joint.unit, *ends])
        if motion is not None:
            y, yd = (
                np.concatenate([getattr(e, name)[:, i] for e in motion.experiments])
                for name in ("y", "yd")
            )
            rows[-1] += [f"{y.min():.4g}", f"{y.max():.4g}", f"{np.abs(yd).max():.3g}/s"]
    return rows


# --- sections of reports --------------------------------------------------------------------------


def understood(mechanism: Mechanism, motion: Motion) -> Section:
    """Return joints with their travel, closures, logs, the filter, and repairs."""
    facts = {
        "Mechanism": mechanism.name,
        "Degrees of freedom": str(mechanism.degrees_of_freedom),
        "Closures": ", ".join(f"{c.name} ({c.kind})" for c in mechanism.closures) or "none",
        "Effects in the model": ", ".join(e.label for e in mechanism.effects) or "none",
        "Unknown": f"{len(mechanism.unknown)} of {len(mechanism.bodies.names)} dynamic parameters",
        **{key.capitalize(): value for key, value in _facts(motion).items()},
    }
    notes = [*mechanism.notes, *motion.notes]
    return Section(
        "What was understood",
        (
            definitions(facts),
            table(motion.rows, "Logs"),
            table(joint_rows(mechanism, motion), "Joints, and how far this motion takes them"),
            *((headed("Repaired, derived or left out"), items(notes)) if notes else ()),
        ),
    )


def made_of(mechanism: Mechanism, motion: Motion, more: Sequence[Path] = ()) -> Section:
    """Return the command, the versions, and hashes of all files that went in, `more` among them."""
    files = [path for path in (mechanism.urdf, mechanism.toml) if path and path != Path()]
    return origin([*files, *more], [(log.name, log.sha256) for log in motion.logs])


# --- what a motion determines ---------------------------------------------------------------------


def describe(mechanism: Mechanism, motion: Motion | None = None) -> str:
    """Return joints with limits, assembled positions, and how far a motion moves them."""
    names = tuple(joint.name for joint in mechanism.joints)
    assembled = LoopSolver(mechanism, names).coordinates(mechanism.assembled[None]).value[0]
    column = ["assembled", *(f"{x:.4g}" for x in assembled)]
    rows = joint_rows(mechanism, motion)
    rows = [[*row, cell] for row, cell in zip(rows, column, strict=True)]
    return "\n".join([str(mechanism), *text_table(rows)])


def channels(mechanism: Mechanism, motion: Motion) -> str:
    """Return what was done to every measured channel of the motion.

    Its estimated white noise, and the rms of measured less smoothed: equal
    where the channels agree with each other, the closures and the resolution of the splines.
    """
    units = {"q": "", "v": "/s", "a": "/s²"}
    rows = [["channel", "noise", "residual", "unit", "", "log"]]
    for e in motion.experiments:
        for x in e.channels:
            letter, joint = x.column.split(".", 1)
            unit = mechanism.joint(joint).unit + units[letter]
            rest = f"{x.residual:.3g}" if x.spacing else "–"
            rows.append([x.column, f"{x.noise:.3g}", rest, unit, x.how, e.name])
    title = "what was measured of the motion: its white noise, and measured less smoothed (rms)"
    return "\n".join([title, *text_table(rows)])


def structure(mechanism: Mechanism, motion: Motion | None = None) -> str:
    """Return which base parameters a motion identifies, or could at best if none is given."""
    columns = Columns.of(mechanism)
    if not len(columns):
        return "nothing is unknown"
    what = "this motion identifies" if motion else "a motion can identify"
    motion = motion or excitation(mechanism)
    information = information_of(mechanism, columns, motion, initial(mechanism, motion))
    ones = np.ones(information.d)
    base = estimate(information.totals, columns.prior, ones, sigma=ones).base
    lines = [
        f"{what} {base.rank} base parameters of {len(columns)} unknowns "
        f"(condition number {base.condition_number:.3g}):"
    ]
    lines += [f"  {name}" for name in base_names(columns, base)]
    nothing = [name for name, carrier in absorbed_by(columns, base).items() if not carrier]
    if nothing:
        lines.append(f"without effect on any torque: {', '.join(nothing)}")
    return "\n".join(lines)
