"""The motion of the whole mechanism, completed from a log."""

from ident.motion.complete import complete
from ident.motion.motion import Band, Experiment, Motion

__all__ = ["Band", "Experiment", "Motion", "complete"]
