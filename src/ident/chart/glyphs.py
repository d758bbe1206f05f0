"""One mark in one Bokeh plot. A glyph's tags hold the label that the legend gathers."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import numpy as np

from ident.chart.marks import Bars, Boxes, Dots, Level, Line, Mark, Points
from ident.chart.palette import colour

GREY = "#767c86"  # text and axes, legible on white and on black
CLOUD = 4000  # points of a cloud


@singledispatch
def draw(mark: Mark, plot: Any) -> Any:
    """Draws a mark; returns its data source."""
    raise NotImplementedError(mark)


def _tagged(renderer: Any, label: str) -> Any:
    renderer.tags = [label] if label else []
    renderer.name = label
    return renderer


@draw.register
def _(mark: Line, plot: Any) -> Any:
    data = {"x": mark.x, "y": mark.y.astype(np.float32)}
    c = colour(mark.colour)
    line = _tagged(plot.line("x", "y", source=data, color=c, line_width=mark.width), mark.label)
    if mark.dotted:
        source = line.data_source
        _tagged(plot.scatter("x", "y", source=source, size=6, color=c), mark.label)
    return line.data_source


@draw.register
def _(mark: Points, plot: Any) -> Any:
    some = slice(None, None, max(1, len(mark.x) // CLOUD))
    data = {"x": mark.x[some].astype(np.float32), "y": mark.y[some].astype(np.float32)}
    c = colour(mark.colour)
    return _tagged(plot.scatter("x", "y", source=data, size=3, color=c, alpha=0.45), mark.label)


@draw.register
def _(mark: Bars, plot: Any) -> Any:
    c = colour(mark.colour)
    _tagged(plot.hbar(y=mark.at, right=mark.values, height=0.7, color=c), mark.label)
    return _whiskers(mark, plot, GREY)


@draw.register
def _(mark: Dots, plot: Any) -> Any:
    c = colour(mark.colour)
    _tagged(plot.scatter(mark.values, mark.at, size=7, color=c), mark.label)
    return _whiskers(mark, plot, c)


def _whiskers(mark: Bars | Dots, plot: Any, c: str) -> Any:
    low, high = mark.values - mark.errors, mark.values + mark.errors
    return plot.segment(x0=low, x1=high, y0=mark.at, y1=mark.at, color=c, line_width=1.5)


@draw.register
def _(mark: Boxes, plot: Any) -> Any:
    c, half = colour(mark.colour), mark.width / 2
    low, q1, middle, q3, high = mark.quantiles.T
    plot.segment(x0=mark.at, x1=mark.at, y0=low, y1=high, color=c)
    box = plot.vbar(x=mark.at, bottom=q1, top=q3, width=mark.width, color=c, alpha=0.6)
    plot.segment(x0=mark.at - half, x1=mark.at + half, y0=middle, y1=middle, color=c, line_width=2)
    return _tagged(box, mark.label)


@draw.register
def _(mark: Level, plot: Any) -> Any:
    from bokeh.models.annotations import Slope, Span

    style: dict[str, Any] = {
        "line_color": colour(mark.colour),
        "line_dash": "dashed" if mark.dashed else "solid",
    }
    if mark.diagonal:
        line: Any = Slope(gradient=1, y_intercept=0, **style)
    else:
        line = Span(location=mark.value, dimension="height" if mark.upright else "width", **style)
    plot.add_layout(line)
    return line
