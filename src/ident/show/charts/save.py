"""Charts into files."""

from __future__ import annotations

from pathlib import Path

from ident.errors import IdentError
from ident.files import write_all
from ident.show.charts.chart import Chart

KINDS = ("png", "svg", "pdf", "html")
SUFFIXES = tuple(f".{kind}" for kind in KINDS)


def save(chart: Chart, path: Path) -> None:
    """By suffix; whole or not at all.

    Raises:
        IdentError: for another suffix, or where the file cannot be written.
    """
    from ident.show.charts.still import image  # Matplotlib, which the names of suffixes need not

    kind = path.suffix.lower().removeprefix(".")
    if kind not in KINDS:
        raise IdentError(f"{path}: give a name that ends in .png, .svg, .pdf or .html")
    content = chart.live().html().encode() if kind == "html" else image(chart.figure, kind)
    write_all(path.parent, {path.name: content})
