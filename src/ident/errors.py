"""The project's own exceptions. A message is one line: what was given, where, what is valid."""

from __future__ import annotations

import contextlib
import difflib
import os
from collections.abc import Iterable
from pathlib import Path


class IdentError(Exception):
    """Anything wrong with what the user gave; the command line shows it as one `error:` line."""


class LogError(IdentError):
    """A log that cannot be read, or whose columns cannot be what they are said to be."""


class MechanismError(IdentError):
    """A URDF or mechanism.toml that does not describe a mechanism."""


class MotionError(IdentError):
    """A log that does not determine the motion of the mechanism, or contradicts its closures."""


class FitError(IdentError):
    """Equations that cannot be solved, or a fit.json that does not belong to the mechanism."""


def near(name: str, words: Iterable[str]) -> str:
    """The one of some words that `name` most likely was meant to be; empty if none is near.

    >>> near("viscus", ["viscous", "coulomb"])
    'viscous'
    """
    by_case = {word.casefold(): word for word in words}
    found = difflib.get_close_matches(name.casefold(), by_case, n=1)
    return by_case[found[0]] if found else ""


def one_of(name: str, valid: Iterable[str]) -> str:
    """What to say of an unknown `name`: the nearest valid word, then all of them.

    >>> one_of("viscus", ["viscous", "coulomb"])
    "did you mean 'viscous'? valid: coulomb, viscous"
    """
    words = sorted(set(valid))
    meant = near(name, words)
    shown = ", ".join(words[:12]) + (f", … ({len(words)} in all)" if len(words) > 12 else "")
    return (f"did you mean '{meant}'? " if meant else "") + f"valid: {shown or 'none'}"


def not_there(path: Path) -> str:
    """What to say of a path that leads nowhere: what is wrong with it, and what is near it.

    Walks down to the first part that is not there and looks beside it.
    """
    there = path
    while not there.parent.is_dir() and there != there.parent:
        there = there.parent
    with contextlib.suppress(OSError):  # of a folder that may not be looked into
        meant = "" if there.exists() else near(there.name, os.listdir(there.parent))
        if meant:
            return f"no such file (did you mean '{there.parent / meant}'?)"
    return "no such file"
