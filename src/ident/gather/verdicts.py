"""What each of many logs says is missing, beside what all of them say together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import polars as pl
from markupsafe import Markup

from ident.diagnose import Diagnosis
from ident.diagnose.output import write_diagnosis
from ident.diagnose.phrases import listed
from ident.show.html import Section, Shown, items
from ident.show.html import table as html_table
from ident.tables import percent, table

SAYS = {
    "likely": "likely, but not first, in",
    "no": "not missing in",
    "hidden": "not to be seen in",
}


@dataclass(frozen=True)
class Verdict:
    """The diagnosis of one log, in short.

    Attributes:
        log: its name; samples: of it.
        verdict: `missing`, `nothing` or `unexplained`.
        named: labels of the effect that it names and of those it cannot tell from it.
        likely: of all effects for which something speaks in this log; hidden: of those that it
            cannot show.
        joint: whose error the first of `named` lowers; before, after: held out, as a share.
        left_out: why there is no diagnosis; empty if there is.
    """

    log: str
    samples: int = 0
    verdict: str = ""
    named: tuple[str, ...] = ()
    likely: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    joint: str = ""
    before: float | None = None
    after: float | None = None
    left_out: str = ""

    @classmethod
    def of(cls, log: str, samples: int, d: Diagnosis) -> Verdict:
        """From a log's diagnosis."""
        named = () if d.best is None else tuple(e.label for e in (d.best, *d.rivals))
        first = d.candidates[0] if named else None
        return cls(
            log,
            samples,
            d.verdict,
            named,
            tuple(e.candidate.effect.label for e in d.choice.evidence if e.credible),
            tuple(each.effect.label for each in d.invisible),
            first.joint if first else "",
            first.error_before if first else None,
            first.error_after if first else None,
        )

    def says(self, label: str) -> str:
        """Of an effect: `named`, `likely`, `hidden` or `no`."""
        kinds = {"named": self.named, "likely": self.likely, "hidden": self.hidden}
        return next((kind for kind, labels in kinds.items() if label in labels), "no")


@dataclass(frozen=True, eq=False)
class Verdicts(Shown):
    """Made by `ident.diagnose_each`.

    Attributes:
        together: the diagnosis of all logs as one.
        logs: what each says by itself, in the order in which they were given.
    """

    together: Diagnosis
    logs: tuple[Verdict, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """Which logs were left out and why, and what the fit of all logs says."""
        out = [f"{each.log}: left out: {each.left_out}" for each in self.logs if each.left_out]
        return (*out, *self.together.fit.warnings)

    @property
    def asked(self) -> tuple[str, ...]:
        """Labels of effects that the logs together name, else of those that any names."""
        d = self.together
        if d.best is not None:
            return tuple(each.label for each in (d.best, *d.rivals))
        return tuple(dict.fromkeys(label for each in self.logs for label in each.named))

    @cached_property
    def table(self) -> pl.DataFrame:
        """One row a log: `log`, `samples`, `verdict`, `named`, `joint`, `error_before`,
        `error_after` (held out, as a share), `left_out` (why), and for each of `asked` a column
        with `named`, `likely`, `hidden` or `no`.
        """
        rows = [
            {
                "log": each.log,
                "samples": each.samples,
                "verdict": each.verdict or None,
                "named": " ".join(each.named) or None,
                "joint": each.joint or None,
                "error_before": each.before,
                "error_after": each.after,
                "left_out": each.left_out or None,
                **{label: each.says(label) if each.verdict else None for label in self.asked},
            }
            for each in self.logs
        ]
        words = ("log", "verdict", "named", "joint", "left_out", *self.asked)
        types = dict.fromkeys(words, pl.String) | dict.fromkeys(
            ("error_before", "error_after"), pl.Float64
        )
        return pl.DataFrame(rows, schema_overrides=types)

    @property
    def votes(self) -> tuple[str, ...]:
        """For each of `asked`, how many logs name it, and which say otherwise."""
        return tuple(self._vote(label) for label in self.asked)

    def _vote(self, label: str) -> str:
        kept = [each for each in self.logs if each.verdict]
        by: dict[str, list[str]] = {}
        for each in kept:
            by.setdefault(each.says(label), []).append(each.log)
        said = [f"named by {len(by.get('named', ()))} of {len(kept)} logs"]
        said += [f"{words} {listed(by[kind])}" for kind, words in SAYS.items() if kind in by]
        return f"{label}: {'; '.join(said)}"

    def write(self, folder: str | Path) -> list[Path]:
        """diagnosis.json and report.html of all logs together, and logs.csv.

        Args:
            folder: made if it is not there.

        Returns:
            The files written, all of them or none.

        Raises:
            IdentError: if the folder cannot be written.
        """
        said = [*self.votes, *self.notes]
        blocks = html_table(self._rows(), "Each by itself"), *((items(said),) if said else ())
        section = Section("Log by log", blocks)
        return write_diagnosis(
            self.together, folder, {"logs.csv": self.table.write_csv().encode()}, [section]
        )

    def _rows(self) -> list[list[str]]:
        rows = [["log", "samples", "verdict", "of", "error", "with it"]]
        for each in self.logs:
            if each.left_out:
                rows.append([each.log, "–", "left out", "", "", ""])
                continue
            verdict = each.verdict + (f": {' or '.join(each.named)}" if each.named else "")
            errors = (percent(each.before), percent(each.after)) if each.named else ("", "")
            rows.append([each.log, str(each.samples), verdict, each.joint, *errors])
        return rows

    def __str__(self) -> str:
        lines = ["each log by itself", *table(self._rows()), *self.votes, "", "all logs together"]
        return "\n".join([*lines, str(self.together)])

    __repr__ = __str__

    def _blocks(self) -> tuple[Markup, ...]:
        said = (items(self.votes),) if self.votes else ()
        return html_table(self._rows(), "Each log by itself"), *said, *self.together._blocks()
