"""Rows of equations as triangles by log, block of time and coordinate: a sum that can be asked.

    Information = { (log, block, coordinate): triangle of [A | b] },     Information + Information

Everything that follows from rows (weights, estimates, held-out errors, standard errors, which logs
disagree) is computed from these small triangles; rows are seen once and never kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ident.errors import FitError
from ident.information.linear import Array, Index, Triangle


class Key(NamedTuple):
    """The log, the block of time in it, and the coordinate of some rows, as numbers from 0."""

    log: int
    block: int
    coordinate: int


@dataclass(frozen=True)
class Error:
    """Error of one joint: rms [N m | N], relative ‖τ − τ̂‖/‖τ‖ (None where τ is zero)."""

    rms: float
    relative: float | None
    unit: str


@dataclass(frozen=True, eq=False)
class Squares:
    """Sums of squares by coordinate (d,): of the error, of the measured torque; and rows."""

    error: Array
    torque: Array
    rows: Array

    @classmethod
    def zero(cls, d: int) -> Squares:
        """Return the sums of no rows."""
        return cls(np.zeros(d), np.zeros(d), np.zeros(d))

    def __add__(self, other: Squares) -> Squares:
        return Squares(self.error + other.error, self.torque + other.torque, self.rows + other.rows)

    def errors(self, names: Sequence[str], units: Sequence[str]) -> dict[str, Error]:
        """Return the errors by joint."""
        found = {}
        for u, (name, unit) in enumerate(zip(names, units, strict=True)):
            rms = float(np.sqrt(self.error[u] / max(self.rows[u], 1)))
            known = self.torque[u] > 0
            relative = float(np.sqrt(self.error[u] / self.torque[u])) if known else None
            found[name] = Error(rms, relative, unit)
        return found


@dataclass(frozen=True, eq=False)
class Block:
    """The rows of one log, block of time and coordinate.

    Attributes:
        log, block, coordinate: the key.
        triangle: of the rows that inform, on the columns `support`.
        rest: of the rows at standstill, which only count in the errors.
        support: columns that can appear.
        torque: sum of squares of the measured torque in all these rows.
        span: (first t, last t) [s].
    """

    log: int
    block: int
    coordinate: int
    triangle: Triangle
    rest: Triangle
    support: Index
    torque: float
    span: tuple[float, float]

    @property
    def key(self) -> Key:
        """Log, block and coordinate."""
        return Key(self.log, self.block, self.coordinate)

    @property
    def rows(self) -> int:
        """Number of rows, those at standstill included."""
        return self.triangle.rows + self.rest.rows

    def __add__(self, other: Block) -> Block:
        """Return the block of both, which must have the same key."""
        span = min(self.span[0], other.span[0]), max(self.span[1], other.span[1])
        both = (_sum(self.triangle, other.triangle), _sum(self.rest, other.rest))
        return Block(*self.key, *both, self.support, self.torque + other.torque, span)

    def scaled(self, w: float) -> Block:
        """Multiply every equation by `w`."""
        triangles = self.triangle.scaled(w), self.rest.scaled(w)
        return Block(*self.key, *triangles, self.support, w**2 * self.torque, self.span)

    def error(self, x: Array) -> float:
        """Return the sum of squares that x (k,) leaves in all rows."""
        own = x[self.support]
        return self.triangle.residual_norm(own) ** 2 + (
            self.rest.residual_norm(own) ** 2 if self.rest.rows else 0.0
        )


def summed(found: dict[Key, Block], blocks: Iterable[Block]) -> dict[Key, Block]:
    """Add further blocks to those that were found, by key."""
    for block in blocks:
        key = block.key
        found[key] = found[key] + block if key in found else block
    return found


def _sum(a: Triangle, b: Triangle) -> Triangle:
    if not (a.rows and b.rows):
        return a if a.rows else b
    return a + b


@dataclass(frozen=True, eq=False)
class Information:
    """Blocks of rows in k unknowns and d coordinates, by key.

    Attributes:
        blocks: by key, in the order of their keys.
        k: number of unknowns; d: of coordinates.
    """

    blocks: Mapping[Key, Block]
    k: int
    d: int

    @classmethod
    def of(cls, blocks: Iterable[Block], k: int, d: int) -> Information:
        """Collect blocks; those of one key are added in the order in which they come."""
        return cls(dict(sorted(summed({}, blocks).items())), k, d)

    def __iter__(self) -> Iterator[Block]:
        return iter(self.blocks.values())

    def __len__(self) -> int:
        return len(self.blocks)

    def __add__(self, other: Information) -> Information:
        """Return the information of both; blocks of the same key are added.

        Raises:
            FitError: if they have other numbers of unknowns or coordinates.
        """
        if (self.k, self.d) != (other.k, other.d):
            raise FitError(
                f"information in {other.k} unknowns and {other.d} coordinates, "
                f"valid: {self.k} and {self.d}"
            )
        return Information.of([*self, *other], self.k, self.d)

    @property
    def logs(self) -> list[int]:
        """Numbers of the logs, ascending."""
        return sorted({block.log for block in self})

    @property
    def times(self) -> list[tuple[int, int]]:
        """(log, block) of every block of time with rows that inform, ascending."""
        return list(dict.fromkeys((b.log, b.block) for b in self if b.triangle.rows))

    @property
    def rows(self) -> int:
        """Number of rows, those at standstill included."""
        return sum(block.rows for block in self)

    def where(self, condition: Callable[[Block], bool]) -> Information:
        """Return the blocks that meet a condition."""
        return replace(self, blocks={key: b for key, b in self.blocks.items() if condition(b)})

    def of_log(self, log: int) -> Information:
        """Return the blocks of one log."""
        return self.where(lambda block: block.log == log)

    @cached_property
    def totals(self) -> tuple[Triangle, ...]:
        """Triangle of each coordinate's rows that inform, over all blocks, on all k columns."""
        return self._totals(lambda block: block.triangle)

    @cached_property
    def at_rest(self) -> tuple[Triangle, ...]:
        """Triangle of each coordinate's rows at standstill, over all blocks, on all k columns."""
        return self._totals(lambda block: block.rest)

    def _totals(self, of: Callable[[Block], Triangle]) -> tuple[Triangle, ...]:
        found = []
        for u in range(self.d):
            mine = [block for block in self if block.coordinate == u]
            if mine:
                merged = Triangle.merge([of(block) for block in mine])
                found.append(merged.embedded(mine[0].support, self.k))
            else:
                found.append(Triangle.empty(self.k))
        return tuple(found)

    def total(self, sigma: Array) -> Triangle:
        """Return the triangle of all rows that inform, each divided by its coordinate's sigma."""
        return Triangle.merge([t.scaled(1 / s) for t, s in zip(self.totals, sigma, strict=True)])

    @cached_property
    def measured(self) -> tuple[Array, Array]:
        """Sum of squares of the measured torque (d,), and number of rows (d,)."""
        torque, rows = np.zeros((2, self.d))
        for block in self:
            torque[block.coordinate] += block.torque
            rows[block.coordinate] += block.rows
        return torque, rows

    @property
    def rms_torque(self) -> Array:
        """Rms (d,) of the measured torque [N m | N]."""
        torque, rows = self.measured
        return np.asarray(np.sqrt(torque / np.maximum(rows, 1)))

    def squares(self, x: Array) -> Squares:
        """Return what a solution x (k,) leaves in all rows, those at standstill included."""
        error = np.zeros(self.d)
        for block in self:
            error[block.coordinate] += block.error(x)
        return Squares(error, *self.measured)


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
