"""Former place of names that stand in `ident.show.motion` now."""

from ident.show.motion import made_of, understood  # noqa: F401
