"""From a portion of a log to triangles, and their sum over all portions.

    portion → motion → rows → one triangle a (log, block of time, coordinate),   triangles add

Multipliers in a time basis have the knots of the whole log, so that portions meet inside one
interval of them: what a portion leaves of the paper's stack is a `Stretch`, and neighbours add.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ident.equations.corrections import Scene
from ident.equations.multipliers import stack
from ident.equations.rows import Rows, row_supports, rows
from ident.fit.problem import block_edges, blocks_of, equal_blocks, split_rows, time_blocks
from ident.fit.residual import predict
from ident.information.band import Stretch, eliminate
from ident.information.blocks import Block, Key
from ident.information.splines import Basis
from ident.motion import Motion
from ident.streams.plan import Plan, Portion, motion_of
from ident.streams.stream import rows_at

WAITING = 4096  # rows that are absorbed together


@dataclass(frozen=True, eq=False)
class PortionRows:
    """The rows of a portion as triangles."""

    portion: Portion  # where they are from
    blocks: tuple[Block, ...]  # triangles
    notes: tuple[str, ...] = ()  # what a person should know
    stretch: Stretch | None = None  # of multipliers in a time basis: rest of the stack


def absorbed(plan: Plan, portion: Portion) -> PortionRows:
    """Absorb the rows of a portion."""
    part, columns, cutoff = plan.parts[portion.log], plan.columns, plan.band.cutoff
    e, notes = motion_of(plan, portion)
    if e is None:
        return PortionRows(portion, (), tuple(notes))
    supports = row_supports(plan.mechanism, columns, e)
    if part.recipe is None:
        edges, farthest = block_edges(cutoff, e.t[0], e.t[-1], len(e)), None
    else:
        clock, farthest = part.recipe.clock, part.recipe.farthest
        edges = block_edges(cutoff, clock.t0, clock.t_end, clock.count)
    scene = Scene.of(plan.mechanism, columns, e, plan.point, cutoff)
    total, block, count = Sum(), 0, 0
    waiting: list[Rows] = []
    for piece in rows(scene, cutoff, farthest=farthest, keep=False):
        own = (piece.t >= portion.since) & (piece.t < portion.until)
        if not own.any():
            continue
        for at, some in split_rows(rows_at(piece, own), edges):
            if at != block or count > WAITING:
                total.absorb(blocks_of(portion.log, block, waiting, supports))
                waiting, block, count = [], at, 0
            waiting.append(some)
            count += len(some.t)
    total.absorb(blocks_of(portion.log, block, waiting, supports))
    stretch = _stretch(plan, portion, scene) if plan.stacked else None
    return PortionRows(portion, tuple(total.blocks.values()), tuple(notes), stretch)


class Sum:
    """The sum of portions' triangles, in the order of portions, whatever the order they come in.

    Floating-point sums depend on the order; memory is that of the sum and of what came too early.

    Attributes:
        blocks: by log, block and coordinate.
        stretches: by log.
        absorbed: portions, from the first, without gaps; worked: portions that were handed in.
    """

    def __init__(
        self,
        blocks: Iterable[Block] = (),
        absorbed: int = 0,
        stretches: Mapping[int, Stretch] | None = None,
    ) -> None:
        self.blocks: dict[Key, Block] = {}
        self.absorb(blocks)
        self.stretches = dict(stretches or {})
        self.absorbed, self.worked = absorbed, 0
        self._early: dict[int, PortionRows | None] = {}

    def absorb(self, blocks: Iterable[Block]) -> None:
        """Add triangles."""
        for block in blocks:
            old = self.blocks.get(block.key)
            self.blocks[block.key] = block if old is None else old + block

    def add(self, number: int, done: PortionRows | None) -> None:
        """Add a portion, of which the first has the number 0; None for one that failed."""
        self._early[number] = done
        self.worked += 1
        while self.absorbed in self._early:
            done = self._early.pop(self.absorbed)
            self.absorbed += 1
            if done is None:
                continue
            self.absorb(done.blocks)
            if done.stretch is not None:
                old = self.stretches.get(done.portion.log)
                self.stretches[done.portion.log] = old + done.stretch if old else done.stretch

    def without(self, logs: Iterable[int]) -> list[Block]:
        """Return all triangles in order of log, block, coordinate, but for those of some logs."""
        out = set(logs)
        return [self.blocks[key] for key in sorted(self.blocks) if key[0] not in out]


def _basis(plan: Plan, log: int) -> Basis:
    """Basis of λ(t) over a whole log."""
    clock, settings = plan.parts[log].clock, plan.mechanism.multipliers
    return Basis.spanning(clock.t0, clock.t_end, settings.spacing, settings.degree)


def _stretch(plan: Plan, portion: Portion, scene: Scene) -> Stretch | None:
    """What a portion adds to the stack of its log; None where no row informs."""
    basis, total = _basis(plan, portion.log), None
    begins = np.arange(1, time_blocks(basis)) * basis.count // time_blocks(basis)
    for segment in scene.e.segments():
        for chunk in stack(scene, plan.band.cutoff, segment, basis, portion.since, portion.until):
            if len(chunk.b):
                stretch = Stretch.of(chunk, begins)
                total = stretch if total is None else total + stretch
    return total


def stack_blocks(plan: Plan, stretches: Mapping[int, Stretch]) -> list[Block]:
    """Close the stacks of logs, when all of their portions are added."""
    results = []
    for log, stretch in sorted(stretches.items()):
        basis = _basis(plan, log)
        results += equal_blocks(log, 0, stretch.closed(), basis.t0, basis.t_end)
    return results


def multipliers_of(plan: Plan, portion: Portion) -> tuple[np.ndarray, np.ndarray]:
    """Compute t (n,) [s] and multipliers (n, m) [N | N m] of the samples of a portion."""
    names, cutoff = plan.mechanism.kinematics.multipliers, plan.band.cutoff
    e, _ = motion_of(plan, portion)
    if e is None:
        return np.empty(0), np.empty((0, len(names)))
    own = (e.t >= portion.since) & (e.t < portion.until)
    if not plan.stacked:
        motion = Motion((e,), plan.independent, plan.band, 0.0)
        (prediction,) = predict(plan.mechanism, motion, plan.point)
        values = np.where(prediction.usable[:, None], prediction.multipliers, np.nan)
        return prediction.t[own], values[own]
    scene = Scene.of(plan.mechanism, plan.columns, e, plan.point, cutoff)
    x, whole = plan.point.unknowns(plan.columns), _basis(plan, portion.log)
    values = np.full((len(e), len(names)), np.nan)
    for segment in scene.e.segments():
        t = scene.e.t[segment]
        if len(t) < 3:
            continue
        before = np.floor((t[0] - whole.t0) / whole.spacing + 1e-9)
        begin = float(whole.t0 + before * whole.spacing)  # on the knots of the whole log
        # beyond the margins nothing is known here, which the innermost samples do not depend on
        basis = Basis.spanning(begin, float(t[-1]), whole.spacing, whole.degree)
        if chunks := [c for c in stack(scene, cutoff, segment, basis) if len(c.b)]:
            a = eliminate(chunks, basis.count).back_substitute(x)
            values[segment] = basis.evaluate(a, t)
    return e.t[own], values[own]
