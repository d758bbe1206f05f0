"""The equations of p as they become free of multipliers, by block of time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ident.errors import FitError
from ident.solve.factor import Array, Factor
from ident.solve.intervals import Free, Index


class Border:
    """Collects free rows (n, r, k + 1) into one `Factor` a block; places are knots."""

    def __init__(self, blocks: int | Sequence[int], count: int, group: int, k: int) -> None:
        """`blocks`: how many, of equal length, or the basis functions at which a new one begins.

        There are `count` basis functions, `group` to a knot, and k parameters.
        """
        if isinstance(blocks, int | np.integer):
            begins = np.arange(1, blocks) * count // max(blocks, 1)
        else:
            begins = np.asarray(blocks, dtype=int)
        if (isinstance(blocks, int) and blocks < 1) or (np.diff(begins) < 0).any():
            raise FitError(f"blocks {blocks}; valid: a number >= 1, or ascending basis functions")
        self.begins = knots_of(begins, group)
        self.factors = [Factor.empty(k)] * (len(begins) + 1)
        self.balance = np.zeros(len(begins) + 1, dtype=int)  # equations less unknowns, by block

    def count(self, place: Index, equations: int | Index) -> None:
        """Equations that came (or, negative, that a multiplier used up) at `place`."""
        np.add.at(self.balance, self._block(place), equations)

    def absorb(self, freed: Iterable[Free]) -> None:
        """Take rows in; one update a block, however many batches they come from."""
        parts: list[list[Array]] = [[] for _ in self.factors]
        for place, rows in freed:
            cuts = np.searchsorted(self._block(place), np.arange(len(parts) + 1))
            for part, low, high in zip(parts, cuts, cuts[1:], strict=False):
                if high > low:
                    part.append(rows[low:high].reshape(-1, rows.shape[-1]))
        for block, part in enumerate(parts):
            if part:
                stack = np.concatenate(part)
                self.factors[block] = self.factors[block].updated(stack[:, :-1], stack[:, -1])

    def finished(self) -> tuple[Factor, ...]:
        """The factors; a block short of equations of its own owes them to the next ones."""
        rows = earned(self.balance)
        return tuple(replace(f, rows=int(n)) for f, n in zip(self.factors, rows, strict=True))

    def _block(self, place: Index) -> Index:
        return np.searchsorted(self.begins, place, side="right")


def knots_of(begins: Index, group: int) -> Index:
    """The knots of `group` functions at which blocks begin, from the functions at which they do."""
    return -(-np.asarray(begins, dtype=int) // group)


def earned(balance: Index) -> Index:
    """Rows of each block, from its equations less its unknowns; a debt is paid by the next ones."""
    sums = np.maximum.accumulate(np.maximum(np.cumsum(balance), 0))
    return np.diff(np.minimum(sums, max(int(np.sum(balance)), 0)), prepend=0)
