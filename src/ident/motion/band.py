"""Former place of names that stand in `ident.motion.recipe` now."""

from ident.motion.recipe import band_of  # noqa: F401
