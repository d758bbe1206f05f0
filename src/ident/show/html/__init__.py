"""HTML of notebooks, reports and pages, made by the macros of `report.jinja`; words are escaped.

A `Sheet` is one description for terminals, Jupyter and reports.
"""

from __future__ import annotations

import math
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
# shown: px of the first screen: of the machine, a chart's legend and caption, those with tools, a
# row of a table; of the card: its title, the edges of what is next, a line of about so many letters
# of the headline or of other text, and a row of its errors
SCREEN = 880
SCENE, CAPTION, TOOLS, TABLE_ROW = 350, 28, 60, 29
TITLE, BOX, HEADLINE, LINE, LETTERS, ROW = 60, 50, 27, 25, 62, 31
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
        front: on the first screen, the first of them right of the first lines; below: below these.
        machine: on the first screen, too.
    """
    if front and sections:
        front, below = _columns(top, [*front, *machine], below)
    else:
        below = [*below, *machine]
    return piece("page", title, top, sections, [], scripts, front, below).encode()


def _columns(
    top: Card | str, blocks: Sequence[Block], below: Sequence[Block]
) -> tuple[list[Block], list[Block]]:
    """Return what is right of the first lines, and what is below them: the first block on the
    right, the others so that the higher column is as low as can be; charts of the other one grow,
    so that it is as high.
    """
    first, *others = blocks
    heights = [_block_height(block) for block in others]
    left, right = _height(top) + sum(map(_block_height, below)), _block_height(first)
    best = (math.inf, math.inf, 0)
    for chosen in range(2 ** len(others)):  # bits: of those on the left
        moved = sum(height for i, height in enumerate(heights) if chosen >> i & 1)
        ends = left + moved, right + sum(heights) - moved
        best = min(best, (max(ends), max(ends) - min(ends), chosen))
    chosen = best[2]
    on_left = [block for i, block in enumerate(others) if chosen >> i & 1]
    on_right = [first, *(block for i, block in enumerate(others) if not chosen >> i & 1)]
    moved = sum(map(_block_height, on_left))
    ends = left + moved, right + sum(heights) - moved
    # a column that is longer than the first screen leaves nothing empty on it
    gaps = [min(max(ends), max(SCREEN, end)) - end for end in ends]
    return _grown(on_right, gaps[1]), [*below, *_grown(on_left, gaps[0])]


def _grown(blocks: Sequence[Block], gap: float) -> list[Block]:
    """Return blocks, the charts among them higher by a gap [px] together, each at most twice as
    high as it was.
    """
    charts = [block for block in blocks if isinstance(block, Chart)]
    if gap <= 0 or not charts:
        return [*blocks]
    factor = 1 + min(gap / sum(chart.height for chart in charts), 1.0)
    return [block.scaled(factor) if isinstance(block, Chart) else block for block in blocks]


def _block_height(block: Block) -> int:
    """Return about how high [px] a block of the first screen is."""
    if isinstance(block, Chart):
        return block.height + (CAPTION if block.stretch or not block.shared_x else TOOLS)
    if hasattr(block, "films"):
        return SCENE
    return TABLE_ROW * (str(block).count("<tr") + 1)


def _height(top: Card | str) -> int:
    """Return about how high [px] the first lines are in the left column."""
    if isinstance(top, str):
        return TITLE
    texts = [(top.line, HEADLINE), (top.sure, LINE), (top.then, LINE), (top.command, LINE)]
    lines = sum(size * -(-len(text) // LETTERS) for text, size in texts if text)
    box = BOX * bool(top.then or top.command)
    return TITLE + box + lines + ROW * (len(top.bars) + 2) * bool(top.bars)


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
