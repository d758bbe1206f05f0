"""The page's own parts: a list of effects, a ladder, a line of status. Words come as text."""

from __future__ import annotations

import json
from importlib import resources
from typing import Any, ClassVar

import panel
import param

from ident.show.charts.live import source


def _text(name: str) -> str:
    return resources.files("ident.explore").joinpath(name).read_text(encoding="utf-8")


CSS, PAGE, CHOICE = _text("parts.css"), _text("page.css"), _text("choice.css")
FOLD = _text("fold.css")  # of rows whose parts stand one below the other where it is narrow


class LiveChart(panel.custom.JSComponent):
    """A chart that can be zoomed, drawn in the browser as in reports."""

    data = param.String()
    words = param.String()

    _esm: ClassVar[Any] = (
        f"const api = {json.dumps(source('bokeh-api.min.js'))};\n"
        + source("charts.js")
        + _text("chart.js")
    )


class Candidates(panel.custom.JSComponent):
    """Effects with a button each; a click sends {"label", "present"}."""

    rows = param.List()
    said = param.String()
    stale = param.Boolean()
    locked = param.Boolean()

    _esm: ClassVar[Any] = _text("candidates.js")
    _stylesheets: ClassVar[Any] = [CSS]


class Ladder(panel.custom.JSComponent):
    """Rungs as rows, the head first; a click on an earlier one sends {"rung"}."""

    rows = param.List()
    locked = param.Boolean()

    _esm: ClassVar[Any] = _text("ladder.js")
    _stylesheets: ClassVar[Any] = [CSS]


class Status(panel.custom.JSComponent):
    """A title and one line that is read out: `kind` is done, busy or bad."""

    title = param.String()
    said = param.String()
    kind = param.String("done")
    share = param.Number(0.0)

    _esm: ClassVar[Any] = _text("status.js")
    _stylesheets: ClassVar[Any] = [CSS]
