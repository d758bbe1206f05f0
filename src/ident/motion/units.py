"""Former place of names that stand in `ident.motion.signals` now."""

from ident.motion.signals import check_units  # noqa: F401
