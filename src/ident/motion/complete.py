"""Former place of names that stand in `ident.motion.motion` now."""

from ident.motion.motion import complete  # noqa: F401
