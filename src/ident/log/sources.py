"""Former place of a name that is in `ident.log.pieces` now."""

from ident.log.pieces import STRIDE

__all__ = ["STRIDE"]
