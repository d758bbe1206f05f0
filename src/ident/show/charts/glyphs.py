"""One mark as Bokeh's objects."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import numpy as np

from ident.show.charts.marks import Bars, Boxes, Dots, Level, Line, Mark, Points
from ident.show.charts.objects import Maker, Thing, constant, field
from ident.show.charts.palette import colour

GREY = "#767c86"  # text and axes, legible on white and on black
CLOUD = 4000  # points of a cloud
SEGMENT = {"x0": field("x0"), "x1": field("x1"), "y0": field("y0"), "y1": field("y1")}


@singledispatch
def glyphs(mark: Mark, make: Maker) -> list[Thing]:
    """What draws a mark; of a line, the line itself first."""
    raise TypeError(f"{mark!r} is no mark; valid: Line, Points, Bars, Dots, Boxes, Level")


def _xy(x: np.ndarray, y: np.ndarray) -> dict[str, np.ndarray]:
    return {"x": x.astype(np.float64), "y": y.astype(np.float32)}


def _dots(make: Maker, source: Thing, label: str, c: str, size: float, alpha: float = 1) -> Thing:
    return make.drawn(
        "Scatter", source, label, x=field("x"), y=field("y"), size=constant(size),
        line_color=constant(None), fill_color=constant(c), fill_alpha=constant(alpha),
    )  # fmt: skip


@glyphs.register
def _(mark: Line, make: Maker) -> list[Thing]:
    source, c = make.source(_xy(mark.x, mark.y)), colour(mark.colour)
    line = make.drawn(
        "Line", source, mark.label, x=field("x"), y=field("y"), line_color=c,
        line_width=mark.width,
    )  # fmt: skip
    if not mark.dotted:
        return [line]
    return [line, _dots(make, make.source(_xy(mark.x, mark.y)), mark.label, c, 6)]


@glyphs.register
def _(mark: Points, make: Maker) -> list[Thing]:
    some = slice(None, None, max(1, len(mark.x) // CLOUD))
    source = make.source(_xy(mark.x[some], mark.y[some]))
    return [_dots(make, source, mark.label, colour(mark.colour), 3, 0.45)]


@glyphs.register
def _(mark: Bars, make: Maker) -> list[Thing]:
    c, source = colour(mark.colour), make.source({"x": mark.values, "y": mark.at})
    bars = make.drawn(
        "HBar", source, mark.label, y=field("y"), right=field("x"),
        height=constant(0.7), line_color=constant(None), fill_color=constant(c),
    )  # fmt: skip
    return [bars, _whiskers(mark, make, GREY)]


@glyphs.register
def _(mark: Dots, make: Maker) -> list[Thing]:
    c = colour(mark.colour)
    source = make.source({"x": mark.values, "y": mark.at})
    return [_whiskers(mark, make, c), _dots(make, source, mark.label, c, 7)]


def _whiskers(mark: Bars | Dots, make: Maker, c: str) -> Thing:
    low, high = mark.values - mark.errors, mark.values + mark.errors
    return _segments(make, c, 1.5, x0=low, x1=high, y0=mark.at, y1=mark.at)


def _segments(make: Maker, c: str, width: float, **ends: np.ndarray) -> Thing:
    source = make.source(ends)
    looks = {"line_color": constant(c), "line_width": constant(width)}
    return make.drawn("Segment", source, "", **SEGMENT, **looks)


@glyphs.register
def _(mark: Boxes, make: Maker) -> list[Thing]:
    c, half = colour(mark.colour), mark.width / 2
    low, q1, middle, q3, high = mark.quantiles.T
    box = make.drawn(
        "VBar", make.source({"x": mark.at, "low": q1, "high": q3}), mark.label, x=field("x"),
        bottom=field("low"), top=field("high"), width=constant(mark.width),
        line_color=constant(c), fill_color=constant(c), fill_alpha=constant(0.6),
    )  # fmt: skip
    return [
        _segments(make, c, 1.0, x0=mark.at, x1=mark.at, y0=low, y1=high),
        box,
        _segments(make, c, 2.0, x0=mark.at - half, x1=mark.at + half, y0=middle, y1=middle),
    ]


@glyphs.register
def _(mark: Level, make: Maker) -> list[Thing]:
    style: dict[str, Any] = {
        "line_color": colour(mark.colour),
        "line_dash": "dashed" if mark.dashed else "solid",
    }
    if mark.diagonal:
        return [make("Slope", gradient=1, y_intercept=0, **style)]
    side = "height" if mark.upright else "width"
    return [make("Span", location=mark.value, dimension=side, **style)]
