"""From logs that need not fit into memory to triangles: a plan, its portions, and their sum.

    portion → motion → rows → one triangle a (log, block of time, coordinate),   triangles add

A log of one portion decides by itself what `complete` decides: its clock, smoothing, standstill. A
longer log decides once for all of its portions, on some stretches of it. What several logs share
(the filter, the joints in which errors count, the working point) is decided on an excerpt.

The progress of a long run is in a file, from which the same run goes on after it was killed. The
file is replaced whole. It holds JSON and one vector of numbers, and a digest of all that the
run depends on: the mechanism, the logs, the settings, the plan made from them, and ident's version.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import numpy as np
import pinocchio as pin

from ident.equations.filter import Decimator
from ident.equations.problem import block_edges, triangles
from ident.equations.rows import Scene, row_supports, rows
from ident.equations.unknowns import Columns, Point
from ident.errors import FitError, IdentError, MotionError, one_of
from ident.faults.channel_checks import log_findings
from ident.files import atomic_write, regular, version
from ident.finding import Finding
from ident.fit.prediction import predict
from ident.information.blocks import Block, summed
from ident.information.linear import Triangle
from ident.log import Log
from ident.log.read import distinct
from ident.log.storage import check_claims
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.closures import LoopSolver
from ident.motion.motion import left_out, part_of, state_of
from ident.motion.recipe import Band, recipe_of, standstill
from ident.motion.signals import LogSignals, absurd_samples, measure
from ident.motion.smoothing import derive
from ident.motion.state import State
from ident.pool import Workers
from ident.streams.logs import LogOnDisk, summarise
from ident.streams.stream import margin_of

KNOTS = 40  # numerics: from a sample to another whose noise moves a spline there by 1e-7 of itself
MEMORY = 4096  # work: samples after which an effect has forgotten where its memory began
FEWEST = 64  # work: samples of a margin: what is interpolated reaches no farther
THINNED = 8  # work: samples of which one is followed to know the branch of the closures


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
    names = distinct(path.name or str(path) for path in paths)
    done = workers.run(summarise, paths, mechanism, names, "looking at the logs")
    opened = [
        replace(log, file=replace(log.file, name=name))
        for name, (_, log) in zip(names, done, strict=True)
        if log is not None
    ]
    _check_some(mechanism, workers, opened)
    return opened


def with_logs(plan: Plan, logs: Sequence[LogOnDisk], samples: int, workers: Workers) -> Plan:
    """Return the plan with these logs and with what long ones decide for all of their portions."""
    wanted = [f"q.{name}" for name in plan.logged]
    wanted += [f"tau.{name}" for name in plan.mechanism.measured]
    parts = []
    for log in (log for log in logs if log.name not in workers.broken):
        if absent := [name for name in wanted if name not in log.file.columns]:
            why = f"has no column '{absent[0]}', which the other logs have; "
            why += one_of(absent[0], log.file.columns)
            if workers.alone:
                raise MotionError(f"{log.name}: {why}")
            workers.broken[log.name] = why
        else:
            parts.append(log.cut(samples))
    plan = replace(plan, parts=tuple(parts))
    several = [i for i, part in enumerate(parts) if len(part.borders) > 2]
    names = [parts[i].name for i in several]
    for i, decision in workers.run(_decided, several, plan, names, "deciding on smoothing"):
        if decision is not None:
            parts[i] = decision
    remaining = tuple(part for part in parts if part.name not in workers.broken)
    _check_some(plan.mechanism, workers, remaining)
    return replace(plan, parts=remaining)


def _check_some(mechanism: Mechanism, workers: Workers, remaining: object) -> None:
    """Raise FitError if no log is left, with the reason that most logs share."""
    if not remaining:
        by_reason: dict[str, list[str]] = {}
        for name, why in workers.broken.items():
            by_reason.setdefault(why.replace(name, ""), []).append(f"{name}: {why}")
        most = max(by_reason.values(), key=len)
        same = f" ({len(most)} of them say the same)" if len(most) > 1 else ""
        raise FitError(
            f"{mechanism.name}: none of {len(workers.broken)} logs can be used; {most[0]}{same}"
        )


def _decided(plan: Plan, number: int) -> LogOnDisk:
    """Decide for all portions of a log, on stretches of it that decide by themselves."""
    part = plan.parts[number]
    clock = replace(part.clock, grid=Decimator.of(plan.band.cutoff, 1 / part.clock.step).factor)
    signals, states, _ = zip(*(_completed(plan, log) for log in part.stretches()), strict=True)
    limits = {
        name: x for signals_of_stretch in signals for name, x in signals_of_stretch.limits.items()
    }
    recipe = recipe_of(states, plan.band, clock)
    recipe = replace(recipe, smoothing=plan.smoothing, limits=limits)
    anchors = _anchors(plan, number) if plan.mechanism.closures else None
    return replace(part, recipe=recipe, anchors=anchors)


def _completed(plan: Plan, log: Log) -> tuple[LogSignals, State, list[str]]:
    """Return signals, state and notes of a log that decides by itself what `complete` decides."""
    mechanism, signals = plan.mechanism, measure(plan.mechanism, log)
    derived = derive(signals, plan.logged, plan.band, plan.smoothing)
    e, notes = state_of(mechanism, signals, derived)
    if mechanism.closures:
        before, e = e, e.transmitted(mechanism, plan.independent)
        notes = [*notes, *left_out(before, e)]
    still = standstill(mechanism, signals, e, plan.logged)
    return signals, replace(e, still=still), [*signals.notes, *notes]


def _anchors(plan: Plan, number: int) -> np.ndarray:
    """(portions, nq) configurations near their beginnings, on the branch of the one before."""
    mechanism, part, anchors = plan.mechanism, plan.parts[number], []
    solver = LoopSolver(mechanism, plan.logged)
    portions = list(plan.portions(number))
    q, y = mechanism.assembled, np.empty(0)  # y: nothing before the first portion with positions
    for portion, after in zip(portions, [*portions[1:], portions[-1]], strict=True):
        log = part.file.piece(portion.begin, portion.end)
        x = np.stack([log.columns[f"q.{name}"] for name in plan.logged], axis=1)
        for channel in x.T:
            channel[absurd_samples(channel)] = np.nan
        known = np.flatnonzero(np.isfinite(x).all(axis=1))[::THINNED]
        if not len(known):
            anchors.append(q)
            continue
        t, target = log.t[known], x[known]
        path = solver.onward(q, y, target, t) if len(y) else solver.follow(target, t)
        anchors.append(path[0])
        at = max(int(np.searchsorted(known, after.begin - portion.begin)) - 1, 0)
        q, y = path[at], target[at]
    return np.array(anchors)


def motion_of(plan: Plan, portion: Portion) -> tuple[Log, State | None, list[str]]:
    """Read a portion with its margins and complete it as the whole log would have been."""
    part, mechanism = plan.parts[portion.log], plan.mechanism
    log = replace(part.file.piece(portion.begin, portion.end), name=part.name)
    if part.recipe is None:  # the whole log
        return log, *_completed(plan, log)[1:]
    asked = {name for effect in mechanism.effects for name in effect.reads()}
    asked |= {name for name, count in part.values.items() if count > 1}
    where = f"{part.name}: rows {portion.begin} to {portion.end - 1}"
    for name in sorted(asked & {*log.columns}):
        if np.isfinite(log.columns[name]).sum() < 2:
            return log, None, [f"{where}: {name} is empty; they are left out"]
    if part.anchors is not None:  # on the branch on which the log arrives
        mechanism = mechanism.with_same_kinematics(start=part.anchors[portion.number])
    signals = measure(mechanism, log, part.recipe.clock, part.recipe.limits)
    state = part_of(mechanism, signals, part.recipe)
    return log, state, [f"{where}: no sample can be used"] if state is None else []


def absorbed(
    plan: Plan, portion: Portion
) -> tuple[Sequence[Block], Sequence[str], Sequence[Finding]]:
    """Return the rows of a portion as triangles, notes, and findings of its channels."""
    part, columns, cutoff = plan.parts[portion.log], plan.columns, plan.band.cutoff
    log, e, notes = motion_of(plan, portion)
    if e is None:
        return (), notes, ()
    supports = row_supports(plan.mechanism, columns, e)
    if part.recipe is None:
        edges, farthest = block_edges(cutoff, e.t[0], e.t[-1], len(e)), None
    else:
        clock, farthest = part.recipe.clock, part.recipe.farthest
        edges = block_edges(cutoff, clock.t0, clock.t_end, clock.count)
    scene = Scene.of(plan.mechanism, columns, e, plan.point, cutoff)
    made = rows(scene, cutoff, farthest=farthest, keep=False)
    inside = (piece[(piece.t >= portion.since) & (piece.t < portion.until)] for piece in made)
    blocks = summed({}, triangles(portion.log, inside, edges, supports))
    motion = Motion((e,), plan.independent, plan.band, 0.0, (), (log,), plan.mechanism)
    return [*blocks.values()], notes, tuple(log_findings(plan.mechanism, motion))


def multipliers_of(plan: Plan, portion: Portion) -> tuple[np.ndarray, np.ndarray]:
    """Compute t (n,) [s] and multipliers (n, m) [N | N m] of the samples of a portion."""
    _, e, _ = motion_of(plan, portion)
    if e is None:
        return np.empty(0), np.empty((0, len(plan.mechanism.kinematics.multipliers)))
    inside = (e.t >= portion.since) & (e.t < portion.until)
    motion = Motion((e,), plan.independent, plan.band, 0.0)
    (prediction,) = predict(plan.mechanism, motion, plan.point)
    values = np.where(prediction.usable[:, None], prediction.multipliers, np.nan)
    return prediction.t[inside], values[inside]


NAME = ".gathered.npz"
PORTIONS, SECONDS = 8, 20.0  # work: after so many portions and so much time the file is replaced
Progress = tuple[int, list[Block], dict[str, str]]
"""How many portions are absorbed, their sum, and by name of a log why it is left out."""


class Checkpoint:
    """The file of a run, replaced now and then."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.file = folder / NAME
        key = hashlib.sha256(version().encode())  # all that the triangles of a plan depend on
        _feed(key, plan)
        self.key = key.hexdigest()
        self.unused = ""  # why the file that was found is not used
        self._saved = (0, time.monotonic())

    def read(self) -> Progress | None:
        """Return the progress of an interrupted run of the same key; None where there is none."""
        try:
            with regular(self.file).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                check_claims(arrays, self.file)
                text = json.loads(str(arrays["text"]))
                if text["key"] == self.key:
                    counts, numbers = text["counts"], arrays["numbers"]
                    parts = np.split(numbers, np.cumsum([count[-1] for count in counts], dtype=int))
                    blocks = [_unpacked(*packed) for packed in zip(counts, parts[:-1], strict=True)]
                    return text["absorbed"], blocks, text["broken"]
                self.unused = "of another mechanism, log, settings or version"
        except FileNotFoundError:
            pass
        except Exception as error:  # damaged bytes make readers fail in any way
            self.unused = f"broken ({type(error).__name__})"
        return None

    def write(self, absorbed: int, blocks: Iterable[Block], broken: Mapping[str, str]) -> None:
        """Replace the file, if enough was done since it was."""
        portions, since = self._saved
        if absorbed - portions < PORTIONS or time.monotonic() - since < SECONDS:
            return
        packed = [*map(_packed, blocks)]
        counts, numbers = [count for count, _ in packed], [np.empty(0), *(x for _, x in packed)]
        text = {"key": self.key, "absorbed": absorbed, "broken": broken, "counts": counts}
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(self.file) as stream:
                np.savez(stream, text=json.dumps(text), numbers=np.concatenate(numbers))
        except OSError as error:
            raise IdentError(
                f"{self.file}: cannot be written ({error.strerror}); name a folder that you may "
                "write"
            ) from None
        self._saved = (absorbed, time.monotonic())

    def remove(self) -> None:
        """Remove the file, when all is done."""
        self.file.unlink(missing_ok=True)


