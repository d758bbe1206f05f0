"""Old names of `ident.show.fit`, until all callers have moved."""

from ident.show.fit import summary

__all__ = ["summary"]
