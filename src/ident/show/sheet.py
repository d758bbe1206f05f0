"""Displayed content of a noun as data: one description for terminals, Jupyter and reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

from ident.show.html import Card, folded, in_frame, paragraph, strong
from ident.show.template import piece
from ident.text import merged, table, wrapped

Rows = Sequence[Sequence[str]]


@dataclass(frozen=True, eq=False)
class Sheet:
    """What is displayed of a noun, from above.

    Attributes:
        top: a title, or a card with the error by joint.
        line: a sentence below it.
        facts: words with meanings.
        tables: rows by caption, the head first.
        lines: sentences; paragraphs: longer ones, parted by empty lines.
        notes: remarks, which a summary leaves out.
        indent: of paragraphs in a terminal.
    """

    top: Card | str
    line: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    tables: Mapping[str, Rows] = field(default_factory=dict)
    lines: Sequence[str] = ()
    paragraphs: Sequence[str] = ()
    notes: Sequence[str] = ()
    indent: str = ""

    def summary(self) -> str:
        """Return all but the remarks for a terminal."""
        width = max(map(len, self.facts), default=0)
        lines = wrapped(self.top, "  ") if isinstance(self.top, str) else self.top.text()
        lines += [""] * bool(self.line and not isinstance(self.top, str)) + wrapped(self.line, "  ")
        lines += [f"  {key:<{width}}  {value}" for key, value in self.facts.items() if value]
        for caption, rows in self.tables.items():
            lines += ["", caption, *table(rows)]
        lines += [""] * bool(self.tables and self.lines)
        lines += [part for line in self.lines for part in wrapped(line, "  ")]
        for words in self.paragraphs:
            lines += ["", *wrapped(words, self.indent)]
        return "\n".join(lines)

    def text(self) -> str:
        """Return the description for a terminal."""
        return "\n".join([self.summary(), *(f"note: {note}" for note in merged(self.notes))])

    def blocks(self) -> tuple[Markup, ...]:
        """Return all but the title as HTML."""
        return (piece("sheet_blocks", self),)

    def html(self) -> str:
        """Return the description for Jupyter."""
        if isinstance(self.top, str):
            return in_frame([strong(self.line or self.top), *self.blocks()])
        rest = folded("Tables and remarks", *self.blocks())
        return in_frame([piece("card", self.top) + paragraph(self.line), rest])
