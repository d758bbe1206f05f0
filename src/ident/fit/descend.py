"""Old names of `ident.fit.shapes`, until all callers have moved."""

from ident.fit.shapes import shape_bounds, stepped

__all__ = ["shape_bounds", "stepped"]
