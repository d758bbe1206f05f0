"""Mechanisms, logs and motions as tables; what a motion determines; origin of a report."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.display import renders, running
from ident.equations.problem import information_of
from ident.equations.unknowns import Columns
from ident.errors import FitError, MechanismError
from ident.faults.channel_checks import RARE, log_findings
from ident.files import version
from ident.finding import Finding
from ident.fit.findings import POOR, excitation
from ident.fit.identify import identify
from ident.fit.shapes import initial
from ident.fit.values import absorbed_by, base_names
from ident.information.chance import LEAVES
from ident.information.estimate import estimate
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.closures import LoopSolver
from ident.show.card import Card, next_command
from ident.show.html import Section, Sheet, code, definitions, headed, items, paragraph, table
from ident.text import significant, some
from ident.text import table as text_table

PACKAGES = ("ident", "pin", "casadi", "numpy", "scipy", "clarabel", "bokeh")
IMPOSSIBLE = 10.0  # times a drive's effort limit, which is nominal in many URDFs
ROUNDING = 1e-6  # of positions and speeds beyond a limit
BESIDE = "with friction, rotors and offsets of all joints"  # the effects that every machine has
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


def joints_json(mechanism: Mechanism, motion: Motion | None = None) -> list[dict[str, Any]]:
    """Return by joint its state, its limits, and how far a motion takes it."""
    found = []
    for i, joint in enumerate(mechanism.joints):
        state = "driven" if joint.name in mechanism.driven else "passive"
        if joint.name.startswith("closure."):
            state = "of a closure"
        found.append({
            "joint": joint.name, "state": state, "unit": joint.unit, "lower": joint.lower,
            "upper": joint.upper, "speed_limit": joint.velocity,
        })  # fmt: skip
        if motion is not None:
            y = np.concatenate([e.y[:, i] for e in motion.experiments])
            yd = np.concatenate([e.yd[:, i] for e in motion.experiments])
            found[-1] |= {"from": y.min(), "to": y.max(), "top_speed": np.abs(yd).max()}
    return found


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


def beyond_limits(mechanism: Mechanism, motion: Motion) -> list[str]:
    """Return a note on the joints that a motion takes beyond the URDF's limits, and one on torques
    that no drive of it could make: their unit is another.
    """
    found, torques = list[str](), list[str]()
    for x in joints_json(mechanism, motion):
        off = ROUNDING + ROUNDING * abs(x["to"] - x["from"])
        unit, lower, upper, most = x["unit"], x["lower"], x["upper"], x["speed_limit"]
        if lower < upper and not (lower - off <= x["from"] and x["to"] <= upper + off):
            span = f"{significant(x['from'], 4)} to {significant(x['to'], 4)} {unit}"
            found.append(f"{x['joint']} {span} (limits {lower:.4g} to {upper:.4g})")
        if 0 < most < x["top_speed"] * (1 - ROUNDING):  # 0: not stated
            found.append(f"{x['joint']} {x['top_speed']:.3g} {unit}/s (limit {most:.3g})")
    for i, name in enumerate(mechanism.driven):
        limit, unit = mechanism.joint(name).effort, mechanism.joint(name).force_unit
        most = max(float(np.abs(e.tau[:, i]).max(initial=0.0)) for e in motion.experiments)
        if 0 < limit < most / IMPOSSIBLE:
            torques.append(f"tau.{name} {significant(most)} {unit} (limit {limit:.4g})")
    beyond = (
        f"beyond the limits of the URDF: {'; '.join(found)}: the machine must not be asked for "
        "this motion; if it was measured, check the encoder's zero, sign and scale"
    )
    above = (
        f"over {IMPOSSIBLE:g} times the effort limits of the URDF: {'; '.join(torques)}: check "
        "their units (mN m, counts, currents?), and the effort limits of the URDF"
    )
    return [beyond] * bool(found) + [above] * bool(torques)


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
        "closures": ", ".join(f"{each.name} ({each.kind})" for each in m.closures),
        "effects": ", ".join(each.label for each in m.effects) or "none",
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
        rows.append([name, str(len(x)), *([significant(each, 4) for each in size] or ["–"] * 3)])
    start, end = max(gaps, key=lambda gap: gap[1] - gap[0], default=(0.0, 0.0))
    longest = f"{len(gaps)}, longest {end - start:.3g} s at t = {start:.6g} s"
    facts = {
        "samples": f"{log.t.size} in {log.duration:.6g} s",
        "rate": f"{log.rate:.6g} Hz, jitter {jitter}",
        "columns": ", ".join(columns),
        "gaps": longest if gaps else "",
        "repairs": "; ".join(log.repairs) or "none",
    }
    return Sheet(f"Log {log.name!r}", facts=facts, details={"Columns": rows})


# --- sections of reports --------------------------------------------------------------------------


def understood(mechanism: Mechanism, motion: Motion) -> Section:
    """Return joints with their travel, closures, logs, the filter, and repairs."""
    facts = {**mechanism_sheet(mechanism).facts, **_facts(motion)}
    notes = [*mechanism.notes, *motion.notes]
    travel = table(joint_rows(mechanism, motion), "Joints, and how far this motion takes them")
    blocks = [definitions(facts), table(motion.rows, "Logs"), travel]
    blocks += [headed("Repaired, derived or left out"), items(notes)] if notes else []
    return Section("What was understood", blocks)


def made_of(mechanism: Mechanism, motion: Motion | None, more: Sequence[Path] = ()) -> Section:
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
    command = running.get()
    first = code(command) if command else paragraph("Made in Python, by no command.")
    versions = {name: version(name, "not installed") for name in PACKAGES}
    versions["Python"] = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    return Section("How to reproduce", (first, table(rows, "What went in"), definitions(versions)))


# --- what a motion determines ---------------------------------------------------------------------


def _assembled(mechanism: Mechanism) -> np.ndarray:
    """Return the coordinates (joints,) of the assembled mechanism."""
    names = tuple(joint.name for joint in mechanism.joints)
    return LoopSolver(mechanism, names).coordinates(mechanism.assembled[None]).value[0]


def check_card(
    mechanism: Mechanism, motion: Motion | None, found: Mapping[str, Any], wrong: Sequence[Finding]
) -> Card:
    """Return whether a log can be used for identification, what to look at first, and what next."""
    rank, unknowns = found["rank"], found["unknowns"]
    if motion is None:
        words = f"a motion can identify {rank} base parameters of {unknowns} unknowns"
        words = words if unknowns else "nothing is unknown, so nothing can be identified"
        return Card(f"{mechanism.name}: {words}.", command=next_command("excite"))
    able = max(identifiable(mechanism)["rank"], rank)
    size = f"{rank} of {able} base parameters"
    columns = {name for log in motion.logs for name in log.columns}
    filled = set.intersection(*map(_filled, motion.logs)) if motion.logs else set()
    without = [f"tau.{name}" for name in mechanism.measured if f"tau.{name}" not in filled]
    dead = [channel for each in wrong if each.code == "constant" for channel in each.where]
    blind = [channel.removeprefix("tau.") for channel in (*without, *dead)]
    if mechanism.closures or len(blind) == len(mechanism.measured) or len(motion.logs) > 1:
        blind = []  # only a tree can do without an equation, and not without all; or without a log
    torques = {f"tau.{name}" for name in mechanism.measured}
    lacking = [log.name for log in motion.logs if torques - _filled(log)]
    logs = some(lacking if without and len(motion.logs) > 1 else motion.names, 2)
    if without or not rank:
        why, verb, sure = "its motion determines no parameter", "excite", ""
        if without:
            values = "values of " * ({*without} <= columns)
            why = f"it has no {values}{some(without)}; with them it would determine {size}"
        if without and len(motion.logs) > len(lacking):
            verb, sure = "", "Leave this log out, or map the columns of its torques in [log]."
        if without and blind:
            verb, sure = "identify", "Without a sensor, leave out the equation of the joint:"
        if not unknowns:
            why, verb, sure = "nothing is unknown in the model", "diagnose", ""
        line = f"{logs} cannot be used for identification: {why}."
        return Card(line, sure, command=next_command(verb, unmeasured=blind) if verb else "")
    problems = [*map(str, wrong), *beyond_limits(mechanism, motion), *_empty_rows(motion)]
    if (condition := found["condition_number"]) > POOR:
        problems.append(f"some are excited poorly (condition number {significant(condition)})")
    look = f", but look at this first: {problems[0]}" if problems else ": nothing looks wrong in it"
    line = f"{logs} can be used for identification of {size}{look}."
    return Card(line, command=next_command("identify", unmeasured=blind))


def _filled(log: Log) -> set[str]:
    """Return the columns of a log that have a value."""
    return {name for name, x in log.columns.items() if not np.isnan(x).all()}


def _empty_rows(motion: Motion) -> Iterator[str]:
    """Yield notes on logs with rows that have no value but their time."""
    for log in motion.logs:
        empty = np.isnan([*log.columns.values()]).all(axis=0)
        if empty.mean() > RARE:
            first = log.t[empty.argmax()]
            yield (
                f"{log.name}: {empty.sum()} of {len(log.t)} rows have no value but their time, the "
                f"first at t = {first:.6g} s"
            )


def check_text(mechanism: Mechanism, motion: Motion | None = None) -> str:
    """Return whether a log can be used, joints, what was measured, and what it identifies."""
    found = identifiable(mechanism, motion)
    wrong = data_findings(mechanism, motion)
    column = ["assembled", *(f"{x:.4g}" for x in _assembled(mechanism))]
    rows = zip(joint_rows(mechanism, motion), column, strict=True)
    joints = text_table([[*row, cell] for row, cell in rows])
    card = check_card(mechanism, motion, found, wrong)
    parts = [card.text(), [str(mechanism), *joints]]
    if start := mechanism.found_start:
        values = ", ".join(f'"{name}" = {value:g}' for name, value in start.items())
        parts.append([f"the loops close at, to keep in mechanism.toml: start = {{ {values} }}"])
    if motion is not None:
        notes = *map(str, wrong), *beyond_limits(mechanism, motion)
        parts += [[f"note: {each}"] for each in notes if each not in card.line]
        parts += [[str(motion)], [CHANNELS, *text_table(_channels(mechanism, motion))]]
    texts = map("\n".join, parts)
    return "\n\n".join([*texts, structure(found, motion is not None)])


def data_findings(mechanism: Mechanism, motion: Motion | None) -> list[Finding]:
    """Return what looks wrong in logged data: in channels by themselves, and, where all torques are
    measured, beside a fit with the effects that every machine has.
    """
    if motion is None:
        return []
    torques = [f"tau.{name}" for name in mechanism.measured]
    measured = all(_filled(log) >= {*torques} for log in motion.logs)
    if measured and motion.experiments and mechanism.unknown:
        model = mechanism
        for effect in mechanism.candidates(motion.experiments[0].logged):
            model = model + effect if effect.common else model
        with suppress(FitError):
            fit = identify(model, motion, estimator="least-squares")
            hardly = (x for x in fit.checks.poor() if x.threshold == LEAVES)
            return [
                *fit.health.findings,
                *(replace(x, meaning=f"{BESIDE}, {x.meaning}") for x in hardly),
            ]
    return [*log_findings(mechanism, motion)]


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


def structure(found: Mapping[str, Any], moved: bool) -> str:
    """Return which base parameters a motion identifies, or could at best where none was `moved`."""
    if not found["unknowns"]:
        return "nothing is unknown"
    what = "this motion identifies" if moved else "a motion can identify"
    lines = [
        f"{what} {found['rank']} base parameters of {found['unknowns']} unknowns "
        f"(condition number {significant(found['condition_number'])}):",
        *(f"  {name}" for name in found["base_parameters"]),
    ]
    if nothing := found["without_effect"]:
        lines.append(f"without effect on any torque: {', '.join(nothing)}")
    return "\n".join(lines)


def identifiable(mechanism: Mechanism, motion: Motion | None = None) -> dict[str, Any]:
    """Return the base parameters of a motion, of a lively one if none is given."""
    columns = Columns.of(mechanism)
    if not len(columns):
        return {"unknowns": 0, "rank": 0, "base_parameters": []}
    motion = motion or excitation(mechanism)
    information = information_of(mechanism, columns, motion, initial(mechanism, motion))
    ones = np.ones(information.d)
    base = estimate(information.totals, columns.prior, ones, sigma=ones).base
    nothing = [name for name, carrier in absorbed_by(columns, base).items() if not carrier]
    return {
        "unknowns": len(columns), "rank": base.rank, "condition_number": base.condition_number,
        "base_parameters": list(base_names(columns, base)), "without_effect": nothing,
    }  # fmt: skip


def check_json(mechanism: Mechanism, motion: Motion | None = None) -> dict[str, Any]:
    """Return what `ident check` shows."""
    joints = zip(joints_json(mechanism, motion), _assembled(mechanism), strict=True)
    logs = [] if motion is None else motion.experiments
    return {
        "schema": "ident.check/1",
        "mechanism": mechanism.name,
        "degrees_of_freedom": mechanism.degrees_of_freedom,
        "joints": [{**joint, "assembled": at} for joint, at in joints],
        "closures": [{"name": each.name, "kind": each.kind} for each in mechanism.closures],
        "effects": [each.label for each in mechanism.effects],
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
        "identifiable": identifiable(mechanism, motion),
        "notes": [
            *mechanism.notes,
            *map(str, data_findings(mechanism, motion)),
            *((*beyond_limits(mechanism, motion), *motion.notes) if motion else ()),
        ],
    }  # fmt: skip
