"""Former place of names that stand in `ident.motion.recipe` now."""

from ident.motion.recipe import STILL, noise_of_speeds, standstill, thresholds, top_speeds  # noqa: F401
