"""Old names of `ident.fit.multipliers`, until all callers have moved."""

from ident.fit.multipliers import identifiable_multipliers

__all__ = ["identifiable_multipliers"]
