"""Former place of names that stand in `ident.motion.recipe` now."""

from ident.motion.recipe import Recipe
from ident.motion.signals import Clock

Decided = Recipe

__all__ = ["Clock", "Decided"]
