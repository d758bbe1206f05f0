"""The library of physical effects: one class a kind, one small file a family."""

from ident.effects.base import Effect, Signals, Unknown
from ident.effects.library import KINDS, create, parse

__all__ = ["KINDS", "Effect", "Signals", "Unknown", "create", "parse"]
