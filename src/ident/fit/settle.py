"""Old names of `ident.fit.shapes`, until all callers have moved."""

from ident.fit.shapes import initial, working_point

__all__ = ["initial", "settled"]


def settled(mechanism, motion, start=None, progress=None):  # type: ignore[no-untyped-def]
    """Return the working point."""
    return working_point(mechanism, motion, start, progress)
