"""The library of physical effects: one class a kind, one file a family; see `effect`."""

from ident.effects.effect import (
    PER_LOG,
    Correcting,
    Correction,
    Effect,
    Signals,
    Sites,
    Unknown,
    log_word,
)
from ident.effects.frame import FrameForce, FramePath
from ident.effects.joint import ReversalPulses
from ident.effects.library import (
    KINDS,
    create,
    kind_of,
    parse,
    parse_user,
    read_user_effect,
    user_effect,
)

__all__ = [
    "KINDS",
    "PER_LOG",
    "Correcting",
    "Correction",
    "Effect",
    "FrameForce",
    "FramePath",
    "ReversalPulses",
    "Signals",
    "Sites",
    "Unknown",
    "create",
    "kind_of",
    "log_word",
    "parse",
    "parse_user",
    "read_user_effect",
    "user_effect",
]
