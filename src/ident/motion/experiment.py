"""Former place of names that stand in `ident.motion.motion` now."""

from ident.motion.motion import state_of

experiment_of = state_of

__all__ = ["experiment_of"]
