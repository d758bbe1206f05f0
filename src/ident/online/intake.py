"""A sample as it comes, checked, under ident's names and in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ident.errors import LogError, MotionError, one_of
from ident.log import Column, Log
from ident.motion.measure import LARGEST

Sample = Mapping[str, Any] | Log
"""One sample, or a block of them, by column: numbers, or arrays (n,)."""


class Intake:
    """Takes the columns that are needed out of samples.

    Args:
        name: of the mechanism, for messages.
        columns: names that are needed beside `t`.
        mapping: this robot's own names, scales and offsets: [log] of mechanism.toml.

    Attributes:
        columns: of the arrays that it makes.
        last: time of the last sample [s].
    """

    def __init__(
        self, name: str, columns: tuple[str, ...], mapping: Mapping[str, Column] | None = None
    ) -> None:
        self.columns = ("t", *columns)
        self._name = name
        self._mapping = dict(mapping or {})
        self.last = -np.inf

    def __call__(self, sample: Sample) -> np.ndarray:
        """(n, 1 + columns) of a sample or a block, `t` first.

        Raises:
            MotionError: for a column that is missing.
            LogError: for a number that is none, and times that do not increase; nothing of the
                sample is taken then.
        """
        X = self._of_log(sample) if isinstance(sample, Log) else self._of_mapping(sample)
        if not (np.abs(X) < LARGEST).all():
            row, at = np.argwhere(~(np.abs(X) < LARGEST))[0]
            raise LogError(
                f"{self._name}: {self.columns[at]} = {X[row, at]:.4g} in the sample at t = "
                f"{X[row, 0]:.6g} s; every column needs a finite number in every sample"
            )
        t = X[:, 0]
        if t[0] <= self.last or (len(t) > 1 and not (np.diff(t) > 0).all()):
            before, here = _not_later(np.append(self.last, t))
            raise LogError(
                f"{self._name}: a sample at t = {here:.6g} s comes after one at {before:.6g} s; "
                "times must increase"
            )
        self.last = float(t[-1])
        return X

    def _of_mapping(self, sample: Mapping[str, Any]) -> np.ndarray:
        values = [self._value(sample, name) for name in self.columns]
        try:
            X = np.array(values, dtype=float)
        except (TypeError, ValueError):
            raise LogError(
                f"{self._name}: a sample is neither numbers nor arrays of equal length; give one "
                "number a column, or one array (n,) a column"
            ) from None
        return X.reshape(len(values), -1).T

    def _value(self, sample: Mapping[str, Any], name: str) -> Any:
        source = self._mapping.get(name)
        if source is not None and source.column in sample:
            value = sample[source.column]
            return source.scale * (value if np.ndim(value) == 0 else np.asarray(value)) + (
                source.offset
            )
        if name in sample:
            return sample[name]
        wanted = f"{source.column!r}, which [log] makes {name!r}" if source else repr(name)
        raise MotionError(f"{self._name}: a sample has no column {wanted}; {one_of(name, sample)}")

    def _of_log(self, log: Log) -> np.ndarray:
        """A log has ident's names already, unless it was read without this robot's own."""
        given = {"t": log.t, **log.columns}
        found = [
            given[name] if name in given else self._value(given, name) for name in self.columns
        ]
        return np.stack(found, axis=1)


def _not_later(t: np.ndarray) -> tuple[float, float]:
    """The first two neighbours of which the second is not later."""
    at = int(np.argmax(~(np.diff(t) > 0)))
    return float(t[at]), float(t[at + 1])
