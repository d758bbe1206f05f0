"""Charts drawn by Bokeh: to be zoomed, with every sample there when one comes close.

A long line is drawn by the extremes of some thousand buckets of the samples in view, which
`follow.js` takes anew whenever the view changes: a million samples zoom as easily as a thousand.
"""

from __future__ import annotations

import html
import json
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.chart.chart import Chart, Panel, extremes
from ident.chart.glyphs import GREY, draw
from ident.chart.marks import Line

if TYPE_CHECKING:
    from bokeh.model import Model
    from bokeh.models import ColumnDataSource

POINTS = 1500  # buckets of a line in view
PIXELS = 75  # of one inch of a panel's height
LEAST = 150  # pixels, below which nobody reads a panel
LEGEND = 28  # pixels of the line above the first panel
ALL = "all samples"  # name of the sources that hold them


@dataclass(frozen=True, eq=False)
class Live:
    """A chart that can be zoomed; Jupyter shows it as it is. Made by `Chart.live`."""

    chart: Chart

    @cached_property
    def layout(self) -> Model:
        """Bokeh's model, for an application of one's own."""
        return layout_of(self.chart)

    @property
    def json(self) -> dict[str, Any]:
        """As `Bokeh.embed.embed_item` takes it."""
        from bokeh.embed import json_item

        return dict(json_item(layout_of(self.chart)))

    def html(self) -> str:
        """A page that needs no network."""
        item = json.dumps(self.json).replace("</", "<\\/")
        words = html.escape(self.chart.words)
        return (
            f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{words}</title>'
            f'{script()}</head><body style="margin:0"><div id="chart" role="img" '
            f'aria-label="{words}"></div>'
            f'<script>Bokeh.embed.embed_item({item}, "chart")</script></body></html>'
        )

    @property
    def height(self) -> int:
        """[pixel]"""
        return 60 + sum(max(map(height_of, row)) for row in self.chart.rows)

    def _repr_html_(self) -> str:
        page = html.escape(self.html())
        return (
            f'<iframe srcdoc="{page}" title="{html.escape(self.chart.words)}" '
            f'style="width:100%;height:{self.height}px;border:0"></iframe>'
        )


def script() -> str:
    """Bokeh's own script, inline."""
    from bokeh.resources import Resources

    return str(Resources(mode="inline", components=["bokeh"]).render())


def height_of(panel: Panel) -> int:
    """Of a panel [pixel]."""
    return max(LEAST, int(PIXELS * panel.height))


def layout_of(chart: Chart) -> Model:
    """All panels in a grid, with one toolbar."""
    from bokeh.layouts import gridplot

    plots: list[list[Any]] = []
    first: Any = None
    sources: dict[int, ColumnDataSource] = {}
    long: list[tuple[ColumnDataSource, str, ColumnDataSource]] = []
    columns = max(map(len, chart.rows))
    for number, row in enumerate(chart.rows):
        plots.append([])
        last = number == len(chart.rows) - 1
        for panel in row:
            left = plots[-1][0] if plots[-1] else None
            plot = _plot(chart, panel, first, left, last)
            first = first or plot
            plots[-1].append(plot)
            for mark in panel.marks:
                shown = draw(extremes(mark, POINTS) if isinstance(mark, Line) else mark, plot)
                if isinstance(mark, Line) and len(mark.y) > 2 * POINTS:
                    source = _samples(sources, mark.x)
                    column = f"y{len(source.data)}"
                    source.data[column] = mark.y.astype(np.float32)
                    long.append((source, column, shown))
        plots[-1] += [None] * (columns - len(row))
    _one_legend([[plot for plot in row if plot is not None] for row in plots])
    if long and (chart.shared_x or len(chart.panels) == 1):
        _follow(first, long)
    return gridplot(
        plots, sizing_mode="stretch_width", merge_tools=True, toolbar_location="above",
        toolbar_options={"logo": None},
    )  # fmt: skip


