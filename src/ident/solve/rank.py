"""Old names of `ident.information.base`."""

from ident.information.base import Base, Solution, solve
from ident.information.base import rank_revealing as reveal

__all__ = ["Base", "Solution", "reveal", "solve"]
