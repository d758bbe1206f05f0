"""Former place of names that stand in `ident.motion.smoothing` now."""

from ident.motion.smoothing import finest, resolution  # noqa: F401
