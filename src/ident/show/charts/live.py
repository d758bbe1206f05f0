"""Charts to be zoomed: in a page of their own, in Jupyter, in an application."""

from __future__ import annotations

import html
import json
import secrets
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

from ident.show.charts.axes import height_of
from ident.show.charts.chart import Chart
from ident.show.charts.document import document_of

if TYPE_CHECKING:
    from bokeh.model import Model


@dataclass(frozen=True, eq=False)
class Live:
    """A chart that can be zoomed; Jupyter shows it as it is. Made by `Chart.live`."""

    chart: Chart

    @property
    def layout(self) -> Model:
        """Bokeh's model, for an application of one's own; a new one each time."""
        import bokeh.models  # makes the kinds known to the deserializer
        from bokeh.core.serialization import Deserializer

        # one application may hold many charts, and no two of its models one id
        (root,) = self.item(f"c{secrets.token_hex(4)}")["doc"]["roots"]
        found: bokeh.models.GridPlot = Deserializer().deserialize(root)
        return found

    def item(self, prefix: str = "c0") -> dict[str, Any]:
        """As `Bokeh.embed.embed_item` takes it; on one page, each chart needs its own prefix."""
        return document_of(self.chart, prefix)

    def html(self) -> str:
        """A page that needs no network."""
        item = json.dumps(self.item()).replace("<", "\\u003c")
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
        return 70 + sum(max(map(height_of, row)) for row in self.chart.rows)

    def _repr_html_(self) -> str:
        page = html.escape(self.html())
        return (
            f'<iframe srcdoc="{page}" title="{html.escape(self.chart.words)}" '
            f'style="width:100%;height:{self.height}px;border:0"></iframe>'
        )


def script() -> str:
    """Bokeh's own script, inline, and nothing that other packages would add to it."""
    path = resources.files("bokeh").joinpath("server", "static", "js", "bokeh.min.js")
    text = path.read_text(encoding="utf-8").replace("</script", "<\\/script")
    return f"<script>{text}</script>"
