"""Old names of `its successors`, until all callers have moved."""

from ident.information.blocks import Error, Squares
from ident.show.residual import error_rows

__all__ = ["Error", "Squares", "error_rows"]
