"""All rows of a motion as triangular factors: one a time block and independent coordinate.

Everything that follows (weights, held-out errors, standard errors, other models' comparison) is
computed from these small triangles; the rows are seen once and never kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.rows import Rows, dof, row_supports, rows
from ident.equations.scene import Scene
from ident.errors import FitError
from ident.information.blocks import Block
from ident.information.triangle import Triangle as Factor
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Progress

FEWEST, MOST, LENGTH = 10, 96, 12  # blocks of an experiment, and rows that make one


Cell = Block  # its name before, until all callers have moved


def accumulate(
    mechanism: Mechanism,
    columns: Columns,
    motion: Motion,
    progress: Progress | None = None,
    point: Point | None = None,
) -> list[Cell]:
    """The cells of all experiments, in order of experiment, block, coordinate.

    Args:
        mechanism, columns, motion: what is fitted to what.
        progress: called with (what is being done, share done).
        point: the working point, for effects that are not linear.
    """
    cells: list[Cell] = []
    for number, experiment in enumerate(motion.experiments):
        supports = row_supports(mechanism, columns, experiment)
        t = experiment.t
        edges = block_edges(motion.band.cutoff, t[0], t[-1], len(t))
        waiting: list[Rows] = []
        block = 0
        scene = Scene.of(mechanism, columns, experiment, point, motion.band.cutoff)
        for piece in rows(scene, motion.band.cutoff):
            for at, part in split(piece, edges):
                if at != block:
                    cells += block_cells(number, block, waiting, supports)
                    waiting, block = [], at
                waiting.append(part)
            if progress:
                done = (number + piece.sample[-1] / len(experiment)) / len(motion.experiments)
                progress(f"equations of {experiment.name}", float(done))
        cells += block_cells(number, block, waiting, supports)
    if not cells:
        lost = ", ".join(experiment.name for experiment in motion.experiments)
        raise FitError(
            f"{lost}: no stretch is long enough for the filter ({motion.band.cutoff:.3g} Hz); "
            "give a longer log or a higher --cutoff"
        )
    return cells


def block_edges(cutoff: float | None, first: float, last: float, samples: int) -> np.ndarray:
    """Times [s] that part an experiment of so many samples from t = first to last into blocks."""
    rate = cutoff * 4 if cutoff else (samples - 1) / (last - first)
    kept = (last - first) * rate
    count = int(np.clip(kept / LENGTH, FEWEST, MOST))
    return np.linspace(first, last, count + 1)[1:-1]


def split(piece: Rows, edges: np.ndarray) -> list[tuple[int, Rows]]:
    """Rows by the number of their block."""
    block = np.searchsorted(edges, piece.t, side="right")
    cuts = [0, *(np.flatnonzero(np.diff(block)) + 1), len(block)]
    return [
        (int(block[i]), Rows(*(getattr(piece, name)[i:j] for name in Rows.__dataclass_fields__)))
        for i, j in pairwise(cuts)
        if j > i
    ]


def block_cells(
    number: int, block: int, waiting: Sequence[Rows], supports: Sequence[np.ndarray]
) -> list[Cell]:
    """The cells of some rows of one block, one a coordinate."""
    if not waiting:
        return []
    b, tau, informed = (
        np.concatenate([getattr(part, name) for part in waiting])
        for name in ("b", "tau", "informed")
    )
    span = (float(waiting[0].t[0]), float(waiting[-1].t[-1]))
    found = []
    for u, support in enumerate(supports):
        mine = np.concatenate([part.A[:, u, support] for part in waiting])
        told, torque = informed[:, u], float(tau[:, u] @ tau[:, u])
        if told.all():
            factor, rest = Factor.of(mine, b[:, u]), _nothing(len(support))
        else:
            factor, rest = (Factor.of(mine[some], b[some, u]) for some in (told, ~told))
        found.append(Cell(number, block, u, factor, rest, support, torque, span))
    return found


@cache
def _nothing(k: int) -> Factor:
    return Factor.empty(k)


def coordinates(mechanism: Mechanism, motion: Motion) -> int:
    """Independent coordinates of the motion."""
    return dof(mechanism, motion.experiments[0])
