"""Mechanisms, logs and motions as tables; what a motion determines; origin of a report."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ident.assess.check import (
    LogCheck,
    assembled_coordinates,
    beyond_limits,
    data_findings,
    joints_json,
)
from ident.assess.drives import drive_rows
from ident.display import renders
from ident.errors import MechanismError
from ident.files import version
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.request import PYTHON, Request
from ident.show.card import Card
from ident.show.html import Section, Sheet, code, definitions, headed, items, paragraph, table
from ident.text import shortlist, significant
from ident.text import table as text_table

PACKAGES = ("ident", "pin", "casadi", "numpy", "scipy", "clarabel", "bokeh")
CHANNELS = "what was measured of the motion: its white noise, and measured less smoothed (rms)"


@renders(Motion, "sheet")
def sheet(x: Motion) -> Sheet:
    """Return the logs, and how the motion was smoothed and filtered."""
    return Sheet(
        f"motion of {x.samples} samples", facts=_facts(x), tables={"Logs": x.rows}, notes=x.notes
    )


def _facts(x: Motion) -> dict[str, str]:
    return {
        "independent": ", ".join(x.independent),
        "bandwidth of the motion": f"{x.band.motion:.3g} Hz",
        "zero-phase filter": "none" if x.band.cutoff is None else f"{x.band.cutoff:.3g} Hz",
        "closure error": f"{x.closure_error:.2g}" if x.closure_error > 0 else "",
    }


def joint_rows(mechanism: Mechanism, motion: Motion | None = None) -> list[list[str]]:
    """Return the same as a table."""
    rows = [["joint", "", "unit", "lower", "upper", "speed limit"]]
    if motion is not None:
        rows[0] += ["from", "to", "top speed"]
    for x in joints_json(mechanism, motion):
        limits = ("lower", "upper", "speed_limit")
        ends = ("–" if np.isinf(x[end]) else significant(x[end], 4) for end in limits)
        rows.append([x["joint"], x["state"], x["unit"], *ends])
        if motion is not None:
            rows[-1] += [significant(x[end], 4) for end in ("from", "to")]
            rows[-1].append(f"{x['top_speed']:.3g} {x['unit']}/s")
    return rows


# --- mechanisms ---------------------------------------------------------------------------------


@renders(Mechanism, "sheet")
def mechanism_sheet(m: Mechanism) -> Sheet:
    """Return the parts of a mechanism."""
    try:
        freedom = f"of rank {m.rank}, {m.degrees_of_freedom} degrees of freedom"
    except MechanismError as error:  # what cannot be assembled can still be printed
        freedom = f"that do not close: {error}"
    closures = f"{len(m.kinematics.multipliers)} closure equations {freedom}"
    facts = {
        "driven": ", ".join(m.driven) or "none",
        "passive": ", ".join(m.passive) or "none",
        "closures": ", ".join(f"{part.name} ({part.kind})" for part in m.closures),
        "effects": ", ".join(part.label for part in m.effects) or "none",
        "unknown": f"{len(m.unknown)} of {len(m.bodies.names)} dynamic parameters",
    }
    title = f"mechanism {m.name}: {m.model.nv} coordinates, {closures}"
    return Sheet(title, facts=facts, details={"joints": joint_rows(m)}, notes=m.notes)


# --- logs ---------------------------------------------------------------------------------------


@renders(Log, "sheet")
def log_sheet(log: Log) -> Sheet:
    """Return samples, rate, columns, gaps and repairs."""
    largest, rms = log.jitter
    gaps = log.gaps()
    # below a nanosecond it is the rounding of t
    jitter = f"{1e3 * largest:.3g} ms max, {1e3 * rms:.3g} ms rms" if largest > 1e-9 else "none"
    columns, rows = list[str](), [["column", "samples", "from", "to", "rms"]]
    for name in log.columns:
        _, x = log.series(name)
        columns.append(name if len(x) == log.t.size else f"{name} ({len(x)} samples)")
        size = (x.min(), x.max(), np.sqrt(np.mean(x**2))) if len(x) else ()
        rows.append([name, str(len(x)), *([significant(value, 4) for value in size] or ["–"] * 3)])
    start, end = max(gaps, key=lambda gap: gap[1] - gap[0], default=(0.0, 0.0))
    longest = f"{len(gaps)}, longest {end - start:.3g} s at t = {start:.6g} s"
    moving = {
        "samples": f"{log.t.size} in {log.duration:.6g} s",
        "rate": f"{log.rate:.6g} Hz, jitter {jitter}",
    }
    facts = {
        **({"samples": _size(log)} if log.poses else moving),
        "columns": ", ".join(columns),
        "gaps": longest if gaps else "",
        "repairs": "; ".join(log.repairs) or "none",
    }
    return Sheet(f"Log {log.name!r}", facts=facts, details={"Columns": rows})


def _size(log: Log) -> str:
    """Return how much a log has, in words."""
    return f"{log.t.size} " + ("poses at rest" if log.poses else f"samples at {log.rate:.6g} Hz")


# --- sections of reports --------------------------------------------------------------------------


def understood(mechanism: Mechanism, motion: Motion) -> Section:
    """Return joints with their travel, closures, logs, the filter, and repairs."""
    facts = {**mechanism_sheet(mechanism).facts, **_facts(motion)}
    notes = [*mechanism.notes, *motion.notes]
    travel = table(joint_rows(mechanism, motion), "Joints, and how far this motion takes them")
    blocks = [definitions(facts), table(motion.rows, "Logs"), travel]
    blocks += [headed("Repaired, derived or left out"), items(notes)] if notes else []
    return Section("What was understood", blocks)


def made_of(
    mechanism: Mechanism, motion: Motion | None, more: Sequence[Path] = (), command: str = ""
) -> Section:
    """Return how to reproduce a result: command, versions, and hashes of files, logs and `more`."""
    files = [path for path in (mechanism.urdf, mechanism.toml) if path and path != Path()]
    rows = [["file", "SHA-256"]]
    for file in (*files, *more):
        try:
            with file.open("rb") as stream:
                rows.append([file.name, hashlib.file_digest(stream, "sha256").hexdigest()])
        except OSError:
            rows.append([file.name, "no longer there"])
    rows += [[x.name, x.sha256 or "made in memory"] for x in (motion.logs if motion else ())]
    first = code(command) if command else paragraph("Made in Python, by no command.")
    versions = {name: version(name, "not installed") for name in PACKAGES}
    versions["Python"] = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    return Section("How to reproduce", (first, table(rows, "What went in"), definitions(versions)))


# --- what a motion determines ---------------------------------------------------------------------


def check_card(check: LogCheck, request: Request = PYTHON) -> Card:
    """Return whether a log can be used for identification, what to look at first, and what next."""
    name, size = check.mechanism, f"{check.rank} of {check.able} base parameters"
    command = request.line(check.next)
    if not check.logs:
        words = f"a motion can identify {check.rank} base parameters of {check.unknowns} unknowns"
        words = words if check.unknowns else "nothing is unknown, so nothing can be identified"
        return Card(f"{name}: {words}.", command=command, step=check.next)
    logs = shortlist(check.logs, 2)
    if check.usable:
        line = f"{logs} can be used for identification of {size}: no channel looks wrong."
        if check.problems:
            line = f"{logs}: look at this first: {check.problems[0]}. It would determine {size}."
        return Card(line, command=command, step=check.next)
    why = "nothing is unknown in the model"
    if check.without:
        values = "values of " * check.empty
        why = f"it has no {values}{shortlist(check.without)}; with them it would determine {size}"
    elif check.unforced:
        why = check.unforced.partition(": ")[2]
    elif check.unknowns:
        why = "its motion determines no parameter"
    sure = ""
    if check.command:
        sure = f"It has the drives' commands: compute torques from them, --drive {check.command}."
    elif check.without and check.others:
        sure = "Leave this log out, or map the columns of its torques in [log]."
    elif check.without and check.next.verb == "identify":
        sure = "Without a sensor, leave out the equation of the joint:"
    line = f"{logs} cannot be used for identification: {why}."
    return Card(line, sure, command=command, step=check.next)


def check_text(
    check: LogCheck,
    mechanism: Mechanism,
    motion: Motion | None = None,
    request: Request = PYTHON,
    *,
    verbose: bool = True,
) -> str:
    """Return whether a log can be used, joints and columns, and how much it identifies; `verbose`:
    with the channels, all notes and the base parameters.
    """
    column = ["assembled", *(f"{x:.4g}" for x in assembled_coordinates(mechanism))]
    rows = zip(joint_rows(mechanism, motion), column, strict=True)
    joints = text_table([[*row, cell] for row, cell in rows])
    card = check_card(check, request)
    of_mechanism = () if verbose else mechanism.notes  # its own text has them
    every = dict.fromkeys([*of_mechanism, *check.notes])
    notes = [f"note: {item}" for item in every if item not in card.line]
    if not verbose and len(notes) > 1:
        first = notes[0].removeprefix("note: ")
        notes = [f"note: {len(notes)} notes, the first: {first}; --verbose shows them"]
    parts = [card.text(), [str(mechanism) if verbose else mechanism_line(mechanism), *joints]]
    if start := mechanism.found_start:
        values = ", ".join(f'"{name}" = {value:g}' for name, value in start.items())
        parts.append([f"the loops close at, to keep in mechanism.toml: start = {{ {values} }}"])
    parts += [[note] for note in notes]
    if check.drives:
        parts.append(text_table(drive_rows(check.drives)))
        parts += [[f"note: {words}"] for drive in check.drives for words in drive.apart]
    if motion is not None:
        channels = [CHANNELS, *text_table(_channels(mechanism, motion))]
        columns = [f"{log.name}: {_size(log)}; {', '.join(log.columns)}" for log in motion.logs]
        parts += [[str(motion)], channels] if verbose else [columns]
    texts = map("\n".join, parts)
    return "\n\n".join([*texts, structure(check.identifiable, motion is not None, verbose)])


def mechanism_line(m: Mechanism) -> str:
    """Return the parts of a mechanism, without its notes."""
    return mechanism_sheet(m).summary()


def _channels(mechanism: Mechanism, motion: Motion) -> list[list[str]]:
    """Return the noise of each channel, and the rms of measured less smoothed."""
    units = {"q": "", "v": "/s", "a": "/s²"}
    rows = [["channel", "noise", "residual", "unit", "", "log"]]
    for e in motion.experiments:
        for x in e.channels:
            letter, joint = x.column.split(".", 1)
            unit = mechanism.joint(joint).unit + units[letter]
            rest = significant(x.residual) if x.spacing else "–"
            rows.append([x.column, significant(x.noise), rest, unit, x.how, e.name])
    return rows


def structure(identifiable: Mapping[str, Any], has_motion: bool, verbose: bool = True) -> str:
    """Return how many base parameters a motion identifies, or could at best where none was `moved`;
    `verbose`: which.
    """
    if not identifiable["unknowns"]:
        return "nothing is unknown"
    what = "this motion identifies" if has_motion else "a motion can identify"
    line = (
        f"{what} {identifiable['rank']} base parameters of {identifiable['unknowns']} unknowns "
        f"(condition number {significant(identifiable['condition_number'])})"
    )
    if not identifiable.get("total_mass", True):
        line += "; the total mass is not among what is determined: what holds the base takes it"
    if not verbose:
        return f"{line}; --verbose names them"
    lines = [f"{line}:", *(f"  {name}" for name in identifiable["base_parameters"])]
    if nothing := identifiable["without_effect"]:
        lines.append(f"without effect on any torque: {', '.join(nothing)}")
    return "\n".join(lines)


def check_json(
    check: LogCheck, mechanism: Mechanism, motion: Motion | None = None
) -> dict[str, Any]:
    """Return what `ident check` shows, of a check of this mechanism and motion."""
    joints = zip(joints_json(mechanism, motion), assembled_coordinates(mechanism), strict=True)
    logs = [] if motion is None else motion.experiments
    return {
        "schema": "ident.check/1",
        "mechanism": mechanism.name,
        "degrees_of_freedom": mechanism.degrees_of_freedom,
        "joints": [{**joint, "assembled": at} for joint, at in joints],
        "closures": [{"name": part.name, "kind": part.kind} for part in mechanism.closures],
        "effects": [part.label for part in mechanism.effects],
        "start": mechanism.found_start,
        "logs": [
            {
                "log": e.name, "samples": len(e), "used": int(e.usable.sum()), "rate": e.rate,
                "channels": [
                    {"column": x.column, "noise": x.noise, "residual": x.residual}
                    for x in e.channels
                ],
            }
            for e in logs
        ],
        "cutoff": None if motion is None else motion.band.cutoff,
        "drives": [drive.json() for drive in check.drives],
        "identifiable": dict(check.identifiable),
        "notes": [
            *mechanism.notes,
            *map(str, data_findings(mechanism, motion)),
            *((*beyond_limits(mechanism, motion), *motion.notes) if motion else ()),
        ],
    }  # fmt: skip
