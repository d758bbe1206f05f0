"""Rows of one coordinate by blocks of time, with some of all columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.information.triangle import Array, Index


@dataclass(frozen=True, eq=False)
class Part:
    """Rows of one coordinate in the order of blocks, or triangles of them.

    Attributes:
        coordinate: whose weight they have.
        columns: (s,) which of all columns these rows have; the others are zero in them.
        X: (m, s); Y: (m, 1 + B).
        edges: (blocks + 1,) rows at which blocks begin, equally many in all parts.
    """

    coordinate: int
    columns: Index
    X: Array
    Y: Array
    edges: Index

    def block(self, k: int) -> slice:
        """Rows of one block."""
        return slice(int(self.edges[k]), int(self.edges[k + 1]))

    def taken(self, columns: Index) -> Array:
        """Some of all columns (m, u); zero where these rows do not have them."""
        last = max(self.columns.max(initial=0), columns.max(initial=0))
        return columns_at(self.X, places(self.columns, int(last) + 1)[columns])


def places(columns: Index, total: int) -> Index:
    """(total,) where each column is among a part's, −1 where it is not."""
    found = np.full(total, -1, dtype=np.intp)
    found[columns] = np.arange(len(columns))
    return found


def columns_at(X: Array, at: Index) -> Array:
    """Columns `at` of X, zero where `at` is −1."""
    if (at >= 0).all():
        return X[:, at]
    found = np.zeros((len(X), len(at)))
    found[:, at >= 0] = X[:, at[at >= 0]]
    return found
