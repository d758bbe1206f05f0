"""Former place of names that stand in `ident.motion.signals` now."""

from ident.motion.signals import GAP, SHORTEST, UNEVEN, at_own_rate, holes, runs, uniform_clock  # noqa: F401
