"""Progress of long work, and the command that runs it."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar

Progress = Callable[[str, float], None]
"""Called with the name of the present step and the share of it that is done, 0 to 1."""

running: ContextVar[str] = ContextVar("running", default="")
"""The command line, for reports; empty where there is none."""

inputs: ContextVar[tuple[str, str, str]] = ContextVar("inputs", default=("", "LOG.csv", ""))
"""Its mechanism, logs and options of the model, for the command that goes on from it."""

folder: ContextVar[str] = ContextVar("folder", default="DIR")
"""Where its files are written."""


def quiet(what: str, share: float) -> None:
    """Show nothing."""


def part(on_progress: Progress | None, start: float, end: float) -> Progress:
    """Report the progress of one part of the work as that of the whole, between two shares."""
    if on_progress is None:
        return quiet
    return lambda what, share: on_progress(what, start + share * (end - start))