def _plot(chart: Chart, panel: Panel, first: Any, left: Any, last: bool) -> Any:
    """An empty panel with its axes and tools."""
    from bokeh.models import BoxZoomTool, HoverTool, PanTool, ResetTool, WheelZoomTool
    from bokeh.plotting import figure

    along: Any = "width" if chart.shared_x or chart.timed else "both"
    zoom = BoxZoomTool(dimensions=along)
    wheel = WheelZoomTool(dimensions=along, modifiers="ctrl")
    hover = HoverTool(tooltips=[("", "$name"), ("x", "@x{0.0000}"), ("y", "@y{0.00000}")])
    plot = figure(
        height=height_of(panel), sizing_mode="stretch_width", title=panel.title,
        y_axis_type="log" if panel.logarithmic else "linear",
        tools=[zoom, PanTool(dimensions=along), wheel, ResetTool(), hover],
        active_drag=zoom, active_scroll=wheel, min_border_left=70,
    )  # fmt: skip
    if chart.shared_x:
        plot.x_range = first.x_range if first else _range(*_ends(chart), name="shared")
    if chart.shared_y and left is not None:
        plot.y_range = left.y_range
    if panel.x_names:
        _name(plot.xaxis, panel.x_names)
        plot.xaxis.major_label_orientation = 0.45
    if panel.y_names:
        _name(plot.yaxis, panel.y_names)
        plot.y_range = _range(len(panel.y_names) - 0.5, -0.5)
    if chart.shared_y and left is not None:
        plot.yaxis.visible = False
        plot.min_border_left = 8
    plot.xaxis.axis_label = panel.x if last or not chart.shared_x else None
    plot.xaxis.major_label_text_font_size = "11px" if last or not chart.shared_x else "0px"
    plot.yaxis.axis_label = panel.y
    plot.background_fill_color = plot.border_fill_color = None
    plot.outline_line_color = "#d1495b" if panel.marked else None
    plot.outline_line_width = 3 if panel.marked else 1
    title: Any = plot.title
    title.text_color = "#d1495b" if panel.marked else GREY
    plot.grid.grid_line_color, plot.grid.grid_line_alpha = GREY, 0.25
    for axis in plot.axis:
        axis.axis_label_text_color = axis.major_label_text_color = GREY
        axis.axis_line_color = axis.major_tick_line_color = axis.minor_tick_line_color = GREY
        axis.axis_label_text_font_style = "normal"
    return plot


def _range(start: float, end: float, name: str = "") -> Any:
    """A fixed one, which "reset" comes back to; `shared` to the page's script."""
    from bokeh.models import Range1d

    return Range1d(start=start, end=end, name=name or None)


def _name(axis: Any, names: tuple[str, ...]) -> None:
    axis.ticker = list(range(len(names)))
    axis.major_label_overrides = dict(enumerate(names))


def _ends(chart: Chart) -> tuple[float, float]:
    """Of all that the panels have along x."""
    x = [mark.x for p in chart.panels for mark in p.marks if hasattr(mark, "x") and len(mark.x)]
    low, high = (min(map(np.min, x)), max(map(np.max, x))) if x else (0.0, 1.0)
    return float(low), float(high if high > low else low + 1)


def _samples(sources: dict[int, ColumnDataSource], x: np.ndarray) -> ColumnDataSource:
    """Of all lines over one x, which is sent once."""
    from bokeh.models import ColumnDataSource

    if id(x) not in sources:
        sources[id(x)] = ColumnDataSource({"x": x}, name=ALL)
    return sources[id(x)]


def _follow(plot: Any, long: list[tuple[ColumnDataSource, str, ColumnDataSource]]) -> None:
    """Resample long lines whenever the view changes."""
    from bokeh.models import CustomJS

    code = resources.files("ident.chart").joinpath("follow.js").read_text(encoding="utf-8")
    sources, columns, shown = zip(*long, strict=True)
    args = {
        "range": plot.x_range, "sources": list(sources), "columns": list(columns),
        "shown": list(shown), "points": POINTS,
    }  # fmt: skip
    callback = CustomJS(args=args, code=code)
    plot.x_range.js_on_change("start", callback)
    plot.x_range.js_on_change("end", callback)


def _one_legend(rows: list[list[Any]]) -> None:
    """Above the first panel; a click on a name hides it in all panels."""
    from bokeh.models.annotations import Legend, LegendItem

    first = rows[0][0]
    named: dict[str, list[Any]] = {}
    for plot in (plot for row in rows for plot in row):
        for renderer in plot.renderers:
            for label in renderer.tags:
                named.setdefault(label, []).append(renderer)
    items = []
    for label, renderers in named.items():
        own = next((r for r in renderers if r in first.renderers), None)
        if own is None:
            continue
        for other in renderers:
            if other is not own:
                own.js_link("visible", other, "visible")
        items.append(LegendItem(label={"value": label}, renderers=[own]))
    if not items:
        return
    legend: Any = Legend(items=items, orientation="horizontal", click_policy="hide", spacing=14)
    legend.background_fill_color = legend.border_line_color = None
    legend.label_text_color = GREY
    legend.padding = legend.margin = 2
    legend.location = "top_left"
    first.add_layout(legend, "above")
    for plot in rows[0]:  # all panels of the row stay on one line
        plot.height += LEGEND
        if plot is not first:
            plot.min_border_top = LEGEND
