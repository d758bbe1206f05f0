"""HTML for reports and notebooks, made by the macros of `report.jinja`; words are escaped."""

from __future__ import annotations

import hashlib
import platform
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib import resources
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

from markupsafe import Markup, escape

from ident.progress import running
from ident.show.card import Card
from ident.show.charts import Chart, scripts

CODE = re.compile(r"`([^`]*)`")
SHORT = 32  # characters of a cell that stays on one line
PACKAGES = ("ident", "pin", "casadi", "numpy", "scipy", "clarabel", "bokeh")
ROWS = 4  # of panels in one chart: what a window shows
LOGS = 12  # whose curves are in a report


def text_of(name: str) -> str:
    """Return a style sheet or script of this package."""
    return resources.files("ident.show.html").joinpath(name).read_text(encoding="utf-8")


@cache
def macros() -> Any:
    """Return the macros of the template, compiled at the first use."""
    from jinja2 import Environment

    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"code": _code, "tied": _tied, "slug": slug}
    environment.globals |= {"text_of": lambda name: Markup(text_of(name)), "scripts": scripts}
    return environment.from_string(text_of("report.jinja")).module


def slug(title: str) -> str:
    """Return a title as the name of a place in the page."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def _code(words: str) -> Markup:
    return Markup(CODE.sub(r"<code>\1</code>", str(escape(words))))


def _tied(cell: str) -> str:
    return cell.replace(" ", "\u00a0") if len(cell) <= SHORT else cell


def piece(macro: str, *content: Any, **options: Any) -> Markup:
    """Return what a macro of the template makes of a content."""
    return Markup(getattr(macros(), macro)(*content, **options))


paragraph = partial(piece, "paragraph")  # words, with what stands between backticks as code
strong = partial(piece, "strong")  # a paragraph that is to be read first
headed = partial(piece, "headed")  # a heading within a section
code = partial(piece, "preformatted")
items = partial(piece, "items")  # a list of words
folded = partial(piece, "folded")  # what is shown on demand below its title
definitions = partial(piece, "definitions")  # words and their meanings, those that have one
table = partial(piece, "table")  # rows of cells, the head first; caption; tied=False breaks cells


def in_frame(blocks: Sequence[Markup]) -> str:
    """Return blocks as Jupyter shows them, with their own style."""
    return str(piece("frame", blocks))


@dataclass(frozen=True, eq=False)
class Option:
    """One option of a choice: the name on its button, and the blocks it shows."""

    name: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, eq=False)
class Choice:
    """Buttons, each of which shows its blocks in the place of the others'."""

    words: str
    options: tuple[Option, ...]


class SceneBlock(Protocol):
    """A mechanism in 3-D, which the template tells by its films."""

    @property
    def films(self) -> Sequence[Any]:
        """Its motions."""
        ...


Block = Markup | Chart | Choice | SceneBlock


@dataclass(frozen=True, eq=False)
class Section:
    """A title and the blocks below it; a section without blocks is left out."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, eq=False)
class Page:
    """A report: a title, what is most important in one line or more, and sections."""

    title: str
    top: Card | str
    sections: tuple[Section, ...]

    def html(self) -> bytes:
        """Return one file that opens without a network."""
        return piece("page", self, []).encode()


def by_log(names: Sequence[str], draw: Callable[[int], Chart]) -> tuple[Block, ...]:
    """Return a chart, or of several logs a choice between theirs."""
    if len(names) == 1:
        return draw(0).pieces(ROWS)
    options = tuple(Option(name, draw(i).pieces(ROWS)) for i, name in enumerate(names[:LOGS]))
    choice = Choice("Which log", options)
    if len(names) <= LOGS:
        return (choice,)
    return paragraph(f"The first {LOGS} of {len(names)} logs are drawn."), choice


def origin(files: Sequence[Path], logs: Sequence[tuple[str, str]]) -> Section:
    """Return the section on how to reproduce a result: command, versions, checksums of files.

    Args:
        files: of the mechanism.
        logs: names and SHA-256 of the logs' bytes, "" where one was made in memory.
    """
    rows = [["file", "SHA-256"]]
    rows += [[file.name, _sha256(file)] for file in files]
    rows += [[name, digest or "made in memory"] for name, digest in logs]
    command = running.get()
    first = code(command) if command else paragraph("Made in Python, by no command.")
    versions = {name: _version(name) for name in PACKAGES}
    versions["Python"] = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    return Section("How to reproduce", (first, table(rows, "What went in"), definitions(versions)))


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _sha256(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return "no longer there"
