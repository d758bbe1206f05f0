"""An empty panel as Bokeh's objects: ranges, axes, grid and tools."""

from __future__ import annotations

from typing import Any

from ident.show.charts.chart import Chart, Panel
from ident.show.charts.glyphs import GREY
from ident.show.charts.objects import Maker, Thing, mapping, plain
from ident.show.charts.palette import RESIDUAL, colour

PIXELS = 75  # of one inch of a panel's height
LEAST = 150  # pixels, below which nobody reads a panel
ABREAST = 3  # panels in a row, from which they are narrow
SHORT, TILT = 6, 0.45  # characters of names that stand beside each other; else [rad]
TIPS = [["", "$name"], ["x", "@x{0.0000}"], ["y", "@y{0.00000}"]]


def height_of(panel: Panel) -> int:
    """Of a panel [pixel]."""
    return max(LEAST, int(PIXELS * panel.height))


def panel_of(
    chart: Chart, panel: Panel, make: Maker, shared: Thing | None, left: Thing | None, below: bool
) -> tuple[Thing, dict[str, Thing]]:
    """A figure without marks, and its tools by name.

    Args:
        chart, panel: what it is of.
        make: of objects.
        shared: the x range of all panels, if they share one.
        left: the first figure of the row, whose y range may be shared.
        below: whether it is in the last row.
    """
    alarm = colour(RESIDUAL)
    inner = left is not None and chart.shared_y
    named = not chart.shared_x or below  # whether the x axis has its numbers
    few = 3 if len(chart.rows[0]) > ABREAST else 6  # numbers beside each other stay apart
    font = "11px" if named else "0px"
    x = _axis(make, panel.x if named else None, panel.x_names, font=font, ticks=few)
    if max(map(len, panel.x_names), default=0) > SHORT:
        x["attributes"]["major_label_orientation"] = TILT
    y = _axis(make, panel.y, panel.y_names, visible=not inner, logarithmic=panel.logarithmic)
    tools = _tools(make, "width" if chart.shared_x else "both")
    figure = make(
        "Figure", height=height_of(panel), sizing_mode="stretch_width",
        x_range=_x_range(panel, make) if shared is None else shared,
        y_range=left["attributes"]["y_range"]
        if left is not None and chart.shared_y else _y_range(panel, make),
        x_scale=make("LinearScale"),
        y_scale=make("LogScale" if panel.logarithmic else "LinearScale"),
        title=make(
            "Title", text=plain(panel.title, make), text_color=alarm if panel.marked else GREY
        ),
        outline_line_color=alarm if panel.marked else None,
        outline_line_width=3 if panel.marked else 1,
        toolbar=make("Toolbar", tools=list(tools.values()),
                     active_drag=tools["zoom"], active_scroll=tools["wheel"]),
        toolbar_location=None, renderers=[], left=[y], above=[], below=[x],
        center=[_grid(make, x, 0), _grid(make, y, 1)],
        background_fill_color=None, border_fill_color=None, min_border_left=8 if inner else 70,
    )  # fmt: skip
    return figure, tools


def _x_range(panel: Panel, make: Maker) -> Thing:
    if not panel.x_names:
        return make("DataRange1d")
    return make("Range1d", start=-0.5, end=len(panel.x_names) - 0.5)


def _y_range(panel: Panel, make: Maker) -> Thing:
    if not panel.y_names:
        return make("DataRange1d")
    return make("Range1d", start=len(panel.y_names) - 0.5, end=-0.5)


def _axis(
    make: Maker, label: str | None, names: tuple[str, ...], *, font: str = "11px",
    visible: bool = True, logarithmic: bool = False, ticks: int = 6,
) -> Thing:  # fmt: skip
    kind = "Log" if logarithmic else "Linear"
    if logarithmic:
        ticker, formatter = make("LogTicker"), make("LogTickFormatter")
    else:
        ticker = make("BasicTicker", desired_num_ticks=ticks)
        formatter = make("BasicTickFormatter", power_limit_high=6, power_limit_low=-6)
    more: dict[str, Any] = {}
    if names:
        ticker = make("FixedTicker", ticks=list(range(len(names))), minor_ticks=[])
        more["major_label_overrides"] = mapping(
            {i: plain(name, make) for i, name in enumerate(names)}
        )
    return make(
        f"{kind}Axis", ticker=ticker, formatter=formatter,
        major_label_policy=make("AllLabels"), axis_label=plain(label, make), visible=visible,
        axis_label_text_font_style="normal", axis_label_text_color=GREY,
        major_label_text_color=GREY, major_label_text_font_size=font, axis_line_color=GREY,
        major_tick_line_color=GREY, minor_tick_line_color=GREY, **more,
    )  # fmt: skip


def _grid(make: Maker, axis: Thing, dimension: int) -> Thing:
    return make("Grid", axis=axis, dimension=dimension, grid_line_color=GREY, grid_line_alpha=0.25)


def _tools(make: Maker, along: str) -> dict[str, Thing]:
    """The wheel needs the control key, so that it scrolls the page as it always does."""
    nan = float("nan")
    box = make(
        "BoxAnnotation", syncable=False, level="overlay", visible=False, left=nan, right=nan,
        top=nan, bottom=nan, left_units="canvas", right_units="canvas", top_units="canvas",
        bottom_units="canvas", line_color=GREY, line_dash="dashed", fill_color=GREY, fill_alpha=0.2,
    )  # fmt: skip
    return {
        "zoom": make("BoxZoomTool", dimensions=along, overlay=box),
        "pan": make("PanTool", dimensions=along),
        "wheel": make("WheelZoomTool", dimensions=along, renderers="auto",
                      modifiers=mapping({"ctrl": True})),
        "reset": make("ResetTool"),
        "hover": make("HoverTool", renderers="auto", tooltips=TIPS, sort_by=None),
    }  # fmt: skip
