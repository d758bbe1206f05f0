"""Description of a chart: marks with their colours, panels, and panels in rows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

MEASURED, RESIDUAL, PRIOR, FAINT = "measured", "residual", "prior", "faint"

ROLES = {  # legible on white and on black; FAINT is for marks in the background
    MEASURED: "#8f959e",
    PRIOR: "#8f959e",
    RESIDUAL: "#d1495b",
    FAINT: "#b9bec6",
    "mean": "#6b3fa0",
}
SERIES = (
    "#2b7bd1",  # blue
    "#d9730d",  # orange
    "#2a9d5c",  # green
    "#9a62d0",  # violet
    "#1598a5",  # teal
    "#a8763e",  # brown
    "#d6589f",  # pink
    "#8b8b1a",  # olive
    "#5c6bc0",  # indigo
    "#c0563f",  # brick
)
CLOUD = 4000  # points that are drawn of a cloud; more only darken it

Colour = int | str


def colour(c: Colour) -> str:
    """Return the colour of a role, given its name, or of a series, given its number."""
    return ROLES[c] if isinstance(c, str) else SERIES[c % len(SERIES)]


@dataclass(frozen=True, eq=False)
class Line:
    """y (n,) over x (n,), which increases; a NaN in y breaks the line."""

    x: np.ndarray
    y: np.ndarray
    label: str = ""
    colour: Colour = 0
    width: float = 1.2
    dotted: bool = False  # with a dot at every value

    def thinned(self, points: int) -> Line:
        """Return the smallest and the largest value of each of `points` buckets of samples."""
        n = len(self.y)
        if n <= 2 * points:
            return self
        edges = np.linspace(0, n, points + 1).astype(int)
        first, last = edges[:-1], edges[1:] - 1
        known = np.isfinite(self.y)
        low = np.minimum.reduceat(np.where(known, self.y, np.inf), first)
        high = np.maximum.reduceat(np.where(known, self.y, -np.inf), first)
        y = np.column_stack([low, high])
        y[np.add.reduceat(known, first) == 0] = np.nan  # only a bucket of gaps is a gap
        return replace(self, x=np.column_stack([self.x[first], self.x[last]]).ravel(), y=y.ravel())


@dataclass(frozen=True, eq=False)
class Points:
    """A cloud of y (n,) over x (n,)."""

    x: np.ndarray
    y: np.ndarray
    label: str = ""
    colour: Colour = 0

    def thinned(self, points: int) -> Points:
        """Return at most some `points` of the cloud, evenly chosen."""
        some = slice(None, None, max(1, len(self.x) // points))
        return replace(self, x=self.x[some], y=self.y[some])


@dataclass(frozen=True, eq=False)
class Bars:
    """Horizontal bars of values (n,) ± errors (n,) at the rows `at` (n,)."""

    at: np.ndarray
    values: np.ndarray
    errors: np.ndarray
    label: str = ""
    colour: Colour = 0


@dataclass(frozen=True, eq=False)
class Dots:
    """Values (n,) ± errors (n,) at the rows `at` (n,)."""

    at: np.ndarray
    values: np.ndarray
    errors: np.ndarray
    label: str = ""
    colour: Colour = 0


@dataclass(frozen=True, eq=False)
class Boxes:
    """5, 25, 50, 75, 95 % quantiles (n, 5) of samples at the columns `at` (n,), `width` wide."""

    at: np.ndarray
    quantiles: np.ndarray
    width: float
    label: str = ""
    colour: Colour = 0


@dataclass(frozen=True)
class Level:
    """A straight line across the panel at a value of y, or of x if `upright`; or y = x."""

    value: float = 0.0
    upright: bool = False
    diagonal: bool = False
    label: str = ""
    colour: Colour = MEASURED
    dashed: bool = False


Mark = Line | Points | Bars | Dots | Boxes | Level


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
        height: [inch] of a still chart.
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
class Drawing:
    """Panels in rows, as plain data.

    Attributes:
        words: text alternative, for readers who cannot see the chart.
        rows: of panels, all of one length.
        shared_x: whether all panels have one x axis, as of time; shared_y: all of a row one y axis.
        width: [inch] of a still chart.
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
        """All panels, row by row."""
        return tuple(panel for row in self.rows for panel in row)

    def pieces(self, rows: int) -> tuple[Self, ...]:
        """Return charts of at most `rows` rows, zoomed together: those out of view cost nothing."""
        if len(self.rows) <= rows:
            return (self,)
        starts = range(0, len(self.rows), rows)
        return tuple(
            replace(
                self, words=f"{self.words} ({i + 1} of {len(starts)})", rows=self.rows[k : k + rows]
            )
            for i, k in enumerate(starts)
        )

    def thinned(self, points: int) -> Self:
        """Return the chart with lines of at most 2 · `points` values; all peaks remain."""

        def panel(p: Panel) -> Panel:
            marks = (m.thinned(points) if isinstance(m, Line) else m for m in p.marks)
            return replace(p, marks=tuple(marks))

        return replace(self, rows=tuple(tuple(map(panel, row)) for row in self.rows))
