"""Former place of names that stand in `ident.equations.unknowns` now."""

from ident.equations.unknowns import Columns  # noqa: F401
