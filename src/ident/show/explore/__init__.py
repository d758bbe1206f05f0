"""Effects added and removed by hand, on a page, while the held-out error falls."""

from ident.show.explore.board import Board, explore
from ident.show.explore.exploration import Exploration

__all__ = ["Board", "Exploration", "explore"]
