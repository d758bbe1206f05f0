"""The rows' zero-phase filter as a fixed lag of half its length.

A symmetric filter of 2 M + 1 taps has all that it needs of a row M samples later, so filtered rows
that come with this lag are those of a batch, number by number.
"""

from __future__ import annotations

import numpy as np

from ident.equations.filter import Decimator
from ident.equations.rows import STICKING, Rows

FIELDS = ("t", "sample", "A", "b", "tau", "informed")


class FixedLag:
    """Rows in, filtered and decimated rows out.

    Args:
        cutoff: of the filter [Hz], None passes all rows as they come; rate: of the rows [Hz].
        sticking: a row informs if less than this share of it comes from samples that do not.
    """

    def __init__(self, cutoff: float | None, rate: float, sticking: float = STICKING) -> None:
        self._filter, self._sticking = Decimator.of(cutoff, rate), sticking
        self._kept: dict[str, np.ndarray] = {}  # with room for what comes
        self._first, self._count, self._next = 0, 0, 0  # number of the first row kept; next centre

    @property
    def half(self) -> int:
        """The lag in samples."""
        return self._filter.half

    @property
    def every(self) -> int:
        """Samples from one row that is kept to the next."""
        return self._filter.factor

    def __call__(self, raw: Rows) -> Rows | None:
        """The rows that are known by now, of raw rows that follow one by one."""
        if self._filter.taps is None:
            return raw
        if not self._kept or raw.sample[0] != self._first + self._count:
            self._begin(raw)
        self._store(raw)
        end = self._first + self._count
        centres = np.arange(self._next, end - self.half, self._filter.factor)
        if not len(centres):
            return None
        self._next = int(centres[-1]) + self._filter.factor
        inside, local = slice(0, self._count), centres - self._first
        kept = {name: self._kept[name][: self._count] for name in FIELDS}
        A, b, tau = (self._filter.apply(kept[name], inside, local) for name in ("A", "b", "tau"))
        shut = (~kept["informed"]).astype(float)
        open_ = self._filter.apply(shut, inside, local, absolute=True)
        return Rows(kept["t"][local], centres, A, b, tau, open_ < self._sticking)

    def _begin(self, raw: Rows) -> None:
        """Begins anew: nothing is filtered across a gap."""
        self._first, self._count = int(raw.sample[0]), 0
        self._next = self._first + self.half

    def _store(self, raw: Rows) -> None:
        """Appends rows; those that no centre needs any more make room."""
        n = len(raw.t)
        room = 4 * self.half + n
        if not self._kept or len(self._kept["t"]) < self._count + n:
            spent = max(0, min(self._next - self.half - self._first, self._count))
            for name in FIELDS:
                new = getattr(raw, name)
                wide = np.empty((max(room, self._count - spent + n), *new.shape[1:]), new.dtype)
                if self._count > spent:
                    wide[: self._count - spent] = self._kept[name][spent : self._count]
                self._kept[name] = wide
            self._first, self._count = self._first + spent, self._count - spent
        for name in FIELDS:
            self._kept[name][self._count : self._count + n] = getattr(raw, name)
        self._count += n
