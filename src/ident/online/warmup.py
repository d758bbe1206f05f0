"""The first seconds of a stream: kept, looked at as a whole log, then used like all others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ident.errors import LogError, MotionError, one_of
from ident.log import Column, Log
from ident.motion.measure import LARGEST, PREFIXES
from ident.online.intake import Sample

MOST = 100_000  # samples that are kept at most


class Warmup:
    """Keeps samples under ident's names until they last long enough.

    Args:
        name: of the mechanism, for messages.
        mapping: this robot's own names, scales and offsets: [log] of mechanism.toml.
        reads: columns that effects need; others, but for signals, may be empty.
        seconds: how long it lasts [s].
    """

    def __init__(
        self, name: str, mapping: Mapping[str, Column], reads: Sequence[str], seconds: float
    ) -> None:
        self._name, self._reads, self._seconds = name, reads, seconds
        self._sources = {source.column for source in mapping.values()}
        self._mapping = dict(mapping)
        self._blocks: list[dict[str, np.ndarray]] = []
        self._count = 0

    def keep(self, sample: Sample) -> bool:
        """Takes a sample or a block; whether that is enough.

        Raises:
            LogError: for a sample that has other columns than those before, or is not later.
        """
        named = self._named(sample)
        if self._blocks:
            if named.keys() != self._blocks[0].keys():
                off = ", ".join(sorted(named.keys() ^ self._blocks[0].keys()))
                raise LogError(
                    f"{self._name}: a sample has other columns than those before ({off}); every "
                    "sample needs the same"
                )
            before, here = self._blocks[-1]["t"][-1], named["t"][0]
            if not here > before:
                raise LogError(
                    f"{self._name}: a sample at t = {here:.6g} s comes after one at {before:.6g} "
                    "s; times must increase"
                )
        bad = next((n for n, x in named.items() if self._needs(n) and not whole(x)), None)
        if bad is not None:
            raise LogError(
                f"{self._name}: {bad} is no number in the sample at t = {named['t'][0]:.6g} s; "
                "every column needs a finite number in every sample"
            )
        self._blocks.append(named)
        self._count += len(named["t"])
        lasted = float(named["t"][-1] - self._blocks[0]["t"][0])
        return lasted >= self._seconds or self._count >= MOST

    def log(self) -> Log:
        """All that was kept."""
        names = self._blocks[0] if self._blocks else ()
        columns = {n: np.concatenate([block[n] for block in self._blocks]) for n in names}
        return Log.from_arrays(self._name, columns.pop("t", np.empty(0)), columns)

    def __len__(self) -> int:
        return self._count

    @property
    def t(self) -> float:
        """Of the last sample [s]; NaN where there is none."""
        return float(self._blocks[-1]["t"][-1]) if self._blocks else float("nan")

    def _needs(self, name: str) -> bool:
        return name == "t" or name in self._reads or name.partition(".")[0] in PREFIXES

    def _named(self, sample: Sample) -> dict[str, np.ndarray]:
        if isinstance(sample, Log):
            return {"t": sample.t, **sample.columns}
        found = {name: x for name, x in sample.items() if name not in self._sources}
        for name, source in self._mapping.items():
            if source.column in sample:
                found[name] = source.scale * _array(sample[source.column]) + source.offset
        if "t" not in found:
            raise MotionError(f"{self._name}: a sample has no column 't'; {one_of('t', found)}")
        return {name: _array(x) for name, x in found.items()}


def whole(x: np.ndarray) -> bool:
    """Whether all of x (n,) are measurements."""
    return bool((np.abs(x) < LARGEST).all())


def _array(x: Any) -> np.ndarray:
    return np.atleast_1d(np.asarray(x, dtype=float))
