"""Former place of names, see `ident.description`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ident.mechanism.description import read_urdf as read_urdf
    from ident.mechanism.description import urdf_bytes as urdf_bytes
    from ident.mechanism.urdf import numbers as numbers
    from ident.mechanism.urdf import parse_urdf as parse_urdf
else:
    from ident.description import moved as __getattr__  # noqa: F401
