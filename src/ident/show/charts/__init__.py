"""Charts described once as plain data, drawn still by Matplotlib and live by BokehJS's own API.

Nothing of Bokeh runs in Python: its Python models take 2 s for the 65 panels of a report of seven
joints, the data 0.1 s. A long line goes into the page as the extremes of POINTS buckets of samples,
so that a page stays small and no peak is lost; `charts.js` draws those of them that are in view.
"""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.display import render
from ident.errors import IdentError
from ident.files import write_all

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg", ".pdf", ".html")
PIXELS = 75  # of one inch of a panel's height
POINTS = 2000  # shown: buckets of a line, two values each; more would not be seen
SHORT = 6  # characters of names that stand upright beside each other
LABEL = 34  # characters of a name in a legend
BELOW = 3.2  # pixels: width of a measured line, which stays visible below a predicted one
LEAST = 150  # pixels, below which nobody reads a panel
MEASURED, RESIDUAL, RAW, PRIOR, FAINT = "measured", "residual", "raw", "prior", "faint"
BEFORE, NOW = "before", "now"  # an earlier model and the present one, on every page

ROLES = {  # legible on white and on black; FAINT is for marks in the background
    MEASURED: "#8f959e",
    PRIOR: "#8f959e",
    RESIDUAL: "#d1495b",
    RAW: "#7dbdb3",  # a residual before the filter, below the filtered one
    FAINT: "#8f959ea0",
    "mean": "#8250df",
    BEFORE: "#d9730d",  # orange
    NOW: "#2a9d5c",  # green
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
PACKAGE_SCRIPTS = ("charts.js", "scene.js")
CLOUD = 2000  # shown: points of a cloud; more only darken it
SINGLE = 2.0**-20  # numerics: of the range of x, that rounding to single precision may move it

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
        finite = np.isfinite(self.y)
        low = np.minimum.reduceat(np.where(finite, self.y, np.inf), first)
        high = np.maximum.reduceat(np.where(finite, self.y, -np.inf), first)
        y = np.column_stack([low, high])
        y[np.add.reduceat(finite, first) == 0] = np.nan  # only a bucket of gaps is a gap
        return replace(self, x=np.column_stack([self.x[first], self.x[last]]).ravel(), y=y.ravel())


@dataclass(frozen=True, eq=False)
class Points:
    """A cloud of y (n,) over x (n,)."""

    x: np.ndarray
    y: np.ndarray
    label: str = ""
    colour: Colour = 0

    def thinned(self, points: int) -> Points:
        """Return at most so many `points` of the cloud, evenly chosen."""
        every = slice(None, None, -(-len(self.x) // points) or 1)
        return replace(self, x=self.x[every], y=self.y[every])


@dataclass(frozen=True, eq=False)
class Dots:
    """Dots at values (n,) ± errors (n,) in the rows `at` (n,)."""

    at: np.ndarray
    values: np.ndarray
    errors: np.ndarray
    label: str = ""
    colour: Colour = 0
    upright: bool = False  # strokes in place of dots, which hide no dot


@dataclass(frozen=True)
class Level:
    """A straight line across the panel at a value of y, or of x if `upright`."""

    value: float = 0.0
    upright: bool = False
    label: str = ""
    colour: Colour = MEASURED
    dashed: bool = False


Mark = Line | Points | Dots | Level


@dataclass(frozen=True, eq=False)
class Panel:
    """Marks on one pair of axes.

    Attributes:
        marks: in the order in which they are drawn.
        x, y: labels of the axes, with units; title: above it.
        x_names, y_names: at positions 0, 1, 2, … in place of numbers; rows run downwards.
        logarithmic: whether y is; logarithmic_x: whether x is; marked: whether it is to be looked
            at first.
        x_range, y_range: ends of the axes; None: those of the marks.
        height: [inch] of a still chart.
    """

    marks: tuple[Mark, ...]
    x: str = ""
    y: str = ""
    title: str = ""
    x_names: tuple[str, ...] = ()
    y_names: tuple[str, ...] = ()
    logarithmic: bool = False
    logarithmic_x: bool = False
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    marked: bool = False
    height: float = 2.1


@dataclass(frozen=True, eq=False, repr=False)
class Chart:
    """Panels in rows, as plain data. Jupyter shows it as a still; `live()` can be zoomed.

    Attributes:
        words: text alternative, for readers who cannot see the chart.
        rows: of panels, all of one length.
        shared_x: whether all panels have one x axis, as of time; shared_y: whether one y axis.
        width: [inch] of a still chart.
        clock: the log whose time x is, if any: all charts of one clock share a cursor.
        stretch: whether it is a picture without tools, as of a short part of a log.
    """

    words: str
    rows: tuple[tuple[Panel, ...], ...]
    shared_x: bool = False
    shared_y: bool = False
    width: float = 9.0
    clock: str = ""
    stretch: bool = False

    @property
    def panels(self) -> tuple[Panel, ...]:
        """All panels, row by row."""
        return tuple(panel for row in self.rows for panel in row)

    def pieces(self, rows: int) -> tuple[Chart, ...]:
        """Return charts of at most `rows` rows, zoomed together: those out of view cost nothing."""
        if len(self.rows) <= rows:
            return (self,)
        parts = [self.rows[k : k + rows] for k in range(0, len(self.rows), rows)]
        return tuple(
            replace(self, words=f"{self.words} ({i} of {len(parts)})", rows=part)
            for i, part in enumerate(parts, 1)
        )

    def thinned(self, points: int) -> Chart:
        """Return the chart with lines of at most 2 · `points` values; all peaks remain."""

        def panel(p: Panel) -> Panel:
            marks = (m.thinned(points) if isinstance(m, Line) else m for m in p.marks)
            return replace(p, marks=tuple(marks))

        return replace(self, rows=tuple(tuple(map(panel, row)) for row in self.rows))

    @cached_property
    def figure(self) -> Figure:
        """Matplotlib's figure, which belongs to no window."""
        return _figure(self)

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
        content = self.html().encode() if suffix == ".html" else self.image(suffix[1:])
        write_all(path.parent, {path.name: content})

    def live(self) -> Any:
        """Return the chart that can be zoomed with the mouse, in Jupyter too."""
        return render(self, "live")

    def data(self) -> str:
        """Return the live chart as JSON, safe inside a <script> element, for `drawChart`."""
        arrays = Arrays()

        def encoded(value: Any, name: str) -> Any:
            if isinstance(value, np.ndarray):  # y needs no more digits than a screen has
                single = name == "y" or _fits_single(value)
                return arrays.place(value, "<f4" if single else "<f8")
            return None if isinstance(value, float) and not math.isfinite(value) else value

        def mark_data(mark: Mark) -> dict[str, Any]:
            values = {f.name: encoded(getattr(mark, f.name), f.name) for f in fields(mark)}
            return {"kind": type(mark).__name__, **values, "colour": colour(mark.colour)}

        def panel_data(panel: Panel) -> dict[str, Any]:
            values = {f.name: getattr(panel, f.name) for f in fields(panel)}
            marks = [mark_data(m.thinned(CLOUD)) if isinstance(m, Points) else
                     mark_data(m.thinned(POINTS)) if isinstance(m, Line) else
                     mark_data(m) for m in panel.marks]  # fmt: skip
            return values | {"height": _pixels(panel), "marks": marks}

        rows = [list(map(panel_data, row)) for row in self.rows]
        shared = {"shared_x": self.shared_x, "shared_y": self.shared_y, "fixed": self.stretch}
        return script_json({"rows": rows, "arrays": list(arrays), **shared})

    def html(self) -> str:
        """Return a page with the live chart, which needs no network."""
        return str(render(self, "page"))

    @property
    def height(self) -> int:
        """Height [pixel] of the live chart."""
        return (30 if self.stretch else 70) + sum(max(map(_pixels, row)) for row in self.rows)

    def scaled(self, factor: float) -> Chart:
        """Return the chart with panels so many times as high."""
        rows = tuple(tuple(replace(p, height=factor * p.height) for p in row) for row in self.rows)
        return replace(self, rows=rows)

    def __str__(self) -> str:
        return self.words

    def __repr__(self) -> str:
        return f"Chart: {self.words}"

    def image(self, kind: str) -> bytes:
        """Return the still chart as the bytes of a png, svg or pdf."""
        stream = io.BytesIO()
        metadata = {"Date": None} if kind == "svg" else None
        self.figure.savefig(stream, format=kind, dpi=130, metadata=metadata)
        return stream.getvalue()

    def _repr_png_(self) -> bytes:
        return self.image("png")


class Arrays(dict[str, int]):
    """Arrays as binary numbers in text, each once however many share it; `unpacked` reads them."""

    def place(self, x: np.ndarray, kind: str) -> int:
        """Return the number of an array that is stored as `kind`: <f4, <f8 or <i4."""
        text = kind + base64.b64encode(np.asarray(x, kind).tobytes()).decode()
        return self.setdefault(text, len(self))


def script_json(content: Mapping[str, Any]) -> str:
    """Return JSON that is safe inside a <script> element."""
    return json.dumps(content).replace("<", "\\u003c")


def pieces_of(blocks: Iterable[Any]) -> list[dict[str, Any]]:
    """Return HTML and charts as what `drawPieces` takes."""
    return [
        {"chart": block.data(), "words": block.words, "height": block.height}
        if isinstance(block, Chart)
        else {"html": str(block)}
        for block in blocks
    ]


def _fits_single(x: np.ndarray) -> bool:
    """Return whether x (n,) keeps its steps in single precision, as times far from 0 do not."""
    known = x[np.isfinite(x)]
    if not len(known):
        return True
    return bool(np.spacing(np.float32(np.abs(known).max())) <= SINGLE * np.ptp(known))


def _pixels(panel: Panel) -> int:
    return max(LEAST, int(PIXELS * panel.height))


def source(name: str) -> str:
    """Return a script of BokehJS (`bokeh.min.js`, `bokeh-api.min.js`) or of this package."""
    if name in PACKAGE_SCRIPTS:
        return resources.files("ident.show.charts").joinpath(name).read_text(encoding="utf-8")
    package = find_spec("bokeh")  # is not imported: that takes longer than to read the script
    if package is None or package.origin is None:
        raise ModuleNotFoundError("No module named 'bokeh'", name="bokeh")
    folder = Path(package.origin).parent / "server" / "static" / "js"
    return (folder / name).read_text(encoding="utf-8")


def scripts(charts: bool = True, scenes: bool = False) -> str:
    """Return what a page with charts, or 3-D scenes, needs, inline."""
    names = ["bokeh.min.js", "bokeh-api.min.js"] * charts + ["charts.js"] + ["scene.js"] * scenes
    texts = (source(name).replace("</script", "<\\/script") for name in names)
    return "".join(f"<script>{text}</script>" for text in texts)


# --- still, by Matplotlib -------------------------------------------------------------------------


def _figure(chart: Chart) -> Figure:
    from matplotlib.figure import Figure

    rows, columns = len(chart.rows), max(map(len, chart.rows))
    heights = [max(panel.height for panel in row) for row in chart.rows]
    figure = Figure(figsize=(chart.width, 0.9 + sum(heights)), layout="constrained")
    grid = figure.subplots(
        rows, columns, squeeze=False, height_ratios=heights,
        sharex=chart.shared_x, sharey="all" if chart.shared_y else False,
    )  # fmt: skip
    for i, (axes, panels) in enumerate(zip(grid, chart.thinned(POINTS).rows, strict=True), 1):
        for axis, panel in zip(axes, panels, strict=False):
            _panel(axis, panel)
            if chart.shared_x:
                axis.margins(x=0)
                if i < rows:
                    axis.set_xlabel("")
        for axis in axes[len(panels) :]:
            axis.set_axis_off()
    handles: dict[str, Any] = {}
    for axis in grid.flat:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        names = [name if len(name) <= LABEL else f"{name[:LABEL]}…" for name in handles]
        legend = figure.legend(
            list(handles.values()), names, loc="outside upper center", ncols=min(len(names), 5),
            fontsize="small", frameon=False,
        )  # fmt: skip
        for text in legend.get_texts():
            text.set_parse_math(False)
    return figure


def _panel(axis: Axes, panel: Panel) -> None:
    for mark in panel.marks:
        _draw(mark, axis)
    axis.grid(alpha=0.25)
    for edge in ("top", "right"):
        axis.spines[edge].set_visible(False)
    if panel.logarithmic:
        axis.set_yscale("log")
    if panel.logarithmic_x:
        axis.set_xscale("log")
    if panel.x_range:
        axis.set_xlim(*panel.x_range)
    if panel.y_range:
        axis.set_ylim(*panel.y_range)
    if panel.x_names:
        wide = max(map(len, panel.x_names)) > SHORT
        tilt: dict[str, Any] = {"rotation": 25, "ha": "right"} if wide else {}
        axis.set_xticks(range(len(panel.x_names)), panel.x_names, parse_math=False, **tilt)
    if panel.y_names:
        axis.set_yticks(range(len(panel.y_names)), panel.y_names, parse_math=False)
        axis.set_ylim(len(panel.y_names) - 0.5, -0.5)
    axis.set_xlabel(panel.x, parse_math=False)
    axis.set_ylabel(panel.y, parse_math=False)
    if panel.title:
        axis.set_title(panel.title, fontsize="small", parse_math=False)
    if panel.marked:
        for spine in axis.spines.values():
            spine.set(visible=True, color=colour("residual"), linewidth=1.8)
        axis.title.set_color(colour("residual"))


def _draw(mark: Mark, axis: Axes) -> None:
    c, label = colour(mark.colour), mark.label or None
    style: dict[str, Any]
    match mark:
        case Line():
            line = "o-" if mark.dotted else "-"
            axis.plot(mark.x, mark.y, line, ms=4, color=c, lw=mark.width, label=label)
        case Points():
            cloud = mark.thinned(CLOUD)
            style = {"s": 3, "alpha": 0.45, "lw": 0, "rasterized": True}
            axis.scatter(cloud.x, cloud.y, color=c, label=label, **style)
        case Dots():
            errors = mark.errors if np.any(mark.errors) else None
            style = {"fmt": "o", "ms": 4, "capsize": 3, "lw": 1.2}
            style |= {"fmt": "|", "ms": 9, "mew": 1.8} if mark.upright else {}
            axis.errorbar(mark.values, mark.at, xerr=errors, color=c, label=label, **style)
        case Level():
            across = axis.axvline if mark.upright else axis.axhline
            across(mark.value, color=c, lw=1.0, ls="--" if mark.dashed else "-", label=label)
