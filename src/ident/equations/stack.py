"""Former place of names that stand in `ident.equations.multipliers` now."""

from ident.equations.multipliers import basis_of, full_rows, stack  # noqa: F401
