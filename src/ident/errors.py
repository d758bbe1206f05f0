"""Exceptions of the project. A message is one line: what was given, where, what is valid."""

from __future__ import annotations

import contextlib
import difflib
import os
import re
from collections.abc import Iterable
from numbers import Integral
from pathlib import Path


class IdentError(Exception):
    """Anything wrong with what the user gave; the command line shows it as one `error:` line."""


class LogError(IdentError):
    """A log that cannot be read, or whose columns are not what they should be."""


class MechanismError(IdentError):
    """A URDF or mechanism.toml that does not describe a mechanism."""


class MotionError(IdentError):
    """A log that does not determine the motion of the mechanism, or contradicts its closures."""


class FitError(IdentError):
    """Equations that cannot be solved, or a fit.json that does not belong to the mechanism."""


def line_of(error: BaseException) -> str:
    """Return an exception as one line; with its type, where it is not one of ident's own."""
    message = " ".join(str(error).split())
    if isinstance(error, IdentError):
        return message
    return f"{type(error).__name__}: {message}" if message else type(error).__name__


def near(name: str, words: Iterable[str]) -> str:
    """Return the word that `name` most likely was meant to be; empty if none is near.

    >>> near("viscus", ["viscous", "coulomb"])
    'viscous'

    A name with another number is that of another joint:

    >>> near("pos7", ["position4", "position7"])
    'position7'
    >>> near("j7", ["joint_4", "joint_7"])
    'joint_7'
    """
    key, number = name.casefold(), re.findall(r"\d+", name)
    candidates = (word for word in words if not number or re.findall(r"\d+", word) in (number, []))
    by_case = {word.casefold(): word for word in candidates}
    matches = difflib.get_close_matches(key, by_case, n=1)
    if number and not matches:  # of one number, a word and the beginning of it
        start = key.removesuffix(number[-1])
        matches = [w for w in by_case if w.startswith(start) and w.endswith(number[-1])]
    return by_case[matches[0]] if matches else ""


def one_of(name: str, valid: Iterable[str], last: Iterable[str] = ()) -> str:
    """Return the part of a message about an unknown `name`: the nearest valid word, then all.

    Words of `last` are listed behind the others, and none of them is proposed.

    >>> one_of("viscus", ["viscous", "coulomb"])
    "did you mean 'viscous'? valid: coulomb, viscous"
    """
    words = sorted(set(valid))
    meant = near(name, words)
    words += sorted({*last} - {*words})
    more = f", … ({len(words)} in all)" if len(words) > 12 else ""
    listed = f"valid: {', '.join(words[:12]) or 'none'}{more}"
    return f"did you mean '{meant}'? {listed}" if meant else listed


def check_whole(name: str, number: object, least: int = 0) -> None:
    """Refuse what is no whole number from `least` on; bool is none."""
    if isinstance(number, bool) or not isinstance(number, Integral) or int(number) < least:
        raise IdentError(f"{name} {number!r}; valid: a whole number, {least} or more")


def missing_file(path: Path) -> str:
    """Return the part of a message about a missing file: the name that is near it, if any.

    The path is walked down to its first part that does not exist, and the folder above searched.
    """
    if os.path.lexists(path) and not path.is_dir():
        return "no file, but a pipe, a device or a link that leads nowhere"
    missing = path
    while not missing.parent.is_dir() and missing != missing.parent:
        missing = missing.parent
    with contextlib.suppress(OSError):  # of a folder that may not be listed
        meant = "" if missing.exists() else near(missing.name, os.listdir(missing.parent))
        if meant:
            return f"no such file (did you mean '{missing.parent / meant}'?)"
    return "no such file"
