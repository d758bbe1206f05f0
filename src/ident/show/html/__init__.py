"""HTML of notebooks, reports and pages, made by the macros of `report.jinja`; words are escaped.

A `Sheet` is one description for terminals, Jupyter and reports.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

from markupsafe import Markup, escape

from ident.display import renders
from ident.show.card import Card
from ident.show.charts import Chart, scripts
from ident.text import merged, wrapped
from ident.text import table as text_table

ROWS = 4  # of panels in one chart: what a window shows
# shown: px of the first screen, of a chart and the machine in it; of the card: its title, a line of
# about so many letters of the headline or of other text, and a row of its table
SCREEN, CHART, SCENE = 880, 250, 345
TITLE, HEADLINE, LINE, LETTERS, ROW = 80, 27, 25, 62, 31
LOGS = 12  # whose curves are in a report
SHORT = 32  # characters of a cell that stays on one line
NUMBER = re.compile(r"[-−+≈<–]? ?\d")  # the beginning of one
POWER = re.compile(r"[-+\d.]*\de[-+]\d+")  # one that a browser would break at its last sign
TIED = r'<span class="tied">\g<0></span>'
CODE = re.compile(r"`([^`]*)`|(?<![\w-])--[a-z][\w-]*")  # or an option, which it would break too


def _unbroken(words: str) -> Markup:
    """Return words that a page does not break at their hyphens and slashes, but between them."""
    return Markup(re.sub(r"\S*[^\w\s]\S*", r"<span>\g<0></span>", str(escape(words))))


def _code(words: str) -> Markup:
    """Return words with what stands between backticks as code, and options on one line."""

    def marked(match: re.Match[str]) -> str:
        quoted = match[1]
        return match.expand(TIED) if quoted is None else f"<code>{_unbroken(Markup(quoted))}</code>"

    return Markup(CODE.sub(marked, str(escape(words))))


def _tied(cell: str) -> Markup:
    """Return a cell in which numbers, and all words of a short one, stay on one line."""
    tied = re.sub(" " if len(cell) <= SHORT else r"(?<=\d) ", "\u00a0", cell)
    return Markup(POWER.sub(TIED, str(escape(tied))))


@cache
def _macros() -> Any:
    from jinja2 import Environment, PackageLoader

    loader = PackageLoader("ident.show", "html")
    environment = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.globals["text_of"] = lambda name: Markup(loader.get_source(environment, name)[0])
    environment.filters |= {
        "code": _code,
        "whole": _unbroken,
        "tied": _tied,
        "dotted": lambda name: Markup(re.sub(r"[._]", r"\g<0><wbr>", str(escape(name)))),
        "worded": lambda rows: [
            not any(map(NUMBER.match, x)) for x in zip(*rows[1:], strict=False)
        ],
        "slug": lambda title: re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-"),
    }
    return environment.get_template("report.jinja").module


def piece(macro: str, *content: Any, **options: Any) -> Markup:
    """Return what a macro of the template makes of a content."""
    return Markup(getattr(_macros(), macro)(*content, **options))


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
        top: a title, or a card with the error by joint; line: a sentence below it.
        facts: words with meanings.
        tables: rows by caption, the head first; details: those that only HTML shows.
        lines: sentences; paragraphs: longer ones, in a terminal with an `indent`.
        notes: remarks, which a summary leaves out.
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
    """A title and the blocks below it, folded or not; one without blocks is left out."""

    title: str
    blocks: Sequence[Block]
    unfolded: bool = False


def report_page(
    title: str,
    top: Card | str,
    sections: Sequence[Section],
    front: Sequence[Block] = (),
    below: Sequence[Block] = (),
    machine: Sequence[Block] = (),
) -> bytes:
    """Return a report as one file that opens without a network.

    Args:
        title: of the page; top: its first lines, with the error by joint.
        sections: below the first screen, folded unless they are to be seen at once.
        front: right of the first lines; below: below these, on the first screen too.
        machine: below the shorter of both columns.
    """
    charts = [block for block in front if isinstance(block, Chart)]
    full = len(charts) < len(front) or len(charts) * CHART + SCENE > SCREEN
    if full or (not below and _height(top) + SCENE < SCREEN):
        below = [*below, *machine]
    else:
        front = [*front, *machine]
    return piece("page", title, top, sections, [], scripts, front, below).encode()


def _height(top: Card | str) -> int:
    """Return about how high [px] the first lines are in the left column."""
    if isinstance(top, str):
        return TITLE
    texts = [(top.line, HEADLINE), (top.sure, LINE), (top.then, LINE), (top.command, LINE)]
    lines = sum(size * -(-len(text) // LETTERS) for text, size in texts if text)
    return TITLE + lines + ROW * (len(top.bars) + 2)


def by_log(names: Sequence[str], draw: Callable[[int], Chart]) -> tuple[Block, ...]:
    """Return a chart, or of several logs a choice between theirs."""
    if len(names) == 1:
        return draw(0).pieces(ROWS)
    options = {name: draw(i).pieces(ROWS) for i, name in enumerate(names[:LOGS])}
    remark = paragraph(f"The first {LOGS} of {len(names)} logs are drawn.")
    return *([remark] if len(names) > LOGS else []), Choice("Which log", options)


@dataclass(frozen=True, eq=False)
class LiveChart:
    """A chart that Jupyter shows as it can be zoomed."""

    chart: Chart

    def _repr_html_(self) -> str:
        return str(piece("document", self.chart.html(), self.chart.words, self.chart.height))


renders(Chart, "live")(LiveChart)
renders(Chart, "page")(lambda chart: piece("chart_page", chart, scripts()))
