"""Former place of names that stand in `ident.equations.corrections` now."""

from ident.equations.corrections import WIDER, Corrected, corrected, late

Seen = Corrected

__all__ = ["WIDER", "Seen", "corrected", "late"]
