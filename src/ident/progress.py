"""How long work tells what it is at; the command line draws it, a library user may ignore it."""

from __future__ import annotations

from collections.abc import Callable

Told = Callable[[str, float], None]
"""Called with what is being done and the share of it that is done, 0 to 1."""
