"""Former place of names that stand in `ident.motion.closures` now."""

from ident.motion.closures import best_conditioned, independent_joints  # noqa: F401
