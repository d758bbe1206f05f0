"""Progress of long work, and the command that runs it."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar

Progress = Callable[[str, float], None]
"""Called with the name of the present step and the share of it that is done, 0 to 1."""

running: ContextVar[str] = ContextVar("running", default="")
"""The command line, for reports; empty where there is none."""
