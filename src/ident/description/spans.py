"""Former place of names, see `ident.description`."""

from typing import TYPE_CHECKING

__all__ = [
    "Change",
    "Span",
    "ascii_bytes",
    "changed",
    "first_child",
    "removal",
    "set_attributes",
    "spans_of",
]

if TYPE_CHECKING:
    from ident.mechanism.urdf import Change as Change
    from ident.mechanism.urdf import Span as Span
    from ident.mechanism.urdf import ascii_bytes as ascii_bytes
    from ident.mechanism.urdf import changed as changed
    from ident.mechanism.urdf import first_child as first_child
    from ident.mechanism.urdf import removal as removal
    from ident.mechanism.urdf import set_attributes as set_attributes
    from ident.mechanism.urdf import spans_of as spans_of
else:
    from ident.description import moved as __getattr__  # noqa: F401
