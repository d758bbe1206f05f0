"""Old names of `ident.fit.files`, until all callers have moved."""

from ident.fit.files import multipliers_csv, multipliers_rows, write_fit

__all__ = ["multipliers_csv", "multipliers_rows", "write_fit"]