def _packed(block: Block) -> tuple[list[int], np.ndarray]:
    """Return the integers of a block and how many numbers it has, and these numbers."""
    numbers: list[Any] = [block.support, [*block.torque, *block.span]]
    for triangle in block.triangles:
        numbers += [triangle.R.ravel(), triangle.d, [triangle.rho]]
    vector = np.concatenate(numbers)
    sizes = [count for x in block.triangles for count in (x.rows, len(x.R))]
    counts = [*block.key, *sizes, len(block.support), len(vector)]
    return [int(x) for x in counts], vector


def _unpacked(counts: list[int], vector: np.ndarray) -> Block:
    """Return the block of which `_packed` made integers and numbers."""
    log, block, coordinate, *of_triangles, k, _ = counts
    support, sizes, numbers = np.split(vector, [k, k + 4])
    triangles, start = [], 0
    for count, m in zip(of_triangles[::2], of_triangles[1::2], strict=True):
        R, d, rho, _ = np.split(numbers[start:], [m * k, m * k + m, m * k + m + 1])
        triangles.append(Triangle(R.reshape(m, k), d, float(rho[0]), count))
        start += m * k + m + 1
    moving, idle, first, last = sizes.tolist()
    torque, span = (moving, idle), (first, last)
    informing, rest, still = triangles
    key = log, block, coordinate
    return Block(*key, informing, rest, still, support.astype(int), torque, span)


