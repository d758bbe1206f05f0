"""Old names of `ident.fit.consistency`, until all callers have moved."""

from ident.fit.consistency import nearest_possible as constrained

__all__ = ["constrained"]
