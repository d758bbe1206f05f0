"""Old names of `ident.fit.problem`, until all callers have moved."""

from ident.fit.problem import body_scales, plausible

__all__ = ["body_scales", "plausible"]
