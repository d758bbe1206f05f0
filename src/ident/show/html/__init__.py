"""HTML for reports and notebooks: words, tables and charts, everything from outside escaped."""

from ident.show.html.elements import (
    Shown,
    code,
    definitions,
    folded,
    headed,
    in_frame,
    items,
    paragraph,
    strong,
    table,
)
from ident.show.html.page import Block, Choice, Option, Page, Section, origin, running

__all__ = [
    "Block",
    "Choice",
    "Option",
    "Page",
    "Section",
    "Shown",
    "code",
    "definitions",
    "folded",
    "headed",
    "in_frame",
    "items",
    "origin",
    "paragraph",
    "running",
    "strong",
    "table",
]
