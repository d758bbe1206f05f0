"""Former place of names, see `ident.description`."""

from typing import TYPE_CHECKING

__all__ = ["numbers", "parse_urdf", "read_urdf", "urdf_bytes"]

if TYPE_CHECKING:
    from ident.mechanism.description import description_of, read_description
    from ident.mechanism.description import read_urdf as read_urdf
    from ident.mechanism.description import urdf_bytes as urdf_bytes
    from ident.mechanism.urdf import numbers as numbers
    from ident.mechanism.urdf import parse_urdf as parse_urdf

    source_of, read_source = description_of, read_description
else:
    from ident.description import moved as __getattr__  # noqa: F401
