"""Every effect of the library at every place where it could sit and is not yet."""

from __future__ import annotations

from ident.effects import Effect
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion


def candidates(mechanism: Mechanism, motion: Motion) -> list[Effect]:
    """All effects that could be missing, in the library's order; then known ones, which could have
    changed.
    """
    first, *others = (e.logged for e in motion.experiments)
    logged = [name for name in first if all(name in names for names in others)]
    columns = set.intersection(*(set(e.extra) for e in motion.experiments))
    found = mechanism.candidates(logged, columns)
    return found + [effect.freed for effect in mechanism.effects if effect.known]
