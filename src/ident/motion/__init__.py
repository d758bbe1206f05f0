"""The motion of the whole mechanism, completed from a log."""

from ident.motion.motion import Motion, complete
from ident.motion.recipe import Band, Recipe
from ident.motion.state import State

__all__ = ["Band", "Motion", "Recipe", "State", "complete"]
