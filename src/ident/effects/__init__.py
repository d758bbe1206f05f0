"""The library of physical effects: one class a kind, one small file a family."""

from ident.effects.base import Correcting, Correction, Effect, Unknown
from ident.effects.library import KINDS, create, parse
from ident.effects.signals import Signals
from ident.effects.user import UserEffect
from ident.effects.user_file import parse_user, read_user_effect
from ident.effects.user_kind import user_effect

__all__ = [
    "KINDS",
    "Correcting",
    "Correction",
    "Effect",
    "Signals",
    "Unknown",
    "UserEffect",
    "create",
    "parse",
    "parse_user",
    "read_user_effect",
    "user_effect",
]
