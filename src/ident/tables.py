"""Former name of `ident.text`."""

from ident.text import percent, rounded, shortened, table

__all__ = ["percent", "rounded", "shortened", "table"]
