"""Former place of names that stand in `ident.motion.signals` now."""

from ident.motion.recipe import CLEAN, ROWS_OVER_MOTION  # noqa: F401
from ident.motion.signals import acceleration_size, motion_bandwidth, noise_level, noise_share  # noqa: F401
