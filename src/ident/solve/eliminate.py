"""Old names of `ident.information.band`."""

from ident.information.band import Elimination, eliminate

__all__ = ["Elimination", "eliminate"]
