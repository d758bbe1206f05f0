"""The project's own exceptions. A message is one line: what was given, where, what is valid."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


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


def one_of(name: str, valid: Iterable[str]) -> str:
    """What to say of an unknown `name`: the nearest valid word, then all of them.

    >>> one_of("viscus", ["viscous", "coulomb"])
    "did you mean 'viscous'? valid: coulomb, viscous"
    """
    words = sorted(set(valid))
    by_case = {word.casefold(): word for word in words}
    near = difflib.get_close_matches(name.casefold(), by_case, n=1)
    shown = ", ".join(words[:12]) + (f", … ({len(words)} in all)" if len(words) > 12 else "")
    return (f"did you mean '{by_case[near[0]]}'? " if near else "") + f"valid: {shown or 'none'}"
