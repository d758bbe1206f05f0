"""Old names of `ident.fit.residual`, until all callers have moved."""

from ident.fit.residual import Model

__all__ = ["Model"]
