"""Errors of the predicted torque: in the data that were fitted, held out, and in other logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.fit.accumulate import Cell
from ident.fit.estimate import Estimate, estimate, totals

FOLDS = 10


@dataclass(frozen=True)
class Error:
    """Of one joint: rms [N m | N], relative ‖τ − τ̂‖/‖τ‖ (None where nothing was measured)."""

    rms: float
    relative: float | None
    unit: str


@dataclass(frozen=True, eq=False)
class Squares:
    """Sums of squares a coordinate (d,): of the error, of the measured torque; and rows."""

    error: np.ndarray
    torque: np.ndarray
    rows: np.ndarray

    def __add__(self, other: Squares) -> Squares:
        return Squares(self.error + other.error, self.torque + other.torque, self.rows + other.rows)

    def errors(self, names: Sequence[str], units: Sequence[str]) -> dict[str, Error]:
        """By joint."""
        found = {}
        for u, (name, unit) in enumerate(zip(names, units, strict=True)):
            rms = float(np.sqrt(self.error[u] / max(self.rows[u], 1)))
            relative = (
                float(np.sqrt(self.error[u] / self.torque[u])) if self.torque[u] > 0 else None
            )
            found[name] = Error(rms, relative, unit)
        return found


def squares(cells: Sequence[Cell], x: np.ndarray, d: int) -> Squares:
    """What a solution x (k,) leaves in some cells, samples at standstill included."""
    error, torque, rows = np.zeros(d), np.zeros(d), np.zeros(d)
    for cell in cells:
        for factor in (cell.factor, cell.rest):
            error[cell.coordinate] += factor.residual_norm(x[cell.support]) ** 2
            rows[cell.coordinate] += factor.rows
        torque[cell.coordinate] += cell.tau
    return Squares(error, torque, rows)


def folds(cells: Sequence[Cell]) -> list[list[Cell]]:
    """Cells parted into stretches of time; whole experiments where there are enough of them."""
    experiments = sorted({cell.experiment for cell in cells})
    if len(experiments) >= FOLDS:
        return [[cell for cell in cells if cell.experiment == number] for number in experiments]
    blocks = sorted({(cell.experiment, cell.block) for cell in cells})
    fold_of = {key: i * min(FOLDS, len(blocks)) // len(blocks) for i, key in enumerate(blocks)}
    parted: list[list[Cell]] = [[] for _ in range(max(fold_of.values()) + 1)]
    for cell in cells:
        parted[fold_of[cell.experiment, cell.block]].append(cell)
    return parted


def held_out(cells: Sequence[Cell], fitted: Estimate, prior: np.ndarray, d: int) -> Squares | None:
    """Errors in each stretch of time of the model fitted to all the others; None for one block."""
    parted = folds(cells)
    if len(parted) < 2:
        return None
    k = len(prior)
    by_fold = [totals(part, k, d) for part in parted]
    total = Squares(np.zeros(d), np.zeros(d), np.zeros(d))
    for i, part in enumerate(parted):
        others = [
            by_fold[j][u] for j in range(len(parted)) if j != i for u in range(d)
        ]  # fold by fold, coordinates in order
        merged = [
            sum((others[j * d + u] for j in range(1, len(parted) - 1)), others[u]) for u in range(d)
        ]
        if sum(factor.rows for factor in merged) == 0:
            continue
        refit = estimate(merged, prior, np.zeros(d), sigma=fitted.sigma)
        total = total + squares(part, refit.solution.x, d)
    return total
