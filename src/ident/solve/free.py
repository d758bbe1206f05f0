"""Old name of `ident.information.band`."""

from ident.information.band import Freed

__all__ = ["Freed"]
