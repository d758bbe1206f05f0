"""The noun `Gathered`: one fit of logs that need not fit into memory."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ident.display import Displayed, render
from ident.files import check_writable
from ident.fit import Fit
from ident.fit.output import multipliers_rows, write_fit
from ident.fit.reach import identifiable_multipliers
from ident.fit.reactions import Reactions
from ident.fit.regression import Regression
from ident.streams.checkpoint import Checkpoint
from ident.streams.logs import Workers
from ident.streams.many_logs import LogTable, compare_logs
from ident.streams.plan import Plan
from ident.streams.portions import multipliers_of


@dataclass(frozen=True, eq=False, repr=False)
class Gathered(Displayed):
    """One fit of many portions of logs. Made by `ident.gather`.

    Attributes:
        fit: of all logs; its motion, and with it every picture, is an excerpt.
        regression: all rows as triangles; `Block.log` is the number of the log in the plan.
        plan: what all portions had in common; its parts are the logs that were opened.
        workers: who did the work.
        worked, resumed: portions worked in this run, and those found in a checkpoint.
        checkpoint: the file of what is done, if one was kept; removed once the fit is written.
    """

    fit: Fit
    regression: Regression
    plan: Plan
    workers: Workers
    worked: int
    resumed: int
    checkpoint: Checkpoint | None = None

    @property
    def broken(self) -> Mapping[str, str]:
        """By name of a log, why it was left out."""
        return self.workers.broken

    @property
    def several(self) -> bool:
        """Whether several logs were given."""
        return not self.workers.alone

    @cached_property
    def each(self) -> LogTable:
        """The logs one by one, and which of them disagree with the others."""
        names = {i: part.name for i, part in enumerate(self.plan.parts)}
        samples = {part.name: part.samples for part in self.plan.parts}
        return compare_logs(self.regression, names, samples, self.broken)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know before trusting the fit, logs that were left out among it."""
        return (*self.fit.warnings, *(self.each.notes if self.several else ()))

    @property
    def summary(self) -> str:
        """What `print` shows, without the notes."""
        return str(render(self, "summary"))

    def write(self, folder: str | Path, reactions: Reactions | None = None) -> list[Path]:
        """Write what `Fit.write` writes, multipliers of all samples, and end the checkpoint.

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
        fit, more, sections = self.fit, {}, []
        if self.several:
            more = {"logs.csv": self.each.table.write_csv().encode()}
            sections = [render(self.each, "section")]
            if self.each.odd:  # said first, since other notes may follow from it
                said = f"{render(self.each, 'sentence')}: see Log by log"
                fit = replace(fit, warnings=(said, *fit.warnings))
        with self._multipliers(folder) as multipliers:
            paths = write_fit(fit, folder, reactions, multipliers, more, sections)
        if self.checkpoint is not None:
            self.checkpoint.remove()
        return paths

    @contextlib.contextmanager
    def _multipliers(self, folder: Path) -> Iterator[Path | None]:
        """Write a hidden file with the multipliers of all samples, removed unless it is moved."""
        if not self.fit.mechanism.kinematics.multipliers:
            yield None
            return
        folder.mkdir(parents=True, exist_ok=True)
        for stale in folder.glob(".multipliers.csv.*.part"):  # of a run that was killed
            stale.unlink(missing_ok=True)
        file = folder / f".multipliers.csv.{secrets.token_hex(4)}.part"
        try:
            with file.open("xb") as stream:
                for rows in self._multiplier_rows():
                    stream.write(rows)
            yield file
        finally:
            file.unlink(missing_ok=True)

    def _multiplier_rows(self) -> Iterator[bytes]:
        """Yield the rows of all portions in order, the header first, in a second pass."""
        plan, names = replace(self.plan, point=self.fit.point), self.plan.mechanism.kinematics
        logs = [i for i, part in enumerate(plan.parts) if part.name not in self.broken]
        portions = [portion for i in logs for portion in plan.portions(i)]
        determined = identifiable_multipliers(plan.mechanism, self.fit.motion)
        of = [plan.parts[portion.log].name for portion in portions]
        nothing = np.empty(0), np.empty((0, len(names.multipliers)))
        early, at, several = {-1: nothing}, -1, len(logs) > 1
        done = self.workers.over(multipliers_of, portions, plan, of, "multipliers")
        while True:
            while at in early:
                t, values = early.pop(at)
                values = np.where(determined, values, np.nan)
                log = (of[at] if at >= 0 else "") if several else None
                yield multipliers_rows(names.multipliers, t, values, log, header=at < 0)
                at += 1
            if (each := next(done, None)) is None:
                return
            early[each[0]] = each[1] or nothing
