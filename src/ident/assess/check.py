"""Whether logs can be used for identification, what looks wrong in them, what they determine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ident.assess.drives import DriveCheck, check_drives, scale_problem
from ident.equations.problem import information_of
from ident.equations.unknowns import Columns
from ident.errors import FitError
from ident.faults.channel_checks import RARE, log_findings
from ident.finding import Finding
from ident.fit.findings import POOR, excitation
from ident.fit.identify import identify
from ident.fit.shapes import initial
from ident.fit.values import absorbed_by, base_names
from ident.information.estimate import estimate
from ident.information.evidence import EXPLAINED_BELOW
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.closures import LoopSolver
from ident.motion.motion import COMMANDS
from ident.motion.unforced import unforced_base
from ident.request import Step
from ident.text import significant

COMBINED = 1e-6  # numerics: of a mass, in a sum that base parameters make
IMPOSSIBLE = 10.0  # shown: times a drive's effort limit, which is nominal in many URDFs
LIMIT_ROUNDING = 1e-6  # numerics: of positions and speeds beyond a limit
BESIDE = "with friction, rotors and offsets of all joints"  # the effects that every machine has
CONTRADICTS = "disagree with the positions"  # in a note of a motion, on its other channels


@dataclass(frozen=True)
class LogCheck:
    """Whether logs can be used for identification, and what to look at first.

    Attributes:
        mechanism: its name; logs: names of those that were checked, of some that cannot be used
            these; none without a motion.
        usable: whether parameters can be identified from them.
        rank: base parameters that they determine; able: that a lively motion determines.
        unknowns: of the mechanism; identifiable: all of that as numbers and names.
        without: torque columns that are lacking; empty: whether they are there without values.
        others: whether other logs have them.
        problems: what looks wrong, the first to be looked at; notes: these and all further ones.
        unforced: what is missing where nothing in them moves or holds a base, or has a size.
        command: word of a drive whose columns they have of all joints without a torque, or "".
        drives: what the logs say of the drives that torques are computed from.
        next: the step that goes on from here.
    """

    mechanism: str
    rank: int
    unknowns: int
    able: int = 0
    logs: tuple[str, ...] = ()
    usable: bool = False
    identifiable: Mapping[str, Any] = field(default_factory=dict)
    without: tuple[str, ...] = ()
    empty: bool = False
    others: bool = False
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    unforced: str = ""
    command: str = ""
    drives: tuple[DriveCheck, ...] = ()
    next: Step = field(default_factory=Step)


def check_logs(mechanism: Mechanism, motion: Motion | None = None) -> LogCheck:
    """Check whether logs can be used for identification; without a motion, what any could tell."""
    known = identifiable(mechanism, motion)
    rank, unknowns = known["rank"], known["unknowns"]
    if motion is None:
        return LogCheck(mechanism.name, rank, unknowns, identifiable=known, next=Step("excite"))
    wrong = data_findings(mechanism, motion)
    able = max(identifiable(mechanism)["rank"], rank)
    columns = {name for log in motion.logs for name in log.columns}
    filled = set.intersection(*map(_filled, motion.logs)) if motion.logs else set()
    without = [f"tau.{name}" for name in mechanism.measured if f"tau.{name}" not in filled]
    dead = [channel for item in wrong if item.code == "constant" for channel in item.where]
    blind = [channel.removeprefix("tau.") for channel in (*without, *dead)]
    if mechanism.closures or len(blind) == len(mechanism.measured) or len(motion.logs) > 1:
        blind = []  # only a tree can do without an equation, and not without all; or without a log
    torques = {f"tau.{name}" for name in mechanism.measured}
    lacking = [log.name for log in motion.logs if torques - _filled(log)]
    several = bool(without) and len(motion.logs) > 1
    unforced = unforced_base(mechanism, motion.experiments)
    usable = not without and bool(rank) and not unforced
    verb = "identify"
    if not usable:
        verb = "identify" if without and blind else "excite"
        if several and len(motion.logs) > len(lacking):
            verb = ""
        if not unknowns:
            verb = "diagnose"
        if unforced and not without:
            verb = ""
    joints = [channel.removeprefix("tau.") for channel in without]
    every = (word for c, word in COMMANDS.items() if {f"{c}.{j}" for j in joints} <= filled)
    command = next(every, "") if joints else ""
    drives = check_drives(mechanism, motion)
    scale = scale_problem(drives)
    problems = [scale] * bool(scale)
    problems += [*map(str, wrong), *beyond_limits(mechanism, motion), *_empty_rows(motion)]
    problems += [note for note in motion.notes if CONTRADICTS in note]
    condition = known.get("condition_number", 0.0)
    if usable and condition > POOR:
        size = significant(condition)
        problems.append(f"some are excited poorly (condition number {size})")
    notes = [*map(str, wrong), *beyond_limits(mechanism, motion), *motion.notes]
    return LogCheck(
        mechanism.name, rank, unknowns, able,
        logs=tuple(lacking if several else motion.names),
        usable=usable, identifiable=known, without=tuple(without),
        empty={*without} <= columns, others=len(motion.logs) > len(lacking),
        problems=tuple(dict.fromkeys(problems)), notes=tuple(dict.fromkeys(notes)),
        unforced=unforced, command=command,
        drives=drives,
        next=Step(verb, unmeasured=tuple(blind)) if verb else Step(),
    )  # fmt: skip


def joints_json(mechanism: Mechanism, motion: Motion | None = None) -> list[dict[str, Any]]:
    """Return by joint its state, its limits, and how far a motion takes it."""
    result = []
    for i, joint in enumerate(mechanism.joints):
        state = "driven" if joint.name in mechanism.driven else "passive"
        if joint.name.startswith("closure."):
            state = "of a closure"
        result.append({
            "joint": joint.name, "state": state, "unit": joint.unit, "lower": joint.lower,
            "upper": joint.upper, "speed_limit": joint.velocity,
        })  # fmt: skip
        if motion is not None:
            y = np.concatenate([e.y[:, i] for e in motion.experiments])
            yd = np.concatenate([e.yd[:, i] for e in motion.experiments])
            result[-1] |= {"from": y.min(), "to": y.max(), "top_speed": np.abs(yd).max()}
    return result


def beyond_limits(mechanism: Mechanism, motion: Motion) -> list[str]:
    """Return a note on the joints that a motion takes beyond the URDF's limits, and one on torques
    that no drive of it could make: their unit is another.
    """
    result, torques = list[str](), list[str]()
    for x in joints_json(mechanism, motion):
        off = LIMIT_ROUNDING + LIMIT_ROUNDING * abs(x["to"] - x["from"])
        unit, lower, upper, most = x["unit"], x["lower"], x["upper"], x["speed_limit"]
        if lower < upper and not (lower - off <= x["from"] and x["to"] <= upper + off):
            span = f"{significant(x['from'], 4)} to {significant(x['to'], 4)} {unit}"
            result.append(f"{x['joint']} {span} (limits {lower:.4g} to {upper:.4g})")
        if 0 < most < x["top_speed"] * (1 - LIMIT_ROUNDING):  # 0: not stated
            result.append(f"{x['joint']} {x['top_speed']:.3g} {unit}/s (limit {most:.3g})")
    for i, name in enumerate(mechanism.driven):
        limit, unit = mechanism.joint(name).effort, mechanism.joint(name).force_unit
        most = max(float(np.abs(e.tau[:, i]).max(initial=0.0)) for e in motion.experiments)
        if 0 < limit < most / IMPOSSIBLE:
            torques.append(f"tau.{name} {significant(most)} {unit} (limit {limit:.4g})")
    beyond = (
        f"beyond the limits of the URDF: {'; '.join(result)}: the machine must not be asked for "
        "this motion; if it was measured, check the encoder's zero, sign and scale"
    )
    above = (
        f"over {IMPOSSIBLE:g} times the effort limits of the URDF: {'; '.join(torques)}: check "
        "their units (mN m, counts, currents?), and the effort limits of the URDF"
    )
    return [beyond] * bool(result) + [above] * bool(torques)


def assembled_coordinates(mechanism: Mechanism) -> np.ndarray:
    """Return the coordinates (joints,) of the assembled mechanism."""
    names = tuple(joint.name for joint in mechanism.joints)
    return LoopSolver(mechanism, names).coordinates(mechanism.assembled[None]).value[0]


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
            hardly = (x for x in fit.checks.poor() if x.threshold == EXPLAINED_BELOW)
            return [
                *fit.health.findings,
                *(replace(x, meaning=f"{BESIDE}, {x.meaning}") for x in hardly),
            ]
    return [*log_findings(mechanism, motion)]


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
    known: dict[str, Any] = {
        "unknowns": len(columns), "rank": base.rank, "condition_number": base.condition_number,
        "base_parameters": list(base_names(columns, base)), "without_effect": nothing,
    }  # fmt: skip
    total = np.array([name.endswith(".m") for name in columns.names], dtype=float)
    if total.any() and any(chain.floating for chain in mechanism.chains):
        # w x is determined where w_D = Kᵀ w_I
        left_over = total[base.dependent] - base.K.T @ total[base.independent]
        known["total_mass"] = bool(np.abs(left_over).max(initial=0.0) < COMBINED)
    return known
