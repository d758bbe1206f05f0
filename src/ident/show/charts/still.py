"""Charts drawn by Matplotlib."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ident.show.charts import (
    CLOUD,
    Bars,
    Boxes,
    Chart,
    Dots,
    Level,
    Line,
    Mark,
    Panel,
    Points,
    colour,
)

POINTS = 2000  # buckets of a line; more would not be seen
SHORT = 6  # characters of names that stand upright beside each other
LABEL = 34  # characters of a name in a legend


def figure_of(chart: Chart) -> Figure:
    """Return the chart as a figure that belongs to no window."""
    rows, columns = len(chart.rows), max(map(len, chart.rows))
    heights = [max(panel.height for panel in row) for row in chart.rows]
    figure = Figure(figsize=(chart.width, 0.9 + sum(heights)), layout="constrained")
    grid = figure.subplots(
        rows, columns, squeeze=False, height_ratios=heights,
        sharex=chart.shared_x, sharey="row" if chart.shared_y else False,
    )  # fmt: skip
    for axes, panels in zip(grid, chart.thinned(POINTS).rows, strict=True):
        for axis, panel in zip(axes, panels, strict=False):
            _panel(axis, panel)
            if chart.shared_x:
                axis.margins(x=0)
                if axes is not grid[-1]:
                    axis.set_xlabel("")
        for axis in axes[len(panels) :]:
            axis.set_axis_off()
    handles: dict[str, Any] = {}
    for axis in grid.flat:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        names = [each if len(each) <= LABEL else f"{each[:LABEL]}…" for each in handles]
        legend = figure.legend(
            list(handles.values()), names, loc="outside upper center", ncols=min(len(names), 5),
            fontsize="small", frameon=False,
        )  # fmt: skip
        for text in legend.get_texts():
            text.set_parse_math(False)
    return figure


def image(figure: Figure, kind: str) -> bytes:
    """Return a figure as the bytes of a png, svg or pdf."""
    stream = io.BytesIO()
    metadata = {"Date": None} if kind == "svg" else None
    figure.savefig(stream, format=kind, dpi=130, metadata=metadata)
    return stream.getvalue()


def _panel(axis: Axes, panel: Panel) -> None:
    for mark in panel.marks:
        _draw(mark, axis)
    axis.grid(alpha=0.25)
    for edge in ("top", "right"):
        axis.spines[edge].set_visible(False)
    if panel.logarithmic:
        axis.set_yscale("log")
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
            some = mark.thinned(CLOUD)
            style = {"s": 3, "alpha": 0.45, "lw": 0, "rasterized": True}
            axis.scatter(some.x, some.y, color=c, label=label, **style)
        case Dots():
            errors = mark.errors if np.any(mark.errors) else None
            style = {"fmt": "o", "ms": 4, "capsize": 3, "lw": 1.2}
            axis.errorbar(mark.values, mark.at, xerr=errors, color=c, label=label, **style)
        case Bars():
            errors = mark.errors if np.any(mark.errors) else None
            style = {"height": 0.7, "ecolor": "0.3", "capsize": 2}
            axis.barh(mark.at, mark.values, xerr=errors, color=c, label=label, **style)
        case Boxes():
            low, q1, middle, q3, high = mark.quantiles.T
            half = mark.width / 2
            axis.vlines(mark.at, low, high, color=c, lw=1.0)
            axis.bar(mark.at, q3 - q1, mark.width, q1, color=c, alpha=0.6, label=label)
            axis.hlines(middle, mark.at - half, mark.at + half, color="black", lw=1.2)
        case Level(diagonal=True):
            axis.axline((0, 0), slope=1, color=c, lw=1.2, ls=_dash(mark), label=label)
        case Level(upright=True):
            axis.axvline(mark.value, color=c, lw=1.0, ls=_dash(mark), label=label)
        case Level():
            axis.axhline(mark.value, color=c, lw=1.0, ls=_dash(mark), label=label)
        case _:
            raise TypeError(f"{mark!r} is no mark; valid: Line, Points, Bars, Dots, Boxes, Level")


def _dash(mark: Level) -> str:
    return "--" if mark.dashed else "-"
