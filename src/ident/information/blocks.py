"""Rows of equations as triangles by log, block of time and coordinate: a sum that can be asked.

    Information = { (log, block, coordinate): triangle of [A | b] },     Information + Information

Everything that follows from rows (weights, estimates, held-out errors, standard errors, which logs
disagree) is computed from these small triangles; rows are seen once and never kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import add
from typing import NamedTuple

import numpy as np

from ident.errors import FitError
from ident.information.linear import Array, Index, Triangle, weighted_total

Mask = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


class Key(NamedTuple):
    """The log, the block of time in it, and the coordinate of some rows, as numbers from 0."""

    log: int
    block: int
    coordinate: int


@dataclass(frozen=True)
class Error:
    """Error of the predicted torque of one joint in the rows in motion: where a joint that moves
    with it stands still, dry friction may have any value, and no model predicts it.
    """

    rms: float  # [N m | N]
    relative: float | None  # ‖τ − τ̂‖/‖τ‖, None where τ is zero
    unit: str  # of the rms
    rms_with_standstill: float | None = None  # of all rows; None where that is not known
    relative_with_standstill: float | None = None

    @property
    def unmeasured(self) -> bool:
        """Whether no row has a torque or an error: that of a joint without a torque sensor."""
        return self.rms == 0 and self.relative is None and not self.rms_with_standstill

    @property
    def with_standstill(self) -> Error:
        """The error of all rows, those at standstill too."""
        if self.rms_with_standstill is None:
            return self
        return replace(self, rms=self.rms_with_standstill, relative=self.relative_with_standstill)


@dataclass(frozen=True, eq=False)
class Squares:
    """Sums (3, d) of squares of the error, of the measured torque, and numbers of rows."""

    in_motion: Array
    at_standstill: Array

    @classmethod
    def zero(cls, d: int) -> Squares:
        """Return the sums of no rows."""
        return cls(np.zeros((3, d)), np.zeros((3, d)))

    @classmethod
    def of(cls, residual: Array, measured: Array, moving: Mask) -> Squares:
        """Return the sums of rows (n, d), of which `moving` says whether they are in motion."""
        series = residual**2, measured**2
        return cls(
            *(
                np.stack([*((x * use).sum(axis=0) for x in series), use.sum(axis=0)])
                for use in (moving, ~moving)
            )
        )

    def __add__(self, other: Squares) -> Squares:
        return Squares(self.in_motion + other.in_motion, self.at_standstill + other.at_standstill)

    @property
    def all_rows(self) -> Array:
        """(3, d) of all rows."""
        return self.in_motion + self.at_standstill

    @cached_property
    def counted(self) -> Array:
        """(3, d) of the rows in motion; of a joint that never moves, of all rows."""
        return np.where(self.in_motion[2] > 0, self.in_motion, self.all_rows)

    def errors(self, names: Sequence[str], units: Sequence[str]) -> dict[str, Error]:
        """Return the errors by joint."""

        errors = {}
        for u, (name, unit) in enumerate(zip(names, units, strict=True)):
            sizes = []
            for error, torque, rows in (self.counted[:, u], self.all_rows[:, u]):
                relative = float(np.sqrt(error / torque)) if torque > 0 else None
                sizes.append((float(np.sqrt(error / max(rows, 1))), relative))
            errors[name] = Error(*sizes[0], unit, *sizes[1])
        return errors


@dataclass(frozen=True, eq=False)
class Block:
    """The rows of one log, block of time and coordinate."""

    log: int
    block: int
    coordinate: int
    triangle: Triangle  # of the rows that inform, on the columns `support`
    rest: Triangle  # of those at which dry friction is open, which only count in errors of all rows
    still: Triangle  # of the rows at standstill among those that inform
    support: Index  # columns that can appear
    torque: tuple[float, float]  # sums of squares, measured in motion and at standstill
    span: tuple[float, float]  # first and last t [s]
    rest_rows: Triangle | None = None  # of rows at rest, weighed so that a stretch counts as one
    stretches: float = 0.0  # how many rows they count as
    resting: bool = False  # whether `triangle` has them too

    @property
    def key(self) -> Key:
        """Log, block and coordinate."""
        return Key(self.log, self.block, self.coordinate)

    @property
    def rows(self) -> int:
        """Number of rows, those at standstill included."""
        return self.triangle.rows - self.rest_count + self.rest.rows

    @property
    def rest_count(self) -> int:
        """How many rows of `triangle` are at rest with open friction."""
        return self.rest_rows.rows if self.rest_rows and self.resting else 0

    def __add__(self, other: Block) -> Block:
        """Return the block of both, which must have the same key."""
        span = min(self.span[0], other.span[0]), max(self.span[1], other.span[1])
        informing, rest, still = map(add, self.triangles, other.triangles)
        torque = self.torque[0] + other.torque[0], self.torque[1] + other.torque[1]
        rest_rows = (
            Triangle.merge([x.rest_rows for x in (self, other) if x.rest_rows])
            if self.rest_rows
            else other.rest_rows
        )
        return Block(
            *self.key, informing, rest, still, self.support, torque, span,
            rest_rows, self.stretches + other.stretches, self.resting,
        )  # fmt: skip

    def scaled(self, w: float) -> Block:
        """Multiply every equation by `w`."""
        informing, rest, still = (triangle.scaled(w) for triangle in self.triangles)
        torque = w**2 * self.torque[0], w**2 * self.torque[1]
        changed = replace(self, triangle=informing, rest=rest, still=still, torque=torque)
        return replace(changed, rest_rows=self.rest_rows and self.rest_rows.scaled(w))

    def with_rest(self, w: float) -> Block:
        """Count the rows at rest among those that inform, each with the weight `w`."""
        if self.rest_rows is None or self.resting or not w:
            return self
        rest_rows = self.rest_rows.scaled(w)
        return replace(self, triangle=self.triangle + rest_rows, rest_rows=rest_rows, resting=True)

    @property
    def triangles(self) -> tuple[Triangle, Triangle, Triangle]:
        """Of the rows that inform, of the others, and of those at standstill that inform."""
        return self.triangle, self.rest, self.still


def summed(total: dict[Key, Block], blocks: Iterable[Block]) -> dict[Key, Block]:
    """Add further blocks to those that were found, by key."""
    for block in blocks:
        key = block.key
        total[key] = total[key] + block if key in total else block
    return total


@dataclass(frozen=True, eq=False)
class Information:
    """Blocks of rows in k unknowns and d coordinates, by key, in the order of their keys."""

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
        """Return the information of both; blocks of one key are added. FitError for other sizes."""
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
    def neighbours(self) -> list[tuple[int, int]]:
        """`times`, those of poses at rest alone with a log of their own: they follow no others."""
        moving = {(b.log, b.block) for b in self if b.triangle.rows > b.rest_count}
        return [time if time in moving else (~i, 0) for i, time in enumerate(self.times)]

    @property
    def rows(self) -> int:
        """Number of rows, those at standstill included."""
        return sum(block.rows for block in self)

    def of_log(self, log: int) -> Information:
        """Return the blocks of one log."""
        return replace(self, blocks={key: b for key, b in self.blocks.items() if b.log == log})

    @cached_property
    def totals(self) -> tuple[Triangle, ...]:
        """Triangle of each coordinate's rows that inform, over all blocks, on all k columns."""
        return self._totals("triangle")

    def with_rest(self, weight: Array) -> Information:
        """Count rows at rest among those that inform, with a `weight` (d,) over one in motion."""
        blocks = {key: b.with_rest(float(weight[b.coordinate])) for key, b in self.blocks.items()}
        return replace(self, blocks=blocks)

    @cached_property
    def rest_rows(self) -> tuple[tuple[Triangle, float], ...]:
        """The rows at rest of each coordinate on all k columns, and how many they count as."""
        totals = [(Triangle.empty(self.k), 0.0)] * self.d
        for u, blocks in self.by_coordinate.items():
            if triangles := [block.rest_rows for block in blocks if block.rest_rows]:
                merged = Triangle.merge(triangles).embedded(blocks[0].support, self.k)
                totals[u] = merged, sum(block.stretches for block in blocks)
        return tuple(totals)

    @cached_property
    def at_rest(self) -> tuple[Triangle, ...]:
        """Triangle of each coordinate's rows at standstill, over all blocks, on all k columns."""
        return self._totals("rest")

    def _totals(self, name: str) -> tuple[Triangle, ...]:
        totals = [Triangle.empty(self.k)] * self.d
        for u, blocks in self.by_coordinate.items():
            merged = Triangle.merge([getattr(block, name) for block in blocks])
            totals[u] = merged.embedded(blocks[0].support, self.k)
        return tuple(totals)

    @cached_property
    def by_coordinate(self) -> dict[int, list[Block]]:
        """The blocks of each coordinate that has any, in the order of their keys."""
        groups = dict[int, list[Block]]()
        for block in self:
            groups.setdefault(block.coordinate, []).append(block)
        return dict(sorted(groups.items()))

    def total(self, sigma: Array) -> Triangle:
        """Return the triangle of all rows that inform, each divided by its coordinate's sigma."""
        return weighted_total(self.totals, sigma)

    @property
    def rms_torque(self) -> Array:
        """Rms (d,) of the measured torque [N m | N]."""
        squares, rows = np.zeros((2, self.d))
        for block in self:
            squares[block.coordinate] += sum(block.torque)
            rows[block.coordinate] += block.rows
        return np.asarray(np.sqrt(squares / np.maximum(rows, 1)))

    def squares(self, x: Array) -> Squares:
        """Return what a solution x (k,) leaves in all rows, those at standstill included."""
        sums = np.zeros((2, 3, self.d))
        for u, blocks in self.by_coordinate.items():
            informing, rest, still = (
                _squares([block.triangles[i] for block in blocks], x[blocks[0].support])
                for i in range(3)
            )
            rest_rows = [block.rest_rows for block in blocks if block.rest_rows and block.resting]
            informing -= _squares(rest_rows, x[blocks[0].support])
            idle = sum(block.rest.rows + block.still.rows for block in blocks)
            torque, torque_idle = np.sum([block.torque for block in blocks], axis=0)
            rows = sum(block.rows for block in blocks)
            sums[0, :, u] = max(informing - still, 0.0), torque, rows - idle
            sums[1, :, u] = rest + still, torque_idle, idle
        return Squares(*sums)


