"""Former place of names, see `ident.description`."""

from typing import TYPE_CHECKING

__all__ = ["align_z", "perpendicular"]

if TYPE_CHECKING:
    from ident.mechanism.description import align_z as align_z
    from ident.mechanism.description import perpendicular as perpendicular
else:
    from ident.description import moved as __getattr__  # noqa: F401
