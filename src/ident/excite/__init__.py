"""Motions that tell most: periodic, inside all limits, optimal for what is unknown."""

from ident.excite.criterion import Separation
from ident.excite.excitation import Excitation
from ident.excite.excite import excite
from ident.excite.limits import Limits
from ident.excite.outcome import separation

__all__ = ["Excitation", "Limits", "Separation", "excite", "separation"]
