"""Former place of names that stand in `ident.motion.state` now."""

from ident.motion.state import wrenches  # noqa: F401
