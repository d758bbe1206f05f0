"""Former place of names that stand in `ident.motion.closures` now."""

from ident.motion.closures import check_freedom  # noqa: F401
