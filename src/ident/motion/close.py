"""Former place of names that stand in `ident.motion.closures` now."""

from ident.motion.closures import LoopSolver, integrate, pseudo_inverse

Closer = LoopSolver

__all__ = ["Closer", "integrate", "pseudo_inverse"]
