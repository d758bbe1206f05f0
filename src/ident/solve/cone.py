"""Old names of `ident.information.cone`."""

from ident.information.cone import Limit, Point, conflict, nearest, shortfall, smat, svec

__all__ = ["Limit", "Point", "conflict", "nearest", "shortfall", "smat", "svec"]
