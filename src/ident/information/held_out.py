"""Errors of the predicted torque in stretches of time that were left out of the fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import accumulate
from operator import add

import numpy as np

from ident.information.blocks import Information, Squares
from ident.information.estimate import Estimate, estimate
from ident.information.triangle import Array, Triangle

FOLDS = 10
ROUNDING = 1e-9  # of the torque, below which an error is none


def rises(after: Squares, before: Squares) -> Array:
    """Return the rise of the error as a share, of every coordinate that has one."""
    old = np.maximum(before.error, ROUNDING**2 * before.torque)
    new = np.maximum(after.error, ROUNDING**2 * after.torque)
    return np.asarray(np.sqrt(new[old > 0] / old[old > 0]) - 1)


def rise(after: Squares, before: Squares) -> float:
    """Return the rise of the error: √ of the mean over coordinates of (after / before)², less 1."""
    each = rises(after, before)
    return float(np.sqrt(np.mean((1 + each) ** 2)) - 1) if len(each) else 0.0


def fold_count(*sets: Information) -> int:
    """Return into how many stretches each log is parted: no more than it has blocks."""
    blocks: dict[tuple[int, int], set[int]] = {}
    for number, information in enumerate(sets):
        for block in information:
            blocks.setdefault((number, block.log), set()).add(block.block)
    logs = len({log for _, log in blocks})
    return max(1, min(-(-FOLDS // logs), *(len(found) for found in blocks.values())))


def folds(information: Information, each: int) -> dict[int, Information]:
    """Part the blocks by log and stretch of time, `each` stretches a log."""
    ends: dict[int, tuple[float, float]] = {}
    for block in information:
        first, last = ends.get(block.log, block.span)
        ends[block.log] = min(first, block.span[0]), max(last, block.span[1])
    logs = sorted(ends)
    parted: dict[int, dict] = {}
    for key, block in information.blocks.items():
        first, last = ends[block.log]
        share = (sum(block.span) / 2 - first) / max(last - first, 1e-300)
        stretch = min(int(share * each), each - 1)
        parted.setdefault(logs.index(block.log) * each + stretch, {})[key] = block
    return {number: replace(information, blocks=blocks) for number, blocks in parted.items()}


def held_out(
    fitting: Information,
    scoring: Information,
    fitted: Estimate,
    prior: Array,
    refit: Callable[[Estimate], Array] | None = None,
) -> Squares | None:
    """Return errors in each stretch of the model fitted to all others; None for one stretch.

    Args:
        fitting: from which parameters are estimated; scoring: in which errors count.
        fitted: the estimate whose weights are kept.
        prior: (k,).
        refit: what follows from the estimate of the other stretches, (k,); default: as it is.
    """
    each = fold_count(fitting, scoring)
    parted, scored = folds(fitting, each), folds(scoring, each)
    if len(parted) < 2:
        return None
    weighted = [part.total(fitted.sigma) for part in parted.values()]
    everything = Triangle.merge(weighted)
    without = dict(zip(parted, without_each(weighted), strict=True))
    found = Squares.zero(scoring.d)
    for number, part in scored.items():
        others = without.get(number, everything)
        if others.rows == 0:
            continue
        other = estimate([others], prior, np.zeros(1), sigma=np.ones(1), held=fitted.held)
        other = replace(other, sigma=fitted.sigma)  # which the rows are divided by already
        found = found + part.squares(refit(other) if refit else other.solution.x)
    return found


def without_each(triangles: Sequence[Triangle]) -> list[Triangle]:
    """Return for each triangle all others merged: those before it and those after it."""
    nothing = Triangle.empty(triangles[0].k)
    before = accumulate(triangles[:-1], add, initial=nothing)
    after = [*accumulate(reversed(triangles[1:]), add, initial=nothing)]
    return [one + other for one, other in zip(before, reversed(after), strict=True)]
