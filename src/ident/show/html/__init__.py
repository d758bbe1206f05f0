"""HTML of notebooks and reports, made by the macros of `report.jinja`; words are escaped.

A `Sheet` is one description for terminals, Jupyter and reports.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from markupsafe import Markup

from ident.show.card import Card
from ident.show.charts import Chart, scripts
from ident.show.template import piece
from ident.text import merged, wrapped
from ident.text import table as text_table

ROWS = 4  # of panels in one chart: what a window shows
LOGS = 12  # whose curves are in a report


paragraph = partial(piece, "paragraph")  # words, with what stands between backticks as code
strong = partial(piece, "strong")  # a paragraph that is to be read first
headed = partial(piece, "headed")  # a heading within a section
code = partial(piece, "preformatted")
items = partial(piece, "items")  # a list of words
folded = partial(piece, "folded")  # what is shown on demand below its title
definitions = partial(piece, "definitions")  # words and their meanings, those that have one
table = partial(piece, "table")  # rows of cells, the head first; caption; tied=False breaks cells


Rows = Sequence[Sequence[str]]


@dataclass(frozen=True, eq=False)
class Sheet:
    """What is displayed of a noun, from above.

    Attributes:
        top: a title, or a card with the error by joint.
        line: a sentence below it.
        facts: words with meanings.
        tables: rows by caption, the head first; details: those that only HTML shows.
        lines: sentences; paragraphs: longer ones, parted by empty lines.
        notes: remarks, which a summary leaves out.
        indent: of paragraphs in a terminal.
    """

    top: Card | str
    line: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    tables: Mapping[str, Rows] = field(default_factory=dict)
    details: Mapping[str, Rows] = field(default_factory=dict)
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
            lines += ["", caption, *text_table(rows)]
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
        blocks = [strong(self.line or self.top), *self.blocks()]
        if isinstance(self.top, Card):
            rest = folded("Tables and remarks", *self.blocks())
            blocks = [piece("card", self.top) + paragraph(self.line), rest]
        return str(piece("frame", blocks))


Block = Any  # Markup, a chart, a choice, or a mechanism in 3-D, which has films


@dataclass(frozen=True, eq=False)
class Choice:
    """Buttons by name, each of which shows its blocks in the place of the others'."""

    words: str
    options: Mapping[str, Sequence[Block]]


@dataclass(frozen=True, eq=False)
class Section:
    """A title and the blocks below it; a section without blocks is left out."""

    title: str
    blocks: Sequence[Block]


def report_page(title: str, top: Card | str, sections: Sequence[Section]) -> bytes:
    """Return a report as one file that opens without a network: a title, what is most important in
    one line or more, and sections.
    """
    return piece("page", title, top, sections, [], scripts).encode()


def by_log(names: Sequence[str], draw: Callable[[int], Chart]) -> tuple[Block, ...]:
    """Return a chart, or of several logs a choice between theirs."""
    if len(names) == 1:
        return draw(0).pieces(ROWS)
    options = {name: draw(i).pieces(ROWS) for i, name in enumerate(names[:LOGS])}
    few = paragraph(f"The first {LOGS} of {len(names)} logs are drawn.")
    return *([few] if len(names) > LOGS else []), Choice("Which log", options)
