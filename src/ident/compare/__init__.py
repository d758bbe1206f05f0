"""Several models on one motion."""

from ident.compare.compare import Comparison, compare

__all__ = ["Comparison", "compare"]
