"""Reports: sections of words, tables and charts in one HTML file that opens without a network."""

from ident.show.html.elements import (
    code,
    definitions,
    folded,
    headed,
    items,
    paragraph,
    strong,
    table,
)
from ident.show.html.origin import origin, running
from ident.show.html.page import Block, Choice, Option, Page, Section
from ident.show.html.shown import Shown

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
    "items",
    "origin",
    "paragraph",
    "running",
    "strong",
    "table",
]
