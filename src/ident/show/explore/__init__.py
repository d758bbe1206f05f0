"""Effects added and removed by hand, on a page, while the held-out error falls."""

from ident.show.explore.exploration import Exploration, ModelStep
from ident.show.explore.serve import check_panel, explore, serve

__all__ = ["Exploration", "ModelStep", "check_panel", "explore", "serve"]
