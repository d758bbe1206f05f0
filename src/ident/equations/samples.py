"""Former place of names that stand in `ident.equations.terms` now."""

from ident.equations.terms import STEP, Samples, reduced  # noqa: F401
