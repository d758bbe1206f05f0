"""Reports: sections of words, tables and charts in one HTML file that opens without a network."""

from ident.page.elements import (
    code,
    definitions,
    folded,
    headed,
    items,
    paragraph,
    strong,
    table,
)
from ident.page.origin import origin, running
from ident.page.page import Choice, Option, Page, Section
from ident.page.shown import Shown

__all__ = [
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