def _squares(triangles: Sequence[Triangle], x: Array) -> float:
    """Return |A x − b|² of all rows of several triangles."""
    triangles = [triangle for triangle in triangles if triangle.rows]
    if not triangles:
        return 0.0
    r = np.concatenate([t.R for t in triangles]) @ x - np.concatenate([t.d for t in triangles])
    return float(r @ r) + sum(t.rho**2 for t in triangles)


@dataclass(frozen=True, eq=False)
class Part:
    """Rows of one coordinate in the order of blocks, or triangles of them."""

    coordinate: int  # whose weight they have
    columns: Index  # (s,) which of all columns these rows have; the others are zero in them
    X: Array  # (m, ·) the first of these columns
    Y: Array  # (m, 1 + B)
    edges: Index  # (blocks + 1,) rows at which blocks begin, equally many in all parts
    # (m, ·) columns that were added later; X is large and is not copied for each of them
    more: tuple[Array, ...] = ()

    def added(self, C: Array, columns: Index) -> Part:
        """The same rows with further columns C (m, u), which are those of all columns."""
        return replace(self, columns=np.append(self.columns, columns), more=(*self.more, C))

    @property
    def squares(self) -> Array:
        """(s,) squares of each column."""
        return np.concatenate([np.einsum("ij,ij->j", X, X) for X in (self.X, *self.more)])

    def block(self, k: int) -> slice:
        """Rows of one block."""
        return slice(int(self.edges[k]), int(self.edges[k + 1]))

    def taken(self, columns: Index) -> Array:
        """Some of all columns (m, u); zero where these rows do not have them."""
        last = max(self.columns.max(initial=0), columns.max(initial=0))
        return self.at(places(self.columns, int(last) + 1)[columns])

    def at(self, places: Index) -> Array:
        """Columns (m, u) at some places among these; zero where a place is −1."""
        if not self.more and (places >= 0).all():
            if len(places) and (np.diff(places) == 1).all():  # neighbours are not copied
                return self.X[:, places[0] : places[-1] + 1]
            return self.X[:, places]
        columns, first = np.zeros((len(self.X), len(places))), 0
        for X in (self.X, *self.more):
            in_X = (places >= first) & (places < first + X.shape[1])
            columns[:, in_X] = X[:, places[in_X] - first]
            first += X.shape[1]
        return columns


def places(columns: Index, total: int) -> Index:
    """(total,) where each column is among a part's, −1 where it is not."""
    place = np.full(total, -1, dtype=np.intp)
    place[columns] = np.arange(len(columns))
    return place
