"""Old name of `ident.information.reduction`."""

from ident.information.reduction import Chunk

__all__ = ["Chunk"]
