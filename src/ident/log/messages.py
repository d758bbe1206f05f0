"""Messages of joint states and wrenches as columns and values, and the rows they are kept in."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from ident.log.cells import Array

PARTS = ("fx", "fy", "fz", "mx", "my", "mz")


class BadMessage(Exception):
    """A message that contradicts itself, and how; who knows its place makes a LogError of it."""


@dataclass(frozen=True)
class Message:
    """One message: when it was received, what its header says, and its values by column [SI]."""

    topic: str
    received: int  # [ns]
    stamp: int  # [ns]; 0: none
    columns: tuple[str, ...]
    values: Sequence[float]


@dataclass(eq=False)
class Rows:
    """Messages of one topic with the same columns, in the order in which they were recorded."""

    topic: str
    columns: tuple[str, ...]
    received: array[int] = field(default_factory=lambda: array("q"))
    stamps: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def table(self) -> Array:
        """(n_messages, n_columns)."""
        return np.array(self.values).reshape(len(self.stamps), len(self.columns))


def joint_columns(
    names: Sequence[str],
    position: Sequence[float],
    velocity: Sequence[float],
    effort: Sequence[float],
) -> tuple[tuple[str, ...], list[float]]:
    """Columns and values of a joint state; an empty array is one that is not measured.

    Raises:
        BadMessage: for arrays of different lengths, and for names that are empty or doubled.
    """
    given = {"q": position, "v": velocity, "tau": effort}
    filled = tuple(key for key, x in given.items() if len(x))
    for key in filled:
        if len(given[key]) != len(names):
            what = {"q": "positions", "v": "velocities", "tau": "efforts"}[key]
            raise BadMessage(
                f"{len(names)} names and {len(given[key])} {what}; every array has one value a "
                "name, or is empty"
            )
    return _columns(tuple(names), filled), [float(x) for key in filled for x in given[key]]


@lru_cache(maxsize=256)
def _columns(names: tuple[str, ...], filled: tuple[str, ...]) -> tuple[str, ...]:
    if "" in names or len(set(names)) < len(names):
        raise BadMessage(f"the names {', '.join(map(repr, names))}; each joint needs its own")
    return tuple(f"{key}.{name}" for key in filled for name in names)


def wrench_columns(frame: str) -> tuple[str, ...]:
    """Columns of a wrench by its header's frame.

    Raises:
        BadMessage: if the header names none.
    """
    if not frame.strip("/"):
        raise BadMessage("a wrench whose header names no frame_id, so in whose axes is not known")
    return tuple(f"wrench.{frame.strip('/')}.{part}" for part in PARTS)
