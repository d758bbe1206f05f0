"""The noun that a diagnosis is: where the model fails, what is missing, how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ident.diagnose.choose import Choice
from ident.diagnose.explanation import Explanation
from ident.diagnose.hidden import Invisible
from ident.diagnose.output import diagnosis_json, write_diagnosis
from ident.diagnose.plots import plot_candidates
from ident.diagnose.suggest import Suggestion
from ident.diagnose.support import Unsupported
from ident.diagnose.tables import candidate_rows, summary, verdict_line, where_rows
from ident.effects import Effect
from ident.fit import Fit
from ident.health import Health
from ident.residual import Failure, Periods
from ident.show.charts import Chart
from ident.show.html import Shown, folded, paragraph, strong, table


@dataclass(frozen=True, eq=False)
class Diagnosis(Shown):
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
        return diagnosis_json(self)

    def write(self, folder: str | Path) -> list[Path]:
        """diagnosis.json, report.html, and suggestion.py if there is one; all of them or none.

        Raises:
            IdentError: if the folder cannot be written.
        """
        return write_diagnosis(self, folder)

    def plot(self) -> Chart:
        """Held-out fall of the best candidates, those that cannot be told from the best in grey."""
        return plot_candidates(self)

    def __str__(self) -> str:
        return summary(self)

    __repr__ = __str__

    def _blocks(self) -> tuple[Markup, ...]:
        blocks = [strong(verdict_line(self)), table(where_rows(self), "Where the model fails")]
        if self.candidates:
            blocks.append(table(candidate_rows(self), "What adding an effect would do, held out"))
        words = (paragraph(each) for each in self.text.split("\n\n"))
        return *blocks, folded("In words", *words)
