"""A report: sections of words, tables, charts and choices in one HTML file without a network."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from markupsafe import Markup

from ident.progress import running
from ident.show.charts import Chart
from ident.show.charts.live import scripts
from ident.show.html.elements import code, definitions, macros, paragraph, table, text_of

PACKAGES = ("ident", "pin", "casadi", "numpy", "scipy", "clarabel", "bokeh")


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


Block = Markup | Chart | Choice


@dataclass(frozen=True, eq=False)
class Section:
    """A title and the blocks below it; a section without blocks is left out."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, eq=False)
class Page:
    """A report: a title, one line that says the most important thing, and sections."""

    title: str
    line: str
    sections: tuple[Section, ...]

    def html(self) -> bytes:
        """Return one file that opens without a network."""
        charts: list[Chart] = []  # filled by the template, in the order of reading
        page = macros().page(
            self, charts, text_of("style.css"), text_of("script.js"), lambda: Markup(scripts())
        )
        return str(page).encode()


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
