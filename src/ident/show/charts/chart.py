"""The noun: panels in rows, with words for who cannot see them.

The same chart is drawn still by Matplotlib (files, print, Jupyter) and live by Bokeh (reports and
`Chart.live()`, where it can be zoomed).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ident.show.charts.marks import Line, Mark

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ident.show.charts.live import Live


@dataclass(frozen=True, eq=False)
class Panel:
    """Marks on one pair of axes.

    Attributes:
        marks: in the order in which they are drawn.
        x, y: labels of the axes, with units.
        title: above it.
        x_names, y_names: at positions 0, 1, 2, … in place of numbers; rows run downwards.
        logarithmic: whether y is.
        marked: whether it is to be looked at first.
        height: [inch] of a still picture.
    """

    marks: tuple[Mark, ...]
    x: str = ""
    y: str = ""
    title: str = ""
    x_names: tuple[str, ...] = ()
    y_names: tuple[str, ...] = ()
    logarithmic: bool = False
    marked: bool = False
    height: float = 2.1


@dataclass(frozen=True, eq=False)
class Chart:
    """A picture.

    Attributes:
        words: what it shows, for who cannot see it.
        rows: of panels, all of one length.
        shared_x: whether all panels have one x axis, as of time; shared_y: all of a row one y axis.
        width: [inch] of a still picture.
        clock: the log whose time x is, if any: all charts of one clock are zoomed together.
    """

    words: str
    rows: tuple[tuple[Panel, ...], ...]
    shared_x: bool = False
    shared_y: bool = False
    width: float = 9.0
    clock: str = ""

    @property
    def panels(self) -> tuple[Panel, ...]:
        """All of them, row by row."""
        return tuple(panel for row in self.rows for panel in row)

    @cached_property
    def figure(self) -> Figure:
        """Drawn by Matplotlib, to be changed as one likes."""
        from ident.show.charts.still import figure_of

        return figure_of(self)

    @property
    def axes(self) -> list[Axes]:
        """Of `figure`, row by row."""
        return self.figure.axes

    def savefig(self, *args: object, **options: object) -> None:
        """As Matplotlib's figure has it."""
        self.figure.savefig(*args, **options)  # type: ignore[arg-type]

    def save(self, path: str | Path) -> None:
        """As .png, .svg, .pdf, or as .html, where it can be zoomed; whole or not at all.

        Raises:
            IdentError: for another suffix, or where the file cannot be written.
        """
        from ident.show.charts.save import save

        save(self, Path(path))

    def live(self) -> Live:
        """The same to be zoomed with the mouse, in Jupyter too."""
        from ident.show.charts.live import Live

        return Live(self)

    def pieces(self, rows: int) -> tuple[Chart, ...]:
        """Charts of at most so many rows, zoomed together: only those in view are drawn anew."""
        if len(self.rows) <= rows:
            return (self,)
        starts = range(0, len(self.rows), rows)
        return tuple(
            replace(
                self, words=f"{self.words} ({i + 1} of {len(starts)})", rows=self.rows[k : k + rows]
            )
            for i, k in enumerate(starts)
        )

    def thinned(self, points: int) -> Chart:
        """Lines of at most some 2 · `points` values, which look the same at that many pixels."""
        return replace(self, rows=tuple(tuple(_thin(p, points) for p in row) for row in self.rows))

    def __str__(self) -> str:
        return self.words

    def __repr__(self) -> str:
        return f"Chart: {self.words}"

    def _repr_png_(self) -> bytes:
        from ident.show.charts.still import image

        return image(self.figure, "png")


def _thin(panel: Panel, points: int) -> Panel:
    marks = (extremes(m, points) if isinstance(m, Line) else m for m in panel.marks)
    return replace(panel, marks=tuple(marks))


def extremes(line: Line, points: int) -> Line:
    """Of every bucket of samples the smallest and the largest, so that no peak is lost."""
    n = len(line.y)
    if n <= 2 * points:
        return line
    edges = np.linspace(0, n, points + 1).astype(int)
    first, last = edges[:-1], edges[1:] - 1
    known = np.isfinite(line.y)
    low = np.minimum.reduceat(np.where(known, line.y, np.inf), first)
    high = np.maximum.reduceat(np.where(known, line.y, -np.inf), first)
    y = np.column_stack([low, high])
    y[np.add.reduceat(known, first) == 0] = np.nan  # only a bucket of gaps is a gap
    return replace(line, x=np.column_stack([line.x[first], line.x[last]]).ravel(), y=y.ravel())
