"""Former place of names, see `ident.description`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ident.mechanism.description import Description

    Source = Description
else:
    from ident.description import moved as __getattr__  # noqa: F401
