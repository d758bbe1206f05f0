"""Reports: sections of words, tables and charts in one HTML file that opens without a network."""

from ident.page.elements import code, definitions, headed, items, paragraph, table
from ident.page.origin import origin, running
from ident.page.page import Choice, Option, Page, Section

__all__ = [
    "Choice",
    "Option",
    "Page",
    "Section",
    "code",
    "definitions",
    "headed",
    "items",
    "origin",
    "paragraph",
    "running",
    "table",
]
