"""One look at a log, piece by piece: its clock, its top speeds, and whether it is a log at all."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ident.errors import LogError
from ident.log import Log
from ident.log.pieces import Pieces, open_log
from ident.log.sources import STRIDE
from ident.mechanism.mechanism import Mechanism
from ident.motion.clock import UNEVEN
from ident.motion.decided import Clock
from ident.motion.measure import is_signal

LOOK = 64 * STRIDE  # rows that are looked at together
STEPS = 1_000_000  # time steps from which their median is taken
NUMBER = re.compile(r"\d+")


@dataclass(frozen=True, eq=False)
class Survey:
    """What one look at a log has shown.

    Attributes:
        log: the log.
        clock: uniform, of its median step.
        starts: (k,) [s] times of its rows 0, STRIDE, 2 STRIDE, …
        top: largest speed in each `v.` column, by its name.
        values: of each signal, by its name, how many there are.
        repairs: what was changed, in words.
        stamp: size [bytes] and time of the last change [ns] of its file.
    """

    log: Pieces
    clock: Clock
    starts: np.ndarray
    top: dict[str, float]
    values: dict[str, int]
    repairs: tuple[str, ...]
    stamp: tuple[int, int]

    @property
    def name(self) -> str:
        """The log's."""
        return self.log.name

    @property
    def full(self) -> bool:
        """Whether no cell of a signal is empty, but for those of columns that are empty."""
        return all(count in (0, self.log.rows) for count in self.values.values())

    def at(self, row: int) -> float:
        """Time [s] of a row that is a multiple of STRIDE."""
        return float(self.starts[row // STRIDE])

    def borders(self, samples: int) -> list[int]:
        """Rows (k + 1,) at which portions of about so many samples begin, and the last one ends."""
        count = max(1, round(self.log.rows / samples))
        each = STRIDE * max(1, round(self.log.rows / count / STRIDE))
        first = list(range(0, max(self.log.rows - each // 2, 1), each))
        return [*first, self.log.rows]


def surveyed(mechanism: Mechanism, path: Path) -> Survey:
    """Looks at a log once.

    Args:
        mechanism: whose names of columns it has.
        path: of the log.

    Raises:
        LogError: where `read_log` would raise one.
    """
    log = open_log(path, mechanism.columns)
    signals = [name for name in log.columns if is_signal(name)]
    speeds = [name for name in signals if name.startswith("v.")]
    top, values = dict.fromkeys(speeds, 0.0), dict.fromkeys(signals, 0)
    starts: list[np.ndarray] = []
    steps: list[np.ndarray] = []
    bends: list[tuple[int, float, float]] = []
    said: dict[str, list[str]] = {}
    first, before, count, guess = 0.0, -np.inf, 0, 1.0
    for at, stop, piece in _pieces(log, ["t", *signals]):
        t = piece.t[1:] if piece.t[0] == before else piece.t  # a stamp repeated across the cut
        if not at:
            first, guess = float(t[0]), float(np.median(np.diff(t)))
        if t[0] < before:
            raise LogError(
                f"{log.path}: t goes backward at row {at}: {t[0]} after {before} (a clock reset, "
                "or two logs in one file?); split the file there"
            )
        step = np.diff(t, prepend=before if at else t[0] - guess)
        steps.append(step[:: -(-log.rows // STEPS)])
        bend = t - first - guess * np.arange(count, count + len(t))
        bends.append((count, float(bend.min()), float(bend.max())))
        bends.append((count + len(t) - 1, float(bend.min()), float(bend.max())))
        rows = np.arange(0, stop - at, STRIDE)  # without repeated stamps, which are left out
        starts.append(t[rows * len(t) // (stop - at)])
        count, before = count + len(t), float(t[-1])
        for name in signals:
            values[name] += int(np.isfinite(piece.columns[name]).sum())
        for name in speeds:
            top[name] = max(top[name], float(np.nanmax(np.abs(piece.columns[name]), initial=0.0)))
        for repair in piece.repairs:
            said.setdefault(NUMBER.sub("#", repair), []).append(repair)
    dt = float(np.median(np.concatenate(steps)))
    instants = round((before - first) / dt) + 1
    every = (before - first) / (instants - 1)
    off = max(max(high - i * (every - guess), i * (every - guess) - low) for i, low, high in bends)
    even = bool(instants == count and off < UNEVEN * dt)
    repairs = [
        each[0] + (f" (and so in {len(each) - 1} more pieces)" if len(each) > 1 else "")
        for each in said.values()
        if not each[0].endswith(" is empty")
    ]
    where = log.path.stat()
    return Survey(
        log, Clock(first, every, instants, even), np.concatenate(starts), top, values,
        tuple(repairs), (where.st_size, where.st_mtime_ns),
    )  # fmt: skip


def _pieces(log: Pieces, only: list[str]) -> Iterator[tuple[int, int, Log]]:
    """Each piece between two rows; what is left at the end goes with the last one."""
    ends = [*range(LOOK, log.rows - LOOK // 2, LOOK), log.rows]
    for first, stop in zip([0, *ends[:-1]], ends, strict=True):
        yield first, stop, log.piece(first, stop, only)
