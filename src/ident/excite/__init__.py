"""Exciting motions: periodic, inside all limits, optimal for the unknown parameters."""

from ident.excite.excitation import Excitation, Separation
from ident.excite.limits import Limits
from ident.excite.poses import PosePlan, excite_poses
from ident.excite.search import excite

__all__ = ["Excitation", "Limits", "PosePlan", "Separation", "excite", "excite_poses"]
