"""How nouns show themselves in Jupyter: the pieces that reports are made of, without the page."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from importlib import resources

from markupsafe import Markup

from ident.show.charts import Chart
from ident.show.html.elements import code

STYLE = resources.files("ident.show.html").joinpath("shown.css").read_text(encoding="utf-8")


def in_frame(blocks: Iterable[Markup | Chart]) -> str:
    """Return blocks as one piece of HTML with its own style, charts as still pictures."""
    inside = Markup("\n").join(_still(block) for block in blocks)
    frame = Markup('<style>{}</style><div class="ident">{}</div>')
    return str(frame.format(Markup(STYLE), inside))


class Shown:
    """A noun that Jupyter shows as tables; by default as it prints itself."""

    def _blocks(self) -> Iterable[Markup | Chart]:
        return (code(str(self)),)

    def _repr_html_(self) -> str:
        return in_frame(self._blocks())


def _still(block: Markup | Chart) -> Markup:
    if isinstance(block, Markup):
        return block
    data = base64.b64encode(block._repr_png_()).decode()
    return Markup('<img alt="{}" src="data:image/png;base64,{}">').format(block.words, data)
