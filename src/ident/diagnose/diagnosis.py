"""The noun that a diagnosis is: where the model fails, what is missing, how sure that is."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ident.diagnose.choose import Choice
from ident.diagnose.explanation import Explanation, name_of
from ident.diagnose.hidden import Invisible
from ident.diagnose.suggest import Suggestion
from ident.diagnose.support import Unsupported
from ident.effects import Effect
from ident.fit import Fit
from ident.health import Health
from ident.residual import Failure, Periods

SCHEMA = "ident.diagnosis/1"


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Where a model fails and which effects would explain it. Made by `ident.diagnose`.

    Attributes:
        fit: what was diagnosed.
        verdict: `missing` (one effect, or rivals that this data cannot tell apart), `nothing` (the
            residual is noise) or `unexplained` (structure is left that no effect explains).
        health: of the data; where: by joint, worst first; periods: if the motion repeats.
        candidates: refitted, best first; choice: the evidence on all others.
        invisible: effects that this data cannot show; unsupported: of the model, better removed.
        suggestion: for what is unexplained, an expression of the signals, if one explains it.
        floor: by joint, rms of a residual of nothing but noise [N m | N].
        next_experiment: which motion would tell more; text: all of it in plain words.
    """

    fit: Fit
    verdict: str
    health: Health
    where: tuple[Failure, ...]
    periods: Periods | None
    candidates: tuple[Explanation, ...]
    choice: Choice
    invisible: tuple[Invisible, ...]
    unsupported: tuple[Unsupported, ...]
    suggestion: Suggestion | None
    floor: dict[str, float]
    next_experiment: str
    text: str

    @property
    def best(self) -> Effect | None:
        """The missing effect, for `mechanism + diagnosis.best`; None if none is named."""
        return self.candidates[0].effect if self.verdict == "missing" else None

    @property
    def rivals(self) -> tuple[Effect, ...]:
        """Effects that this data cannot tell from the best."""
        return self.candidates[0].rivals if self.verdict == "missing" else ()

    def json(self) -> dict[str, Any]:
        """The content of diagnosis.json."""
        return {
            "schema": SCHEMA,
            "mechanism": self.fit.mechanism.name,
            "logs": [e.name for e in self.fit.motion.experiments],
            "effects": [name_of(effect) for effect in self.fit.mechanism.effects],
            "verdict": self.verdict,
            "where": [each.json() for each in self.where],
            "floor": self.floor,
            "candidates": [each.json() for each in self.candidates],
            "best": None if self.best is None else name_of(self.best),
            "invisible": [each.json() for each in self.invisible],
            "unsupported": [each.json() for each in self.unsupported],
            "suggestion": None if self.suggestion is None else self.suggestion.json(),
            "health": self.health.json(),
            "judged": len(self.choice.evidence),
            "next_experiment": self.next_experiment,
            "text": self.text,
        }

    def write(self, folder: str | Path) -> list[Path]:
        """diagnosis.json and report.html in a folder, both or none.

        Raises:
            IdentError: if the folder cannot be written.
        """
        from ident.diagnose.output import write_diagnosis  # it draws what this file defines

        return write_diagnosis(self, folder)

    def __str__(self) -> str:
        from ident.diagnose.tables import summary  # it prints what this file defines

        return summary(self)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"
