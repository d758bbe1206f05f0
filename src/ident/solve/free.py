"""What is free of multipliers, by block of time: a `Border` that is a noun, and merges."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.errors import FitError
from ident.solve.border import earned, knots_of
from ident.solve.factor import Factor
from ident.solve.intervals import Free, Index


@dataclass(frozen=True, eq=False)
class Freed:
    """Equations of k parameters alone, in the block of time in which they became free.

    Attributes:
        begins: knots at which a new block begins, ascending.
        k: parameters.
        factors: by number of the block, where there is any.
        balance: (blocks,) equations less unknowns.
    """

    begins: Index
    k: int
    factors: Mapping[int, Factor]
    balance: Index

    @classmethod
    def empty(cls, begins: Sequence[int] | Index, group: int, k: int) -> Freed:
        """Nothing; blocks begin at these basis functions, of which `group` are a knot."""
        knots = knots_of(np.asarray(begins, dtype=int), group)
        return cls(knots, k, {}, np.zeros(len(knots) + 1, dtype=int))

    def counting(self, place: Index, equations: int | Index) -> Freed:
        """With equations that came (or, negative, that a multiplier used up) at places, knots."""
        balance = self.balance.copy()
        np.add.at(balance, self._block(place), equations)
        return replace(self, balance=balance)

    def with_rows(self, free: Iterable[Free]) -> Freed:
        """With rows that touch no multiplier any more."""
        factors = dict(self.factors)
        for place, rows in free:
            block = np.repeat(self._block(place), rows.shape[1])
            flat = rows.reshape(-1, rows.shape[-1])
            for number in np.unique(block).tolist():
                mine = flat[block == number]
                before = factors.get(number, Factor.empty(self.k))
                factors[number] = before.updated(mine[:, :-1], mine[:, -1])
        return replace(self, factors=factors)

    def __add__(self, other: Freed) -> Freed:
        """Both.

        Raises:
            FitError: for other blocks.
        """
        if not np.array_equal(self.begins, other.begins):
            raise FitError(f"blocks from {other.begins} after {self.begins}; valid: the same")
        factors = dict(self.factors)
        for number, factor in other.factors.items():
            factors[number] = factors[number] + factor if number in factors else factor
        return replace(self, factors=factors, balance=self.balance + other.balance)

    def finished(self) -> tuple[Factor, ...]:
        """A factor a block; one short of equations owes them to the next ones."""
        none, rows = Factor.empty(self.k), earned(self.balance)
        return tuple(
            replace(self.factors.get(number, none), rows=int(n)) for number, n in enumerate(rows)
        )

    def _block(self, place: Index) -> Index:
        return np.searchsorted(self.begins, place, side="right")
