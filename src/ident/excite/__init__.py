"""Exciting motions: periodic, inside all limits, optimal for the unknown parameters."""

from ident.excite.design import excite
from ident.excite.excitation import Excitation, Separation
from ident.excite.trajectory import Limits

__all__ = ["Excitation", "Limits", "Separation", "excite"]
