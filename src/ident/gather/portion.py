"""A portion becomes cells: the map of the map-reduce."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.equations.rows import Rows, row_supports, rows
from ident.equations.scene import Scene
from ident.fit.accumulate import Cell, block_cells, block_edges, split
from ident.gather.joined import joined
from ident.gather.motion import experiment
from ident.gather.plan import Plan, Portion
from ident.gather.stack import stacked
from ident.solve.stretch import Stretch

WAITING = 4096  # rows that are absorbed together


@dataclass(frozen=True, eq=False)
class Portioned:
    """What became of a portion.

    Attributes:
        portion: which.
        cells: of its rows; `Cell.experiment` is the number of the log.
        notes: what a person should know of it.
        stretch: where multipliers have a time basis, what it leaves of the stack.
    """

    portion: Portion
    cells: tuple[Cell, ...]
    notes: tuple[str, ...] = ()
    stretch: Stretch | None = None


def cells_of(plan: Plan, portion: Portion) -> Portioned:
    """The rows that a portion answers for, as triangular factors.

    Args:
        plan: of all portions.
        portion: which one.

    Raises:
        LogError, MotionError: where `read_log` or `complete` would raise one.
    """
    part, columns, cutoff = plan.parts[portion.log], plan.columns, plan.band.cutoff
    e, notes = experiment(plan, portion)
    if e is None:
        return Portioned(portion, (), tuple(notes))
    supports = row_supports(plan.mechanism, columns, e)
    if part.decided is None:
        edges = block_edges(cutoff, e.t[0], e.t[-1], len(e))
    else:
        clock = part.decided.clock
        edges = block_edges(cutoff, clock.t0, clock.t_end, clock.count)
    scene = Scene.of(plan.mechanism, columns, e, plan.point, cutoff)
    found: list[Cell] = []
    waiting: list[Rows] = []
    block, count = 0, 0
    for piece in rows(scene, cutoff, farthest=part.farthest):
        own = (piece.t >= portion.since) & (piece.t < portion.until)
        if not own.any():
            continue
        for at, some in split(piece if own.all() else _only(piece, own), edges):
            if at != block or count > WAITING:
                found = joined([*found, *block_cells(portion.log, block, waiting, supports)])
                waiting, block, count = [], at, 0
            waiting.append(some)
            count += len(some.t)
    found = joined([*found, *block_cells(portion.log, block, waiting, supports)])
    stretch = stacked(plan, portion, scene) if plan.stacked else None
    return Portioned(portion, tuple(found), tuple(notes), stretch)


def _only(piece: Rows, own: np.ndarray) -> Rows:
    return Rows(*(getattr(piece, name)[own] for name in Rows.__dataclass_fields__))
