"""The noun that all checks together are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ident.health.check import Check
from ident.show.html import Shown
from ident.text import table


@dataclass(frozen=True)
class Health(Shown):
    """The health of the logged data. Made by `ident.health`.

    Attributes:
        checks: all of them, bad ones first.
    """

    checks: tuple[Check, ...]

    @property
    def findings(self) -> tuple[Check, ...]:
        """What is bad."""
        return tuple(check for check in self.checks if check.bad)

    @property
    def good(self) -> bool:
        """Whether nothing is bad."""
        return not self.findings

    def json(self) -> list[dict[str, Any]]:
        """One dictionary a check."""
        return [check.json() for check in self.checks]

    def __str__(self) -> str:
        rows = [["check", "channel", "number", "threshold", ""]]
        for c in self.checks:
            if c.number == c.number:
                number = f"{c.number:.3g} {c.unit}".strip()
                limit = f"{c.threshold:.3g}" if c.threshold == c.threshold else "–"
                rows.append([c.name, c.where, number, limit, "bad" if c.bad else ""])
        title = "health of the data: " + (
            "nothing is wrong" if self.good else f"{len(self.findings)} finding(s)"
        )
        said = [
            f"{'! ' if c.bad else 'note: '}{c}"
            for c in self.checks
            if c.bad or c.number != c.number
        ]
        return "\n".join([title, *table(rows), *said])

    __repr__ = __str__
