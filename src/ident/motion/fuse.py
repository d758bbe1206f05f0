"""Former place of names that stand in `ident.motion.smoothing` now."""

from ident.motion.smoothing import along, finer, fused, missed, reweighted, through_motion  # noqa: F401
