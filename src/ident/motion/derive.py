"""Former place of names that stand in `ident.motion.smoothing` now."""

from ident.motion.smoothing import AS_LOGGED, AUTO, derive  # noqa: F401
