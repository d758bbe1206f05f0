"""Old names of `ident.information.held_out`."""

from collections.abc import Callable, Sequence

import numpy as np

from ident.information import held_out as _now
from ident.information.blocks import Block, Information, Squares
from ident.information.estimate import Estimate
from ident.information.held_out import rise, rises, without_each

__all__ = ["folds", "held_out", "rise", "rises", "squares", "stretches", "without_each"]


def _of(cells: Sequence[Block], k: int | None = None, d: int | None = None) -> Information:
    cells = list(cells)
    k = 1 + max(int(c.support.max(initial=0)) for c in cells) if k is None else k
    d = 1 + max(c.coordinate for c in cells) if d is None else d
    return Information.of(cells, k, d)


def squares(cells: Sequence[Block], x: np.ndarray, d: int) -> Squares:
    """Return what a solution x (k,) leaves in some blocks."""
    return _of(cells, len(x), d).squares(x)


def stretches(*sets: Sequence[Block]) -> int:
    """Return into how many stretches of time each log is parted."""
    return _now.fold_count(*(_of(cells) for cells in sets))


def folds(cells: Sequence[Block], each: int) -> dict[int, list[Block]]:
    """Part blocks by log and stretch of time."""
    return {number: list(part) for number, part in _now.folds(_of(cells), each).items()}


def held_out(
    fitting: Sequence[Block],
    scoring: Sequence[Block],
    fitted: Estimate,
    prior: np.ndarray,
    coordinates: int,
    refit: Callable[[Estimate], np.ndarray] | None = None,
) -> Squares | None:
    """Return errors in each stretch of time of the model fitted to all the others."""
    both = _of(fitting, len(prior), len(fitted.sigma)), _of(scoring, len(prior), coordinates)
    return _now.held_out(*both, fitted, prior, refit)
