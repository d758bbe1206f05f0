"""Former name of `ident.text`, until no module asks for it."""

from ident.text import percent, rounded, shortened, table

__all__ = ["percent", "rounded", "shortened", "table"]
