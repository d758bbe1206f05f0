"""Of many logs one by one: errors of the joint model and of their own, and which disagree."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import polars as pl
from markupsafe import Markup

from ident.gather.disagree import RATE, Disagreement
from ident.show.html import Section, Shown, items
from ident.show.html import table as html_table
from ident.tables import percent, rounded, table

NAMED = 6  # logs; more are counted
POOR = 0.05  # of the torque: a model that leaves more hides differences between logs
MOSTLY = 0.9  # of a log's difference, that a part must explain to be named
TINY = 1e-12  # a smaller chance is printed as this


@dataclass(frozen=True)
class Alone:
    """One log among others.

    Attributes:
        log: its name; samples: of it.
        error, own: of the joint model and of the log's own fit in this log, a share of the typical
            torque, all joints weighed alike; None where nothing could be compared.
        worst: the joint in which the joint model does worst beside the own fit.
        disagreement: with the majority of the others; None where there are none.
        left_out: why it is in no fit; empty if it is.
    """

    log: str
    samples: int = 0
    error: float | None = None
    own: float | None = None
    worst: str = ""
    disagreement: Disagreement | None = None
    left_out: str = ""

    @property
    def disagrees(self) -> bool:
        """Clearly."""
        return self.disagreement is not None and self.disagreement.clear


@dataclass(frozen=True, eq=False)
class Each(Shown):
    """Logs one by one, beside the fit of all of them.

    Attributes:
        logs: in the order in which they were given, those that were left out last.
    """

    logs: tuple[Alone, ...]

    @cached_property
    def table(self) -> pl.DataFrame:
        """One row a log.

        Columns: `log`, `samples`, `error`, `own_error` [share of the typical torque],
        `worst_joint`, `p_value`, `disagrees`, `unknown` that alone explains it best, `change` ±
        `stderr` [`unit`], `part` of the model that does, its `share` of the excess of squared
        error, `left_out` (why).
        """
        rows = []
        for each in self.logs:
            odd = each.disagreement
            rows.append(
                {
                    "log": each.log,
                    "samples": each.samples,
                    "error": each.error,
                    "own_error": each.own,
                    "worst_joint": each.worst or None,
                    "p_value": odd and odd.p_value,
                    "disagrees": each.disagrees,
                    "unknown": odd and odd.unknown,
                    "change": odd and odd.change,
                    "stderr": odd and odd.stderr,
                    "unit": odd and odd.unit,
                    "part": odd and ", ".join(odd.parts),
                    "share": odd and odd.share,
                    "left_out": each.left_out or None,
                }
            )
        numbers = dict.fromkeys(("error", "own_error", "p_value", "change", "stderr", "share"))
        words = dict.fromkeys(("log", "worst_joint", "unknown", "unit", "part", "left_out"))
        types = dict.fromkeys(numbers, pl.Float64) | dict.fromkeys(words, pl.String)
        return pl.DataFrame(rows, schema_overrides=types)

    @property
    def odd(self) -> tuple[str, ...]:
        """Names of the logs that clearly disagree with the others."""
        return tuple(each.log for each in self.logs if each.disagrees)

    @property
    def notes(self) -> tuple[str, ...]:
        """Which logs were left out and why, and what the table cannot say."""
        kept = [each for each in self.logs if not each.left_out]
        said = [f"{each.log}: left out: {each.left_out}" for each in self.logs if each.left_out]
        if len(kept) == 2 and self.odd:
            said.append("of two logs that disagree nothing says which one is odd")
        elif self.odd and 2 * len(self.odd) >= len(kept):
            said.append(
                "half of the logs or more disagree: they differ by more than their noise, or the "
                "model lacks what differs between them (ident diagnose); the joint fit is a mean"
            )
        return tuple(said)

    def csv(self) -> bytes:
        """logs.csv."""
        return self.table.write_csv().encode()

    def section(self) -> Section:
        """For a report."""
        said = [self.words, *self.notes]
        return Section("Log by log", (html_table(self._rows(), "Logs"), items(said)))

    @property
    def words(self) -> str:
        """How many disagree, and at which rate logs that are alike would."""
        count = len(self.odd)
        kept = [each for each in self.logs if not each.left_out]
        names = ", ".join(self.odd) if count <= NAMED else f"{count} of {len(self.logs)} logs"
        whom = "each other" if len(kept) == 2 and count == 2 else "the others"
        verb = "disagree" if count > 1 else "disagrees"
        rate = (
            f"of 100 folders of logs that are alike, {100 * RATE:g} or fewer would have one that "
            "seems to"
        )
        own = [each.own for each in kept if each.own is not None]
        left = float(np.median(own)) if own else 0.0
        if not count and left > POOR:
            return (
                f"no log disagrees with the others by more than what the model leaves in each, "
                f"{percent(left)}, and that is much: see what it lacks first (ident diagnose)"
            )
        return f"{names or 'no log'} {verb} with {whom}; {rate}"

    def _rows(self) -> list[list[str]]:
        rows = [["log", "samples", "error", "own fit", "chance", "differs in"]]
        for each in self.logs:
            if each.left_out:
                rows.append([each.log, "–", "–", "–", "–", "left out"])
                continue
            odd = each.disagreement
            rows.append(
                [
                    each.log,
                    str(each.samples),
                    percent(each.error),
                    percent(each.own),
                    "–" if odd is None else _chance(odd.p_value),
                    _what(odd) if odd is not None and odd.clear else "",
                ]
            )
        return rows

    @property
    def summary(self) -> str:
        """What `print` shows, without the notes."""
        head = "log by log; chance: that a log like the others looks as odd"
        return "\n".join([head, *table(self._rows()), self.words])

    def __str__(self) -> str:
        return "\n".join([self.summary, *(f"note: {note}" for note in self.notes)])

    __repr__ = __str__

    def _blocks(self) -> tuple[Markup, ...]:
        return html_table(self._rows(), "Log by log"), items([self.words, *self.notes])


def _chance(p: float) -> str:
    return f"< {TINY:.0e}" if p < TINY else f"{p:.2g}"


def _what(odd: Disagreement) -> str:
    change = rounded(odd.change, odd.stderr)
    sign = "+" if odd.change > 0 else ""
    share = f"{100 * odd.share:.0f} %"
    if odd.share < MOSTLY:
        return f"no part of the model alone: {odd.parts[0]} explains {share}" if odd.parts else ""
    several = "each of " if len(odd.parts) > 1 else ""
    of = f"; {several}{', '.join(odd.parts)} explains {share}"
    return f"{odd.unknown} by {sign}{change} {odd.unit}{of}"
