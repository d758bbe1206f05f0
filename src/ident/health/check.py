"""One check of the logged data: a number, its threshold, what it means and what to do."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Check:
    """A judgement on one or more channels.

    Attributes:
        name: of the check: `sign`, `swapped`, `scale`, `command`, `delay`, …
        channels: columns it is about (`tau.elbow`, `q.elbow`); empty: the whole log.
        number: what was measured, in `unit`; NaN where the check has none.
        threshold: at which it is bad; NaN where nothing can be bad.
        bad: whether a person should act before naming any missing effect.
        meaning: what is so, and what a person sees in the plot.
        remedy: what to do, in the words of mechanism.toml; empty where nothing is to be done.
    """

    name: str
    channels: tuple[str, ...]
    number: float
    threshold: float
    bad: bool
    meaning: str
    remedy: str = ""
    unit: str = ""

    def __post_init__(self) -> None:  # NumPy's own numbers are no JSON
        object.__setattr__(self, "number", float(self.number))
        object.__setattr__(self, "threshold", float(self.threshold))
        object.__setattr__(self, "bad", bool(self.bad))

    @property
    def where(self) -> str:
        """The channels in one string."""
        return ", ".join(self.channels) or "log"

    def json(self) -> dict[str, Any]:
        """As JSON has it: a number that is not finite is None."""
        found = asdict(self)
        for key in ("number", "threshold"):
            found[key] = found[key] if math.isfinite(found[key]) else None
        return found | {"channels": list(self.channels)}

    def __str__(self) -> str:
        remedy = f"; {self.remedy}" if self.bad and self.remedy else ""
        return f"{self.where}: {self.meaning}{remedy}"
