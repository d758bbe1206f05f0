"""Old names of `ident.show.fit`, until all callers have moved."""

from ident.show.fit import channels, describe, excitation, structure

__all__ = ["channels", "describe", "excitation", "structure"]
