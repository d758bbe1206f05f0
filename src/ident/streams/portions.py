"""From logs that need not fit into memory to triangles: a plan, its portions, and their sum.

    portion → motion → rows → one triangle a (log, block of time, coordinate),   triangles add

A log of one portion decides by itself what `complete` decides: its clock, smoothing, standstill. A
longer log decides once for all of its portions, on some stretches of it. What several logs share
(the filter, the joints in which errors count, the working point) is decided on an excerpt.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from ident.equations.corrections import Scene
from ident.equations.filter import Decimator
from ident.equations.rows import row_supports, rows
from ident.equations.unknowns import Columns, Point
from ident.errors import FitError, MotionError, one_of
from ident.fit.channel_checks import log_findings
from ident.fit.findings import Finding
from ident.fit.prediction import predict
from ident.fit.problem import block_edges, triangles
from ident.information.blocks import Block, summed
from ident.log import Log
from ident.log.read import names_of
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.closures import LoopSolver
from ident.motion.motion import decide, left_out, part_of, state_of
from ident.motion.recipe import Band, standstill
from ident.motion.signals import absurd_samples, measure
from ident.motion.smoothing import derive
from ident.motion.state import State
from ident.pool import Workers
from ident.streams.logs import LogOnDisk, summarise
from ident.streams.stream import margin_of

KNOTS = 40  # from a sample to another whose noise moves a spline there by 1e-7 of itself
MEMORY = 4096  # samples after which an effect has forgotten where its memory began
FEWEST = 64  # samples of a margin: what is interpolated reaches no farther
THINNED = 8  # samples of which one is followed to know the branch of the closures


@dataclass(frozen=True)
class Portion:
    """A stretch of one log, with margins on both sides."""

    log: int  # number of the log
    number: int  # of the portion in the log
    begin: int  # first row that is read
    end: int
    since: float  # [s] from which samples count in this portion and in no other
    until: float


@dataclass(frozen=True, eq=False)
class Plan:
    """Settings that all portions have in common."""

    mechanism: Mechanism  # that is identified
    logged: tuple[str, ...]  # joints that determine the motion
    independent: tuple[str, ...]  # those in which errors count
    band: Band  # with the cut-off of the rows' filter
    smoothing: float | str | None  # as it was asked for
    parts: tuple[LogOnDisk, ...]  # one a log
    point: Point  # values of all parameters, at which what is not linear is evaluated

    @property
    def columns(self) -> Columns:
        """The unknowns."""
        return Columns.of(self.mechanism)

    def margin(self, part: LogOnDisk) -> int:
        """Return how many rows beside a portion its filter, splines, delays, memory depend on."""
        clock, recipe = part.clock, part.recipe
        samples = Decimator.of(self.band.cutoff, 1 / clock.step).half + FEWEST
        if recipe is not None:
            samples += int(np.ceil((KNOTS * recipe.knots + recipe.ends) / clock.step))
        if any(effect.memory for effect in self.mechanism.effects):
            samples += MEMORY
        samples += margin_of(self.mechanism, 1 / clock.step, self.band.cutoff)
        return int(np.ceil(samples * max(1.0, part.file.rows / clock.count)))

    def portions(self, log: int | None = None) -> Iterator[Portion]:
        """Yield all portions in order of log and time, or those of one log."""
        for i, part in enumerate(self.parts):
            if log not in (None, i):
                continue
            every = Decimator.of(self.band.cutoff, 1 / part.clock.step).factor
            margin, rows, at = self.margin(part), part.file.rows, part.at
            for k, (first, stop) in enumerate(pairwise(part.borders)):
                yield Portion(
                    log=i,
                    number=k,
                    begin=max(0, (first - margin) // every * every),  # one grid of rows for the log
                    end=min(rows, stop + margin),
                    since=at(first) if first else -np.inf,
                    until=at(stop) if stop < rows else np.inf,
                )


def summaries(mechanism: Mechanism, paths: Sequence[Path], workers: Workers) -> list[LogOnDisk]:
    """Look at all logs that can be opened and give them names that differ."""
    names = names_of(paths)
    done = workers.over(summarise, paths, mechanism, names, "looking at the logs")
    opened = [
        replace(log, file=replace(log.file, name=name))
        for name, (_, log) in zip(names, done, strict=True)
        if log is not None
    ]
    _check_some(mechanism, workers, opened)
    return opened


def with_logs(plan: Plan, logs: Sequence[LogOnDisk], samples: int, workers: Workers) -> Plan:
    """Return the plan with these logs and with what long ones decide for all of their portions."""
    parts = []
    for log in logs:
        if log.name in workers.broken:
            continue
        try:
            _check_columns(plan, log)
            parts.append(log.cut(samples))
        except MotionError as error:
            if workers.alone:
                raise
            workers.broken[log.name] = str(error)
    plan = replace(plan, parts=tuple(parts))
    several = [i for i, part in enumerate(parts) if len(part.borders) > 2]
    names = [parts[i].name for i in several]
    for i, decision in workers.over(_decided, several, plan, names, "deciding on smoothing"):
        if decision is not None:
            parts[i] = decision
    remaining = tuple(part for part in parts if part.name not in workers.broken)
    _check_some(plan.mechanism, workers, remaining)
    return replace(plan, parts=remaining)


def _check_some(mechanism: Mechanism, workers: Workers, remaining: object) -> None:
    """Raise FitError if no log is left, with the reason that most logs share."""
    if not remaining:
        alike = Counter(why.replace(name, "") for name, why in workers.broken.items())
        ((most, count),) = alike.most_common(1)
        name, why = next(x for x in workers.broken.items() if x[1].replace(x[0], "") == most)
        same = f" ({count} of them say the same)" if count > 1 else ""
        raise FitError(
            f"{mechanism.name}: none of {len(workers.broken)} logs can be used; {name}: {why}{same}"
        )


def _check_columns(plan: Plan, log: LogOnDisk) -> None:
    """Raise MotionError for a log that lacks a column that the others have."""
    for prefix, joints in (("q", plan.logged), ("tau", plan.mechanism.driven)):
        for name in (f"{prefix}.{joint}" for joint in joints):
            if name not in log.file.columns:
                raise MotionError(
                    f"{log.name}: has no column '{name}', which the other logs have; "
                    f"{one_of(name, log.file.columns)}"
                )


def _decided(plan: Plan, number: int) -> LogOnDisk:
    """Decide for all portions of a log, on stretches of it."""
    part, clock = plan.parts[number], plan.parts[number].clock
    grid = Decimator.of(plan.band.cutoff, 1 / clock.step).factor
    recipe = decide(
        plan.mechanism, part.stretches(), replace(clock, grid=grid), logged=plan.logged,
        independent=plan.independent, band=plan.band, smoothing=plan.smoothing,
    )  # fmt: skip
    anchors = _anchors(plan, number) if plan.mechanism.closures else None
    return replace(part, recipe=recipe, anchors=anchors)


def _anchors(plan: Plan, number: int) -> np.ndarray:
    """(portions, nq) configurations near their beginnings, each followed from the one before.

    A portion alone would be reached straight from [joints] start: on another branch, perhaps.
    """
    mechanism, part, anchors = plan.mechanism, plan.parts[number], []
    solver = LoopSolver(mechanism, plan.logged)
    columns = [f"q.{name}" for name in plan.logged]
    portions = list(plan.portions(number))
    q = y = None
    for portion, after in zip(portions, [*portions[1:], portions[-1]], strict=True):
        log = part.file.piece(portion.begin, portion.end, ["t", *columns])
        x = np.stack([log.columns[name] for name in columns], axis=1)
        for channel in x.T:
            channel[absurd_samples(channel)] = np.nan
        known = np.flatnonzero(np.isfinite(x).all(axis=1))[::THINNED]
        if not len(known):
            anchors.append(mechanism.assembled if q is None else q)
            continue
        t, target = log.t[known], x[known]
        if q is None or y is None:
            path = solver.follow(target, t)
        else:
            path = solver.onward(q, y, target, t)
        anchors.append(path[0])
        at = max(int(np.searchsorted(known, after.begin - portion.begin)) - 1, 0)
        q, y = path[at], target[at]
    return np.array(anchors)


def log_of(plan: Plan, portion: Portion) -> Log:
    """Read a portion with its margins."""
    part = plan.parts[portion.log]
    return replace(part.file.piece(portion.begin, portion.end), name=part.name)


def motion_of(plan: Plan, portion: Portion, log: Log) -> tuple[State | None, list[str]]:
    """Complete the motion of a portion with its margins, as the whole log would have made it."""
    part, mechanism = plan.parts[portion.log], plan.mechanism
    if part.recipe is None:  # the whole log: what `complete` makes of it
        signals = measure(mechanism, log)
        derived = derive(signals, plan.logged, plan.band, plan.smoothing)
        e, notes = state_of(mechanism, signals, plan.logged, plan.band, derived)
        if mechanism.closures:
            before, e = e, e.transmitted(mechanism, plan.independent)
            notes = [*notes, *left_out(before, e)]
        still = standstill(mechanism, signals, e, plan.logged)
        return replace(e, still=still), [*signals.notes, *notes]
    asked = {name for effect in mechanism.effects for name in effect.reads()}
    asked |= {name for name, count in part.values.items() if count > 1}
    absent = [n for n in sorted(asked & {*log.columns}) if np.isfinite(log.columns[n]).sum() < 2]
    where = f"{part.name}: rows {portion.begin} to {portion.end - 1}"
    if absent:
        return None, [f"{where}: {absent[0]} is empty; they are left out"]
    if part.anchors is not None:  # on the branch on which the log arrives
        near = replace(mechanism, start=part.anchors[portion.number])
        near.__dict__["kinematics"] = mechanism.kinematics  # compiled functions, of no start
        mechanism = near
    state = part_of(mechanism, log, part.recipe)
    return state, [f"{where}: no sample can be used"] if state is None else []


@dataclass(frozen=True, eq=False)
class PortionRows:
    """The rows of a portion as triangles."""

    portion: Portion  # where they are from
    blocks: tuple[Block, ...]  # triangles
    notes: tuple[str, ...] = ()  # what a person should know
    findings: tuple[Finding, ...] = ()  # of its channels


def absorbed(plan: Plan, portion: Portion) -> PortionRows:
    """Absorb the rows of a portion."""
    part, columns, cutoff = plan.parts[portion.log], plan.columns, plan.band.cutoff
    log = log_of(plan, portion)
    e, notes = motion_of(plan, portion, log)
    if e is None:
        return PortionRows(portion, (), tuple(notes))
    supports = row_supports(plan.mechanism, columns, e)
    if part.recipe is None:
        edges, farthest = block_edges(cutoff, e.t[0], e.t[-1], len(e)), None
    else:
        clock, farthest = part.recipe.clock, part.recipe.farthest
        edges = block_edges(cutoff, clock.t0, clock.t_end, clock.count)
    scene = Scene.of(plan.mechanism, columns, e, plan.point, cutoff)
    made = rows(scene, cutoff, farthest=farthest, keep=False)
    own = (piece[(piece.t >= portion.since) & (piece.t < portion.until)] for piece in made)
    blocks = summed({}, triangles(portion.log, own, edges, supports))
    motion = Motion((e,), plan.independent, plan.band, 0.0, (), (log,), plan.mechanism)
    findings = log_findings(plan.mechanism, motion)
    return PortionRows(portion, tuple(blocks.values()), tuple(notes), tuple(findings))


def multipliers_of(plan: Plan, portion: Portion) -> tuple[np.ndarray, np.ndarray]:
    """Compute t (n,) [s] and multipliers (n, m) [N | N m] of the samples of a portion."""
    e, _ = motion_of(plan, portion, log_of(plan, portion))
    if e is None:
        return np.empty(0), np.empty((0, len(plan.mechanism.kinematics.multipliers)))
    own = (e.t >= portion.since) & (e.t < portion.until)
    motion = Motion((e,), plan.independent, plan.band, 0.0)
    (prediction,) = predict(plan.mechanism, motion, plan.point)
    values = np.where(prediction.usable[:, None], prediction.multipliers, np.nan)
    return prediction.t[own], values[own]
