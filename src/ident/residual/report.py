"""Old names of `ident.show.residual`, until all callers have moved."""

from ident.show.residual import by_log, errors, maps, parts, torques

__all__ = ["by_log", "errors", "maps", "parts", "torques"]
