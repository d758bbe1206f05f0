"""The noun: one fit of logs that need not fit into memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from ident.files import check_writable
from ident.fit import Fit
from ident.fit.output import write_fit
from ident.fit.reactions import Reactions
from ident.fit.regression import Regression
from ident.fit.summary import summary
from ident.gather.checkpoint import Checkpoint
from ident.gather.crew import Crew
from ident.gather.each import Each
from ident.gather.multipliers import written
from ident.gather.one_by_one import each_of
from ident.gather.plan import Plan
from ident.show.html import Shown


@dataclass(frozen=True, eq=False, repr=False)
class Gathered(Shown):
    """One fit of many portions of logs. Made by `ident.gather`.

    Attributes:
        fit: of all logs; its motion, and with it every picture, is an excerpt.
        regression: all rows as factors; `Cell.experiment` is the number of the log in the plan.
        plan: what all portions had in common; its parts are the logs that were opened.
        broken: by name of a log, why it was left out.
        worked, resumed: portions worked in this run, and those found in a checkpoint.
        crew: who did the work.
        checkpoint: the file of what is done, if one was kept; gone once the fit is written.
    """

    fit: Fit
    regression: Regression
    plan: Plan
    broken: Mapping[str, str]
    worked: int
    resumed: int
    crew: Crew
    checkpoint: Checkpoint | None = None

    @cached_property
    def each(self) -> Each:
        """The logs one by one, and which of them disagree with the others."""
        names = {i: part.name for i, part in enumerate(self.plan.parts)}
        samples = {part.name: part.samples for part in self.plan.parts}
        return each_of(self.regression, names, samples, self.broken)

    @property
    def several(self) -> bool:
        """Whether several logs were given."""
        return not self.crew.alone

    def write(self, folder: str | Path, reactions: Reactions | None = None) -> list[Path]:
        """What `Fit.write` writes, multipliers of all samples among it, and ends the checkpoint.

        Of several logs logs.csv too, one row a log, and a table in the report.

        Args:
            folder: made if it is not there.
            reactions: known ones, which the report draws beside the multipliers.

        Returns:
            The files written, all of them or none.

        Raises:
            IdentError: if the folder cannot be written, or a log no longer be read.
        """
        folder = Path(folder)
        check_writable(folder)
        with written(self, folder) as multipliers:
            more = {"logs.csv": self.each.csv()} if self.several else {}
            sections = [self.each.section()] if self.several else []
            fit = self.fit
            if self.several and self.each.odd:  # said first, since other notes may follow from it
                fit = replace(fit, warnings=(f"{self.each.words}: see Log by log", *fit.warnings))
            paths = write_fit(fit, folder, reactions, multipliers, more, sections)
        if self.checkpoint is not None:
            self.checkpoint.remove()
        return paths

    @property
    def summary(self) -> str:
        """What `print` shows, without the notes."""
        said = summary(self.fit)
        return f"{said}\n\n{self.each.summary}" if self.several else said

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know before trusting the fit, logs that were left out among it."""
        return (*self.fit.warnings, *(self.each.notes if self.several else ()))

    def __str__(self) -> str:
        return "\n".join([self.summary, *(f"note: {note}" for note in self.notes)])

    __repr__ = __str__
