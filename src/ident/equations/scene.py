"""Former place of names that stand in `ident.equations.corrections` now."""

from ident.equations.corrections import Beside, Scene, check_needs, step_of  # noqa: F401
