"""Old names of `ident.fit.likelihood`, until all callers have moved."""

from ident.fit.likelihood import MATTERS, share_of_motion

__all__ = ["MATTERS", "share_of_motion"]
