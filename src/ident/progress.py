"""Progress of long work, and the command that runs it."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass

Progress = Callable[[str, float], None]
"""Called with the name of the present step and the share of it that is done, 0 to 1."""

running: ContextVar[str] = ContextVar("running", default="")
"""The command line, for reports; empty where there is none."""

folder: ContextVar[str] = ContextVar("folder", default="")
"""Where its files are written; empty where they are not."""


@dataclass(frozen=True)
class Inputs:
    """What a command line is given: the mechanism, logs, and options of the model as words."""

    mechanism: str
    logs: tuple[str, ...]
    options: tuple[str, ...]


inputs: ContextVar[Inputs | None] = ContextVar("inputs", default=None)
"""Those of the running command; None where there is none, or they do not describe its model."""


def quiet(what: str, share: float) -> None:
    """Show nothing."""


def part(on_progress: Progress | None, start: float, end: float) -> Progress:
    """Report the progress of one part of the work as that of the whole, between two shares."""
    if on_progress is None:
        return quiet
    return lambda what, share: on_progress(what, start + share * (end - start))
