"""The noun `Chart`: a drawing that can be shown still, live and in files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from ident.errors import IdentError
from ident.files import write_all
from ident.show.charts.live import Live
from ident.show.charts.marks import Drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg", ".pdf", ".html")


@dataclass(frozen=True, eq=False, repr=False)
class Chart(Drawing):
    """Panels in rows. Jupyter shows it as a still; `live()` can be zoomed."""

    @cached_property
    def figure(self) -> Figure:
        """Matplotlib's figure, which belongs to no window."""
        from ident.show.charts.still import figure_of  # imports Matplotlib

        return figure_of(self)

    @property
    def axes(self) -> list[Axes]:
        """Axes of `figure`, row by row."""
        return self.figure.axes

    def savefig(self, *args: object, **options: object) -> None:
        """Save `figure` as Matplotlib does."""
        self.figure.savefig(*args, **options)  # type: ignore[arg-type]

    def save(self, path: str | Path) -> None:
        """Save as .png, .svg, .pdf, or as .html, where it can be zoomed; whole or not at all.

        Raises:
            IdentError: for another suffix, or where the file cannot be written.
        """
        path = Path(path)
        if (suffix := path.suffix.lower()) not in SUFFIXES:
            raise IdentError(f"{path}: give a name that ends in .png, .svg, .pdf or .html")
        content = self.live().html().encode() if suffix == ".html" else self._image(suffix[1:])
        write_all(path.parent, {path.name: content})

    def live(self) -> Live:
        """Return the chart that can be zoomed with the mouse, in Jupyter too."""
        return Live(self)

    def __str__(self) -> str:
        return self.words

    def __repr__(self) -> str:
        return f"Chart: {self.words}"

    def _image(self, kind: str) -> bytes:
        from ident.show.charts.still import image

        return image(self.figure, kind)

    def _repr_png_(self) -> bytes:
        return self._image("png")
