"""A chart as Bokeh's document: panels in a grid, one toolbar, one legend.

A long line is drawn by the extremes of some thousand buckets of the samples in view, which
`follow.js` takes anew whenever the view changes: a million samples zoom as easily as a thousand.
"""

from __future__ import annotations

from importlib import resources
from typing import Any

import numpy as np

from ident.show.charts.axes import panel_of
from ident.show.charts.chart import Chart, extremes
from ident.show.charts.glyphs import GREY, glyphs
from ident.show.charts.marks import Level, Line
from ident.show.charts.objects import Maker, Thing, encoded, mapping

POINTS = 1000  # buckets of a line in view
LEGEND = 28  # pixels of the line above the first panel
ALL = "all samples"  # name of the sources that hold them
TOGETHER = "for (const other of others) other.visible = cb_obj.visible"
TOOLS = ("zoom", "pan", "wheel", "reset", "hover")


def document_of(chart: Chart, prefix: str) -> dict[str, Any]:
    """What `Bokeh.embed.embed_item` takes; ids begin with the prefix."""
    from bokeh import __version__

    make = Maker(prefix)
    root = _grid(chart, make)
    doc = {"version": __version__, "title": "", "roots": [encoded(root)]}
    return {"root_id": root["id"], "doc": doc, "version": __version__}


def _grid(chart: Chart, make: Maker) -> Thing:
    shared = make("Range1d", name="shared", **_ends(chart)) if chart.shared_x else None
    sources: dict[int, Thing] = {}
    long: list[tuple[Thing, str, Thing]] = []
    placed: list[list[Any]] = []
    tools: list[dict[str, Thing]] = []
    for number, row in enumerate(chart.rows):
        left: Thing | None = None
        for column, panel in enumerate(row):
            below = number == len(chart.rows) - 1
            figure, own = panel_of(chart, panel, make, shared, left, below)
            left = left or figure
            tools.append(own)
            for mark in panel.marks:
                thin = extremes(mark, POINTS) if isinstance(mark, Line) else mark
                shown = glyphs(thin, make)
                place = "center" if isinstance(mark, Level) else "renderers"
                figure["attributes"][place] += shown
                if isinstance(mark, Line) and len(mark.y) > 2 * POINTS:
                    source = sources.setdefault(id(mark.x), make.source({"x": mark.x}, ALL))
                    columns = source["attributes"]["data"]["entries"]
                    columns.append([f"y{len(columns)}", mark.y.astype(np.float32)])
                    data = shown[0]["attributes"]["data_source"]
                    long.append((source, columns[-1][0], data))
            placed.append([figure, number, column])
    if shared is not None and long:
        _follow(shared, long, make)
    if placed:
        _one_legend([figure for figure, *_ in placed], len(chart.rows[0]), make)
    return make(
        "GridPlot", sizing_mode="stretch_width", toolbar=_toolbar(tools, make), children=placed,
        rows=None, cols=None,
    )  # fmt: skip


def _ends(chart: Chart) -> dict[str, float]:
    """Of all that the panels have along x."""
    x = [mark.x for p in chart.panels for mark in p.marks if hasattr(mark, "x") and len(mark.x)]
    low, high = (min(map(np.min, x)), max(map(np.max, x))) if x else (0.0, 1.0)
    return {"start": float(low), "end": float(high if high > low else low + 1)}


def _toolbar(tools: list[dict[str, Thing]], make: Maker) -> Thing:
    """One button for the same tool of all panels."""
    proxies = {name: make("ToolProxy", tools=[own[name] for own in tools]) for name in TOOLS}
    return make(
        "Toolbar", logo=None, tools=list(proxies.values()), active_drag=proxies["zoom"],
        active_scroll=proxies["wheel"],
    )  # fmt: skip


def _follow(shared: Thing, long: list[tuple[Thing, str, Thing]], make: Maker) -> None:
    """Resample long lines whenever the view changes."""
    code = resources.files("ident.show.charts").joinpath("follow.js").read_text(encoding="utf-8")
    sources, columns, shown = (list(each) for each in zip(*long, strict=True))
    args = {
        "range": shared, "sources": sources, "columns": columns, "shown": shown,
        "points": POINTS,
    }  # fmt: skip
    callback = make("CustomJS", args=mapping(args), code=code)
    told = {"change:start": [callback], "change:end": [callback]}
    shared["attributes"]["js_property_callbacks"] = mapping(told)


def _one_legend(figures: list[Thing], across: int, make: Maker) -> None:
    """Above the first panel; a click on a name hides it in all panels."""
    first = figures[0]["attributes"]
    named: dict[str, list[Thing]] = {}
    for figure in figures:
        for renderer in figure["attributes"]["renderers"]:
            for label in renderer["attributes"]["tags"]:
                named.setdefault(label, []).append(renderer)
    own = {each["id"] for each in first["renderers"]}
    items = []
    for label, (leader, *others) in named.items():
        if leader["id"] not in own:  # a legend shows what is in its own panel
            leader, others = _stand_in(leader, label, make), [leader, *others]
            first["renderers"].append(leader)
        if others:
            callback = make("CustomJS", args=mapping({"others": others}), code=TOGETHER)
            told = mapping({"change:visible": [callback]})
            leader["attributes"]["js_property_callbacks"] = told
        said = {"type": "value", "value": label}
        items.append(make("LegendItem", label=said, renderers=[leader]))
    if not items:
        return
    legend = make(
        "Legend", items=items, orientation="horizontal", click_policy="hide", spacing=14,
        location="top_left", padding=2, margin=2, background_fill_color=None,
        border_line_color=None, label_text_color=GREY,
    )  # fmt: skip
    first["above"].append(legend)
    for figure in figures[:across]:  # all panels of the row stay on one line
        figure["attributes"]["height"] += LEGEND
        if figure is not figures[0]:
            figure["attributes"]["min_border_top"] = LEGEND


def _stand_in(leader: Thing, label: str, make: Maker) -> Thing:
    """The same looks with nothing to draw."""
    glyph = leader["attributes"]["glyph"]
    columns = leader["attributes"]["data_source"]["attributes"]["data"]["entries"]
    nothing = make.source({name: np.array([np.nan]) for name, _ in columns})
    return make.drawn(glyph["name"], nothing, label, **glyph["attributes"])
