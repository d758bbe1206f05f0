"""Former place of names that stand in `ident.motion.signals` now."""

from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import signals
from ident.motion.recipe import Recipe
from ident.motion.signals import LARGEST, PREFIXES, Clock, LogSignals, is_signal

__all__ = ["LARGEST", "PREFIXES", "LogSignals", "is_signal", "measure"]


def measure(mechanism: Mechanism, log: Log, decided: Recipe | Clock | None = None) -> LogSignals:
    """`ident.motion.signals.measure`, which takes the clock alone."""
    clock = decided.clock if isinstance(decided, Recipe) else decided
    return signals.measure(mechanism, log, clock)
