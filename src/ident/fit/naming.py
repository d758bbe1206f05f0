"""Old names of `ident.fit.values`, until all callers have moved."""

from ident.fit.values import absorbed_by, base_names

__all__ = ["absorbed_by", "base_names"]
