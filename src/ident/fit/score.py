"""Errors of the predicted torque: in the data that were fitted, held out, and in other logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import accumulate
from operator import add

import numpy as np

from ident.fit.accumulate import Cell
from ident.fit.estimate import Estimate, estimate, totals
from ident.residual.error import Squares
from ident.solve.factor import Factor

FOLDS = 10
ROUNDING = 1e-9  # of the torque, below which an error is none


def squares(cells: Sequence[Cell], x: np.ndarray, d: int) -> Squares:
    """What a solution x (k,) leaves in some cells, samples at standstill included."""
    error, torque, rows = np.zeros(d), np.zeros(d), np.zeros(d)
    for cell in cells:
        for factor in (cell.factor, cell.rest) if cell.rest.rows else (cell.factor,):
            error[cell.coordinate] += factor.residual_norm(x[cell.support]) ** 2
            rows[cell.coordinate] += factor.rows
        torque[cell.coordinate] += cell.tau
    return Squares(error, torque, rows)


def rises(after: Squares, before: Squares) -> np.ndarray:
    """Of the error, as a share, of every coordinate that has one."""
    old = np.maximum(before.error, ROUNDING**2 * before.torque)
    new = np.maximum(after.error, ROUNDING**2 * after.torque)
    return np.asarray(np.sqrt(new[old > 0] / old[old > 0]) - 1)


def rise(after: Squares, before: Squares) -> float:
    """Of the error, as a share: √ of the mean over coordinates of (after / before)², less 1."""
    each = rises(after, before)
    return float(np.sqrt(np.mean((1 + each) ** 2)) - 1) if len(each) else 0.0


def stretches(*sets: Sequence[Cell]) -> int:
    """Into how many stretches of time each experiment is parted, no more than it has blocks."""
    blocks: dict[tuple[int, int], set[int]] = {}
    for number, cells in enumerate(sets):
        for cell in cells:
            blocks.setdefault((number, cell.experiment), set()).add(cell.block)
    experiments = len({experiment for _, experiment in blocks})
    return max(1, min(-(-FOLDS // experiments), *(len(found) for found in blocks.values())))


def folds(cells: Sequence[Cell], each: int) -> dict[int, list[Cell]]:
    """Cells by experiment and stretch of time, `each` stretches an experiment."""
    ends: dict[int, tuple[float, float]] = {}
    for cell in cells:
        first, last = ends.get(cell.experiment, cell.span)
        ends[cell.experiment] = min(first, cell.span[0]), max(last, cell.span[1])
    numbers = sorted(ends)
    parted: dict[int, list[Cell]] = {}
    for cell in cells:
        first, last = ends[cell.experiment]
        share = (sum(cell.span) / 2 - first) / max(last - first, 1e-300)
        stretch = min(int(share * each), each - 1)
        parted.setdefault(numbers.index(cell.experiment) * each + stretch, []).append(cell)
    return parted


def held_out(
    fitting: Sequence[Cell],
    scoring: Sequence[Cell],
    fitted: Estimate,
    prior: np.ndarray,
    coordinates: int,
    refit: Callable[[Estimate], np.ndarray] | None = None,
) -> Squares | None:
    """Errors in each stretch of time of the model fitted to all the others; None for one stretch.

    Args:
        fitting: cells from which parameters are estimated; scoring: cells in which errors count.
        fitted: whose weights are kept.
        prior: (k,).
        coordinates: how many the scoring cells have.
        refit: what becomes of the estimate from the other stretches, (k,); default: as it is.
    """
    each = stretches(fitting, scoring)
    parted, scored = folds(fitting, each), folds(scoring, each)
    if len(parted) < 2:
        return None
    k, e = len(prior), coordinates
    weighted = [_weighted(part, k, fitted.sigma) for part in parted.values()]
    everything = Factor.merge(weighted)
    without = dict(zip(parted, without_each(weighted), strict=True))
    total = Squares(np.zeros(e), np.zeros(e), np.zeros(e))
    for number, part in scored.items():
        others = without.get(number, everything)
        if others.rows == 0:
            continue
        other = estimate([others], prior, np.zeros(1), sigma=np.ones(1), held=fitted.held)
        other = replace(other, sigma=fitted.sigma)  # which the rows are divided by already
        total = total + squares(part, refit(other) if refit else other.solution.x, e)
    return total


def without_each(factors: Sequence[Factor]) -> list[Factor]:
    """For each factor all others merged: those before it and those after it."""
    nothing = Factor.empty(factors[0].k)
    before = accumulate(factors[:-1], add, initial=nothing)
    after = [*accumulate(reversed(factors[1:]), add, initial=nothing)]
    return [one + other for one, other in zip(before, reversed(after), strict=True)]


def _weighted(cells: Sequence[Cell], k: int, sigma: np.ndarray) -> Factor:
    """All coordinates' rows, each divided by its sigma."""
    found = zip(totals(cells, k, len(sigma)), sigma, strict=True)
    return Factor.merge([factor.scaled(1 / s) for factor, s in found])
