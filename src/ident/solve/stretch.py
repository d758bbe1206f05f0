"""Old names of `ident.information.band`."""

from ident.information.band import Part, Stretch

__all__ = ["Part", "Stretch"]
