"""One call, wherever it is made: what it needs, packed; what it ended in, as one line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cloudpickle

from ident.errors import IdentError

TRIES = 3  # of a task whose process dies


@dataclass(frozen=True)
class Done:
    """How a task ended.

    Attributes:
        index: number of the task, from 0, in the order given.
        value: what the function returned; None where it failed.
        error: one line; None where it did not fail.
    """

    index: int
    value: Any = None
    error: str | None = None


def packed(common: Any) -> bytes:
    """`common`, once for all processes.

    Raises:
        IdentError: if it cannot be sent.
    """
    try:
        return cloudpickle.dumps(common)
    except Exception as error:
        raise IdentError(
            f"what all tasks share cannot be sent to other processes ({line_of(error)}); use this "
            "process alone: jobs=1"
        ) from None


def tried(function: Callable[[Any, Any], Any], common: Any, task: Any) -> tuple[Any, str | None]:
    """What the function returns, or the line of its exception."""
    try:
        return function(common, task), None
    except Exception as error:
        return None, line_of(error)


def line_of(error: BaseException) -> str:
    """An exception as one line; with its type, where it is not one of ident's own."""
    said = " ".join(str(error).split())
    if isinstance(error, IdentError):
        return said
    return f"{type(error).__name__}: {said}" if said else type(error).__name__
