"""Displayed content of a noun as data: one description for terminals, Jupyter and reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

from ident.show.html import in_frame, piece, strong
from ident.text import table, wrapped

Rows = Sequence[Sequence[str]]


@dataclass(frozen=True, eq=False)
class Sheet:
    """A title, a sentence, words with meanings, tables by caption, sentences, and remarks."""

    title: str
    line: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    tables: Mapping[str, Rows] = field(default_factory=dict)
    lines: Sequence[str] = ()
    notes: Sequence[str] = ()

    def summary(self) -> str:
        """Return all but the remarks for a terminal."""
        width = max(map(len, self.facts), default=0)
        lines = [*wrapped(self.title, "  "), *wrapped(self.line, "  ")]
        lines += [f"  {key:<{width}}  {value}" for key, value in self.facts.items() if value]
        for caption, rows in self.tables.items():
            lines += ["", caption, *table(rows)]
        separator = [""] if self.tables and self.lines else []
        return "\n".join([*lines, *separator, *self.lines])

    def text(self) -> str:
        """Return the description for a terminal."""
        return "\n".join([self.summary(), *(f"note: {note}" for note in self.notes)])

    def blocks(self) -> tuple[Markup, ...]:
        """Return all but the title as HTML."""
        return (piece("sheet_blocks", self),)

    def html(self) -> str:
        """Return the description for Jupyter."""
        return in_frame([strong(self.line or self.title), *self.blocks()])