def _feed(result: Any, thing: Any) -> None:
    """Add a plan's nouns to a digest, the arrays and numbers in them by their bytes."""
    result.update(type(thing).__name__.encode())
    if isinstance(thing, np.ndarray):
        result.update(repr(thing.shape).encode() + np.ascontiguousarray(thing).tobytes())
    elif isinstance(thing, pin.Model):
        result.update(thing.saveToString().encode())
    elif is_dataclass(thing):
        _feed(result, [getattr(thing, part.name) for part in fields(thing)])
        code = getattr(thing, "file", None)  # of a user's effect
        if isinstance(code, Path):
            result.update(code.read_bytes())
        elif (function := getattr(thing, "function", None)) is not None:
            _feed(result, function)
    elif isinstance(thing, Mapping):
        _feed(result, [*thing.items()])
    elif isinstance(thing, list | tuple):
        for part in thing:
            _feed(result, part)
    elif isinstance(thing, pin.SE3):
        _feed(result, thing.homogeneous)
    elif isinstance(thing, partial):
        _feed(result, [thing.func, thing.args, thing.keywords])
    elif isinstance(thing, FunctionType):
        cells = [cell.cell_contents for cell in thing.__closure__ or ()]
        _feed(result, [thing.__code__, thing.__defaults__, thing.__kwdefaults__, cells])
    elif isinstance(thing, CodeType):
        _feed(result, [thing.co_code, thing.co_names, thing.co_consts])
    else:
        result.update(repr(thing).encode())
