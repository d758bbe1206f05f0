"""Charts to be zoomed: data for `charts.js`, which draws them by BokehJS's own API.

Nothing of Bokeh runs in Python: its Python models take 2 s for the 65 panels of a report of seven
joints, the data 0.1 s. A long line goes into the page whole, as binary numbers; `charts.js` draws
the extremes of the samples in view, so that a million samples zoom as easily as a thousand.
"""

from __future__ import annotations

import base64
import html
import json
import math
from dataclasses import dataclass, fields
from importlib import resources
from typing import Any

import numpy as np

from ident.show.charts.marks import CLOUD, Drawing, Mark, Panel, Points, colour

PIXELS = 75  # of one inch of a panel's height
LEAST = 150  # pixels, below which nobody reads a panel


@dataclass(frozen=True, eq=False)
class Live:
    """A chart that can be zoomed; Jupyter shows it as it is. Made by `Chart.live`."""

    chart: Drawing

    def data(self) -> str:
        """Return the chart as JSON, safe inside a <script> element; what `drawChart` takes."""
        arrays: dict[str, int] = {}  # each once, however many lines share it

        def placed(x: np.ndarray, kind: str) -> int:
            text = kind + base64.b64encode(np.asarray(x, kind).tobytes()).decode()
            return arrays.setdefault(text, len(arrays))

        def plain(value: Any, name: str) -> Any:
            if isinstance(value, np.ndarray):  # y needs no more digits than a screen has
                return placed(value, "<f4" if name == "y" else "<f8")
            return None if isinstance(value, float) and not math.isfinite(value) else value

        def described(mark: Mark) -> dict[str, Any]:
            found = {f.name: plain(getattr(mark, f.name), f.name) for f in fields(mark)}
            return {"kind": type(mark).__name__, **found, "colour": colour(mark.colour)}

        def panel_data(panel: Panel) -> dict[str, Any]:
            own = {f.name: getattr(panel, f.name) for f in fields(panel)}
            marks = [described(_thinned(mark)) for mark in panel.marks]
            return own | {"height": _pixels(panel), "marks": marks}

        rows = [list(map(panel_data, row)) for row in self.chart.rows]
        content = {
            "rows": rows, "arrays": list(arrays), "shared_x": self.chart.shared_x,
            "shared_y": self.chart.shared_y,
        }  # fmt: skip
        return json.dumps(content).replace("<", "\\u003c")

    def html(self) -> str:
        """Return a page that needs no network."""
        words = html.escape(self.chart.words)
        return (
            f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{words}</title>'
            f'{scripts()}</head><body style="margin:0"><div id="chart" role="img" '
            f'aria-label="{words}"></div>'
            f'<script>drawChart({self.data()}, document.getElementById("chart"))</script></body>'
            "</html>"
        )

    @property
    def height(self) -> int:
        """Height [pixel]."""
        return 70 + sum(max(map(_pixels, row)) for row in self.chart.rows)

    def _repr_html_(self) -> str:
        page = html.escape(self.html())
        return (
            f'<iframe srcdoc="{page}" title="{html.escape(self.chart.words)}" '
            f'style="width:100%;height:{self.height}px;border:0"></iframe>'
        )


def _thinned(mark: Mark) -> Mark:
    return mark.thinned(CLOUD) if isinstance(mark, Points) else mark


def _pixels(panel: Panel) -> int:
    return max(LEAST, int(PIXELS * panel.height))


def source(name: str) -> str:
    """Return a script of BokehJS (`bokeh.min.js`, `bokeh-api.min.js`) or of this package."""
    own = resources.files("ident.show.charts").joinpath(name)
    # the folder is read without importing bokeh, which takes half a second
    path = own if name == "charts.js" else resources.files("bokeh").joinpath(
        "server", "static", "js", name)  # fmt: skip
    return path.read_text(encoding="utf-8")


def scripts() -> str:
    """Return what a page with charts needs, inline."""
    names = ("bokeh.min.js", "bokeh-api.min.js", "charts.js")
    texts = (source(name).replace("</script", "<\\/script") for name in names)
    return "".join(f"<script>{text}</script>" for text in texts)
