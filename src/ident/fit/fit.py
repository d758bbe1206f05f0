"""Old names of `ident.fit.result`, until all callers have moved."""

from ident.fit.result import Fit

__all__ = ["Fit"]
