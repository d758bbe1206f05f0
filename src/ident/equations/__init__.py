"""From a mechanism and a motion to the rows of [Γ E | JᵀB]."""

from ident.equations.columns import Columns

__all__ = ["Columns"]
