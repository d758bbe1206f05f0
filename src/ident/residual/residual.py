"""Old names of `ident.fit.residual`, until all callers have moved."""

from ident.fit.residual import CLOSURES, DRIVES, RIGID, WRENCHES, Residual, Trace, zero_of

__all__ = ["CLOSURES", "DRIVES", "RIGID", "WRENCHES", "Residual", "Trace", "zero_of"]
