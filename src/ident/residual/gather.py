"""Old names of `ident.fit.residual`, until all callers have moved."""

from ident.fit.residual import residual_of, trace_of

__all__ = ["residual_of", "trace_of"]
