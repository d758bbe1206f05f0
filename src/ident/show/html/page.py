"""The nouns: a page of sections, which hold words, tables, charts and choices between them."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from importlib import resources

from markupsafe import Markup

from ident.show.charts import Chart
from ident.show.charts.live import script

KEYBOARD = ". Keys: plus and minus zoom, arrows move, 0 shows all"
KEYS = (
    ("nearer", "+", "Zoom in"),
    ("farther", "−", "Zoom out"),
    ("earlier", "←", "To the left"),
    ("later", "→", "To the right"),
    ("all", "⤢", "All of it"),
)


@dataclass(frozen=True, eq=False)
class Option:
    """One of a choice: what its button says, and what it shows."""

    name: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, eq=False)
class Choice:
    """Buttons, each of which shows its blocks in the place of the others'."""

    words: str
    options: tuple[Option, ...]


Block = Markup | Chart | Choice


@dataclass(frozen=True, eq=False)
class Section:
    """A title and what stands below it; one without blocks is left out."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, eq=False)
class Page:
    """A report: a title, one line that says the most important thing, and sections."""

    title: str
    line: str
    sections: tuple[Section, ...]

    def html(self) -> bytes:
        """One file that opens without a network."""
        shown = [section for section in self.sections if section.blocks]
        charts: list[Chart] = []
        body = [_section(section, charts) for section in shown]
        links = Markup("").join(
            Markup('<li><a href="#{}">{}</a></li>').format(slug(s.title), s.title) for s in shown
        )
        data = Markup("").join(_data(number, chart) for number, chart in enumerate(charts))
        page = PAGE.format(
            title=self.title, line=self.line, links=links, body=Markup("\n").join(body), data=data,
            style=Markup(_file("style.css")), bokeh=Markup(script()) if charts else "",
            script=Markup(_file("script.js")),
        )  # fmt: skip
        return page.encode()


PAGE = Markup("""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>{style}</style></head><body>
<a class="skip" href="#main">To the contents</a>
<header><h1>{title}</h1><p class="line">{line}</p></header>
<nav aria-label="Sections"><ul>{links}</ul></nav>
<main id="main">
{body}
</main>
{bokeh}
{data}
<script>{script}</script>
</body></html>
""")


def slug(title: str) -> str:
    """A title as the name of a place in the page."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def _file(name: str) -> str:
    return resources.files("ident.show.html").joinpath(name).read_text(encoding="utf-8")


def _section(section: Section, charts: list[Chart]) -> Markup:
    inside = Markup("\n").join(_block(block, charts) for block in section.blocks)
    frame = Markup('<section id="{0}" aria-labelledby="{0}-title"><h2 id="{0}-title">{1}</h2>{2}')
    return frame.format(slug(section.title), section.title, inside) + Markup("</section>")


def _block(block: Block, charts: list[Chart]) -> Markup:
    if isinstance(block, Chart):
        charts.append(block)
        return _figure(block, len(charts) - 1)
    if isinstance(block, Choice):
        return _choice(block, charts)
    return block


def _figure(chart: Chart, number: int) -> Markup:
    """A place for a chart, with buttons that do what the mouse does."""
    buttons = Markup("").join(
        Markup('<button type="button" data-do="{}" title="{}" aria-label="{}">{}</button>').format(
            do, words, words, sign
        )
        for do, sign, words in KEYS
    )
    height = chart.live().height
    return Markup(
        '<figure class="chart" data-chart="{n}"{clock} tabindex="0" aria-label="{words}{keys}">'
        "{tools}"
        '<div class="canvas" id="chart-{n}" role="img" aria-label="{words}" '
        'style="min-height:{height}px"></div><figcaption>{words}</figcaption></figure>'
    ).format(
        n=number, words=chart.words, height=height,
        clock=Markup(' data-clock="{}"').format(chart.clock) if chart.clock else "",
        keys=KEYBOARD if chart.shared_x else "",
        tools=Markup('<div class="tools" role="group" aria-label="Zoom">{}</div>').format(buttons)
        if chart.shared_x else "",
    )  # fmt: skip


def _choice(choice: Choice, charts: list[Chart]) -> Markup:
    first = len(charts)
    names = [f"option-{first}-{i}" for i in range(len(choice.options))]
    buttons = Markup("").join(
        Markup('<button type="button" aria-controls="{}" aria-pressed="{}">{}</button>').format(
            name, "false" if i else "true", option.name
        )
        for i, (name, option) in enumerate(zip(names, choice.options, strict=True))
    )
    places = Markup("").join(
        Markup('<div class="option" id="{}"{}>{}</div>').format(
            name,
            Markup(" hidden") if i else "",
            Markup("\n").join(_block(block, charts) for block in option.blocks),
        )
        for i, (name, option) in enumerate(zip(names, choice.options, strict=True))
    )
    frame = Markup('<div class="choice"><div class="buttons" role="group" aria-label="{}">{}</div>')
    return frame.format(choice.words, buttons) + places + Markup("</div>")


def _data(number: int, chart: Chart) -> Markup:
    """What Bokeh draws, as data that no browser runs."""
    item = json.dumps(chart.live().item(f"c{number}")).replace("<", "\\u003c")
    return Markup(f'<script type="application/json" id="data-{number}">{item}</script>\n')
