"""Bokeh's objects as its documents hold them.

`{"type": "object", "name": "Line", "id": "c0-7", "attributes": {…}}`: said directly, hundreds of
panels cost milliseconds, where Bokeh's own Python models cost seconds. Arrays are encoded by Bokeh.
https://docs.bokeh.org/en/latest/docs/dev_guide/bokehjs.html
"""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np

Thing = dict[str, Any]


class Maker:
    """Makes objects whose ids begin with a prefix, so that charts can share one page."""

    def __init__(self, prefix: str) -> None:
        self._ids = (f"{prefix}-{i}" for i in count())

    def __call__(self, kind: str, **attributes: Any) -> Thing:
        """An object of a kind."""
        return {"type": "object", "name": kind, "id": next(self._ids), "attributes": attributes}

    def source(self, columns: dict[str, np.ndarray], name: str = "") -> Thing:
        """Columns of data (n,)."""
        chosen = {"name": name} if name else {}
        return self(
            "ColumnDataSource", data=mapping(columns), selected=self("Selection", indices=[]),
            selection_policy=self("UnionRenderers"), **chosen,
        )  # fmt: skip

    def drawn(self, kind: str, source: Thing, label: str, **looks: Any) -> Thing:
        """A glyph of a kind over the columns of a source; the legend gathers labels from tags."""
        view = self("CDSView", filter=self("AllIndices"))
        return self(
            "GlyphRenderer", name=label or None, tags=[label] if label else [],
            data_source=source, view=view, glyph=self(kind, **looks),
        )  # fmt: skip


def field(column: str) -> Thing:
    """The values of a column."""
    return {"type": "field", "field": column}


def plain(words: str | None, make: Maker) -> Any:
    """Words that Bokeh must not read as mathematics, whatever signs are in them."""
    return make("PlainText", text=words) if words and "$" in words else words


def constant(value: Any) -> Thing:
    """One value for all."""
    return {"type": "value", "value": value}


def mapping(entries: dict[Any, Any]) -> Thing:
    """A dictionary."""
    return {"type": "map", "entries": [[key, value] for key, value in entries.items()]}


def encoded(root: Thing) -> Thing:
    """As JSON takes it: arrays encoded, an object in full where it comes first, then by its id."""
    from bokeh.core.serialization import Serializer

    serializer = Serializer(deferred=False)
    seen: set[str] = set()

    def walk(each: Any) -> Any:
        if isinstance(each, np.ndarray):
            return serializer.encode(np.ascontiguousarray(each))
        if isinstance(each, dict):
            if (name := each.get("id")) is not None:
                if name in seen:
                    return {"id": name}
                seen.add(name)
            return {key: walk(inner) for key, inner in each.items()}
        if isinstance(each, list | tuple):
            return [walk(inner) for inner in each]
        each = each.item() if isinstance(each, np.generic) else each
        return {"type": "number", "value": "nan"} if each != each else each

    found: Thing = walk(root)
    return found
