"""From the accumulated factors to parameters: the estimate of a batch on the same cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.fit.accumulate import Cell
from ident.fit.covariance import covariance
from ident.fit.estimate import Estimate, estimate, totals
from ident.fit.plausible import plausible
from ident.fit.score import squares
from ident.fit.values import BaseValue, Value, base_values, effect_values, rigid_values
from ident.mechanism.mechanism import Mechanism
from ident.residual.error import Squares


@dataclass(frozen=True, eq=False)
class Found:
    """What some cells say.

    Attributes:
        estimate: solution, base, weights; covariance: (n_ind, n_ind) of the base parameters.
        squares: what the solution leaves in the rows.
        parameters: unknown dynamic parameters, then those of effects; base: their combinations.
    """

    estimate: Estimate
    covariance: np.ndarray
    squares: Squares
    parameters: tuple[Value, ...]
    base: tuple[BaseValue, ...]

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        columns: Columns,
        point: Point,
        cells: Sequence[Cell],
        total: Sequence[Cell],
        prior: np.ndarray,
    ) -> Found:
        """The estimate of a batch, least squares.

        Args:
            mechanism, columns, point: of the equations.
            cells: intervals of time; total: one cell a coordinate, the same rows together.
            prior: (k,) where unknowns stay that the rows do not determine.

        Raises:
            FitError: if there are no rows.
        """
        d, k = len(total), len(columns)
        before = squares(total, columns.prior, d)
        torque = np.sqrt(before.torque / np.maximum(before.rows, 1))
        factors = totals(total, k, d)
        size = np.zeros(k)
        for factor in factors:
            size = size + factor.column_norms() ** 2 / max(factor.rows, 1)
        sensible = plausible(mechanism, columns, torque, np.sqrt(size))
        found = estimate(factors, prior, torque, sensible)
        cov = covariance(cells, found)
        after = point.at(mechanism, columns, found.solution.x)
        effects = effect_values(columns, found, cov, after)
        own = [
            value for each in effects for value in each.parameters if value.name in columns.index
        ]
        return cls(
            found,
            cov,
            squares(total, found.solution.x, d),
            (*rigid_values(mechanism, columns, found, cov), *own),
            base_values(columns, found, cov),
        )
