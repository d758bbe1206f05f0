"""Old names of `ident.show.fit`, until all callers have moved."""

from ident.show.fit import plot_multipliers

__all__ = ["plot_multipliers"]
