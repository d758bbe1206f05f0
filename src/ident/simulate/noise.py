"""White noise on the columns of a simulated log."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.errors import MotionError, one_of

CHANNELS = ("q", "v", "a", "tau")


@dataclass(frozen=True)
class Noise:
    """White noise on the columns that a pattern names.

    Attributes:
        channel: `q`, `v`, `a`, `tau`, or a column's name (`tau.elbow`, wildcards allowed).
        level: standard deviation in the column's unit, or its share of the column's own.
        relative: whether `level` is a share.
    """

    channel: str
    level: float
    relative: bool = False

    def matches(self, column: str) -> bool:
        """Whether a column gets this noise."""
        pattern = f"{self.channel}.*" if self.channel in CHANNELS else self.channel
        return fnmatch.fnmatchcase(column, pattern)


def noisy(
    columns: Mapping[str, np.ndarray], noise: Sequence[Noise], random: np.random.Generator
) -> dict[str, np.ndarray]:
    """Columns (n,) by name with their noise.

    Raises:
        MotionError: for noise on no column.
    """
    for each in noise:
        if not any(each.matches(name) for name in columns):
            valid = {name.partition(".")[0] for name in columns} | set(columns)
            raise MotionError(f"noise: no column '{each.channel}'; {one_of(each.channel, valid)}")
    found = {}
    for name, x in columns.items():
        for each in noise:
            if each.matches(name):
                sigma = each.level * (float(np.std(x)) if each.relative else 1.0)
                x = x + sigma * random.standard_normal(len(x))
        found[name] = x
    return found


def check_channels(columns: Sequence[str]) -> None:
    """Refuse a channel that logs do not have.

    Raises:
        MotionError: naming it and the valid ones.
    """
    for column in columns:
        if column not in CHANNELS:
            raise MotionError(f"columns: '{column}'; {one_of(column, CHANNELS)}")
