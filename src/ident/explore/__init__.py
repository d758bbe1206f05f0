"""Watching the error fall by hand: effects added and removed one by one, on a page."""

from ident.explore.exploration import Exploration
from ident.explore.explore import explore
from ident.explore.rung import Rung

__all__ = ["Exploration", "Rung", "explore"]
