"""The one axis on which errors are drawn, in terminals, notebooks and pages: logarithmic, in %.

    position(e) = (log10 e − low) / (high − low)        e: share of the measured torque

It reaches from 0.1 % to 100 %, and farther where an error lies outside: nothing is cut, and two
pages can be compared. ○ is the error before, ● the one now, │ what noise leaves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

LOW, HIGH = 1e-3, 1.0  # shown: 0.1 % and 100 % of the torque
SMALLEST = 1e-16  # numerics: an error below is rounding, and drawn at the left end
ENDS = (1.0, 2.0, 5.0, 10.0)  # shown: times a power of ten, where a longer axis may end
# shown: numbers at most above an axis; a longer one has them at every second or third decade
TICKS = 4
BEFORE, NOW, NOISE, WAY = "○", "●", "│", "─"  # the way leads from before to now
KEY_BEFORE, KEY_NOW, KEY_NOISE = f"{BEFORE} before", f"{NOW} now", f"{NOISE} noise alone"


@dataclass(frozen=True)
class ErrorAxis:
    """A logarithmic axis of errors, which are shares of the torque.

    Attributes:
        low, high: errors at its ends.
    """

    low: float = LOW
    high: float = HIGH

    @classmethod
    def of(cls, errors: Iterable[float | None]) -> ErrorAxis:
        """Return the axis that holds all errors; those that are 0 or not known need no room."""
        known = [e for e in errors if e and math.isfinite(e)]
        low, high = max(min([LOW, *known]), SMALLEST), max([HIGH, *known])
        down, up = (10.0 ** math.floor(math.log10(x)) for x in (low, high))
        return cls(
            LOW if low >= LOW else max(down * x for x in ENDS if down * x <= low),
            HIGH if high <= HIGH else min(up * x for x in ENDS if up * x >= high),
        )

    def position(self, error: float) -> float:
        """Return where an error lies, 0 at the left end and 1 at the right one."""
        if error <= self.low:
            return 0.0
        return math.log(error / self.low) / math.log(self.high / self.low)

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Position and words of the decades, as `10 %`; of a long axis of some of them."""
        first, last = (
            math.ceil(math.log10(self.low) - 1e-9),
            math.floor(math.log10(self.high) + 1e-9),
        )
        step = math.ceil((last - first + 1) / TICKS)
        decades = reversed(range(last, first - 1, -step))
        return [(self.position(10.0**d), f"{float(f'1e{d + 2}'):g} %") for d in decades]

    @property
    def percents(self) -> tuple[float, float]:
        """Ends of the axis [%]."""
        return 100 * self.low, 100 * self.high

    def ruler(self, cells: int) -> str:
        """Return the ticks as text above strips of so many cells, each number at its decade."""
        line = [" "] * cells
        for position, words in reversed(self.ticks):  # the last one has room
            at = self.cell(position, cells)
            start = min(max(at - len(words) // 2, 0), cells - len(words))
            around = line[max(start - 1, 0) : start + len(words) + 1]
            if start >= 0 and not "".join(around).strip():
                line[start : start + len(words)] = words
        return "".join(line).rstrip()

    @staticmethod
    def cell(position: float, cells: int) -> int:
        """Return the number of the cell, from 0, of a position among so many."""
        return round(position * (cells - 1))

    def strip(self, cells: int, before: float | None, now: float, noise: float | None) -> str:
        """Return a line of cells with the marks of one joint; of two in one cell the later one:
        noise, before, now.
        """
        line = ["·"] * cells
        if before is not None:
            ends = sorted(self.cell(self.position(e), cells) for e in (before, now))
            line[ends[0] : ends[1] + 1] = WAY * (ends[1] - ends[0] + 1)
        for error, mark in ((noise, NOISE), (before, BEFORE), (now, NOW)):
            if error is not None:
                line[self.cell(self.position(error), cells)] = mark
        return "".join(line)
