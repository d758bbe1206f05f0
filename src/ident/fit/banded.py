"""Multipliers in a time basis: the paper's stack, multipliers eliminated interval by interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.scene import Scene
from ident.equations.stack import basis_of, stack
from ident.fit.accumulate import Cell
from ident.information.band import Elimination, eliminate
from ident.information.splines import Basis
from ident.likelihood.step import Run
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Progress
from ident.solve.factor import Factor

BLOCKS = 40


@dataclass(frozen=True, eq=False)
class Band:
    """One run of samples with its multipliers eliminated.

    Attributes:
        experiment: its number; segment: its samples.
        basis: of λ(t); elimination: factors of the parameters and the way back to a.
    """

    experiment: int
    segment: slice
    basis: Basis
    elimination: Elimination


def banded(
    mechanism: Mechanism,
    columns: Columns,
    motion: Motion,
    progress: Progress | None = None,
    point: Point | None = None,
) -> list[Band]:
    """The stacks of all runs of samples, each eliminated."""
    found = []
    for number, e in enumerate(motion.experiments):
        scene = Scene.of(mechanism, columns, e, point, motion.band.cutoff)
        for segment in e.segments():
            if segment.stop - segment.start < 3:
                continue
            basis = basis_of(mechanism, segment, e)
            if progress:
                progress(f"eliminating multipliers of {e.name}", number / len(motion.experiments))
            chunks = list(stack(scene, motion.band.cutoff, segment, basis))
            if chunks:
                blocks = time_blocks(basis)
                found.append(Band(number, segment, basis, eliminate(chunks, basis.count, blocks)))
    return found


def time_blocks(basis: Basis) -> int:
    """Into how many blocks of time a run of samples is parted."""
    return max(1, min(BLOCKS, basis.count // 4))


def cells_of(bands: Sequence[Band | Run], motion: Motion) -> list[Cell]:
    """The factors of the parameters as cells of one coordinate: rows of all joints together."""
    cells: list[Cell] = []
    for band in bands:
        t = motion.experiments[band.experiment].t[band.segment]
        before = sum(cell.experiment == band.experiment for cell in cells)
        factors = band.elimination.factors
        cells += cells_of_blocks(band.experiment, before, factors, float(t[0]), float(t[-1]))
    return cells


def cells_of_blocks(
    experiment: int, before: int, factors: Sequence[Factor], first: float, last: float
) -> list[Cell]:
    """Cells of equal blocks of the time from `first` to `last` [s], numbered from `before` on."""
    support, rest = np.arange(factors[0].k), Factor.empty(factors[0].k)
    edges = np.linspace(first, last, len(factors) + 1).tolist()
    return [
        Cell(
            experiment, before + block, 0, factor, rest, support, factor.rhs_norm() ** 2,
            (edges[block], edges[block + 1]),
        )
        for block, factor in enumerate(factors)
    ]  # fmt: skip


def multipliers_of(bands: list[Band], motion: Motion, x: np.ndarray, m: int) -> list[np.ndarray]:
    """λ(t) = B(t) a of each experiment (n, m); NaN where no run of samples reaches."""
    found = [np.full((len(e), m), np.nan) for e in motion.experiments]
    for band in bands:
        a = band.elimination.back_substitute(x)
        t = motion.experiments[band.experiment].t[band.segment]
        found[band.experiment][band.segment] = band.basis.evaluate(a, t)
    return found
