"""Former place of a name that is in `ident.log.table` now."""

from ident.log.table import is_frame

__all__ = ["is_frame"]
