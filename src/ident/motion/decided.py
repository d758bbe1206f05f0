"""What is decided once for a whole log, so that its parts, each worked alone, make one motion.

A log is completed on one clock, by splines with one set of knots, with one noise for each channel.
A part of it that decided anew would differ from its neighbours, and from the log in one piece.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ident.log import Log


@dataclass(frozen=True, eq=False)
class Clock:
    """The uniform clock of a whole log.

    Attributes:
        t0: its first time [s]; step [s]; count: of its instants.
        even: whether the log's own times are uniform, and taken as they are.
        grid: instants from one at which a part may begin to the next, so that filtered rows of all
            parts are kept at the same ones.
    """

    t0: float
    step: float
    count: int
    even: bool
    grid: int = 1

    @property
    def t_end(self) -> float:
        """Its last time [s]."""
        return self.t0 + self.step * (self.count - 1)

    def within(self, log: Log) -> np.ndarray:
        """Its instants (n,) [s] within a part of the log."""
        if self.even:
            return np.asarray(log.t)
        first = self.grid * np.ceil((log.t[0] - self.t0) / self.step / self.grid - 1e-9)
        last = np.floor((log.t[-1] - self.t0) / self.step + 1e-9)
        return self.t0 + self.step * np.arange(first, last + 1)


@dataclass(frozen=True, eq=False)
class Decided:
    """What the parts of a log have in common.

    Attributes:
        clock: of the log.
        noisy: joints that are smoothed.
        carriers: joints in which the splines are; others than those that are smoothed where more
            are logged than needed.
        knots: their distance [s]; one is at the clock's first instant.
        noise: of the smoothed channels, by column.
        ends: time [s] at the ends of a run where splines are not to be trusted.
    """

    clock: Clock
    noisy: tuple[str, ...] = ()
    carriers: tuple[str, ...] = ()
    knots: float = 0.0
    noise: Mapping[str, float] = field(default_factory=dict)
    ends: float = 0.0
