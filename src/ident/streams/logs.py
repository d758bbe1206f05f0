"""Logs on disk: a summary of each from one look at all rows, and stretches that stand for it."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ident.errors import IdentError, LogError, line_of
from ident.log import Log
from ident.log.pieces import STRIDE, Pieces, open_log
from ident.log.read import expanded
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, complete
from ident.motion.recipe import Recipe
from ident.motion.signals import NO_MEASUREMENT, UNEVEN, Clock, absurd_samples, is_signal

LOOK = 64 * STRIDE  # work: rows that are read together
STEPS = 1_000_000  # work: time steps from which their median is taken
STRETCHES, LONGEST = 3, 16_384  # work: of one log for pictures and decisions, and samples of each
SAMPLES = STRETCHES * LONGEST  # of all logs together in an excerpt
LOGS = 12  # work: from which stretches are taken
NUMBER = re.compile(r"\d+")
Given = str | os.PathLike[str]


@dataclass(frozen=True, eq=False)
class LogOnDisk:
    """A log on disk after one look at all of its rows, and what is decided for its portions."""

    file: Pieces  # the opened log
    clock: Clock  # uniform, of the median step
    starts: np.ndarray  # (k,) [s] times of the rows 0, STRIDE, 2 STRIDE, …
    values: dict[str, int]  # number of values of each signal, by name
    repairs: tuple[str, ...]  # what was changed, in words
    digest: str  # of all values of its signals
    borders: tuple[int, ...] = ()  # rows (k + 1,) between its k portions
    recipe: Recipe | None = None  # None: a log of one portion, which decides by itself
    anchors: np.ndarray | None = None  # (k, nq) near portions' beginnings; None for a tree

    @property
    def name(self) -> str:
        """Name of the log."""
        return self.file.name

    def at(self, row: int) -> float:
        """Return the time [s] of a row that is a multiple of STRIDE."""
        return float(self.starts[row // STRIDE])

    def cut(self, samples: int) -> LogOnDisk:
        """Return the log with borders between portions of about so many samples."""
        rows = self.file.rows
        length = STRIDE * max(1, round(rows / max(1, round(rows / samples)) / STRIDE))
        return replace(self, borders=(*range(0, max(rows - length // 2, 1), length), rows))

    def stretches(self, samples: int = SAMPLES) -> list[Log]:
        """Return the middles of the thirds of a log (at its ends a machine rests); all if short."""
        rows = self.file.rows
        if rows <= 1.5 * samples:
            return [replace(self.file.piece(0, rows), name=self.name)]
        length = samples // STRETCHES
        middles = [rows * (2 * k + 1) // (2 * STRETCHES) for k in range(STRETCHES)]
        logs = [self.file.piece(m - length // 2, m - length // 2 + length) for m in middles]
        names = [f"{self.name}, {log.t[0]:.6g} to {log.t[-1]:.6g} s" for log in logs]
        return [replace(log, name=name) for log, name in zip(logs, names, strict=True)]


def log_paths(given: Given | Sequence[Given], scheduler: str | None) -> list[Path]:
    """Return the paths of logs and of all logs in folders, absolute for a scheduler's workers."""
    given = [given] if isinstance(given, str | os.PathLike) else given
    for path in given:
        if not isinstance(path, str | os.PathLike):
            raise LogError(f"{type(path).__name__} is no path; give paths of logs and folders")
    paths = expanded(given)
    return paths if scheduler is None else [path.absolute() for path in paths]


def summarise(mechanism: Mechanism, path: Path) -> LogOnDisk:
    """Read a log once, piece by piece."""
    log = open_log(path, mechanism.sources)
    signals = [name for name in log.columns if is_signal(name)]
    values = dict.fromkeys(signals, 0)
    repairs: dict[str, list[str]] = {}
    times, steps, deviations = [], [], []  # of pieces
    first, before, count, guess = 0.0, -np.inf, 0, 1.0
    digest = hashlib.blake2b(digest_size=16)
    ends = [*range(LOOK, log.rows - LOOK // 2, LOOK), log.rows]
    for at, stop in zip([0, *ends[:-1]], ends, strict=True):
        piece = log.piece(at, stop)
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
        off = t - first - guess * np.arange(count, count + len(t))
        deviations += [(i, off.min(), off.max()) for i in (count, count + len(t) - 1)]
        rows = np.arange(0, stop - at, STRIDE)  # without repeated stamps, which are left out
        times.append(t[rows * len(t) // (stop - at)])
        count, before = count + len(t), float(t[-1])
        for name in signals:
            x = piece.columns[name]
            values[name] += int(np.isfinite(x).sum())
            digest.update(x.tobytes())
            for k in absurd_samples(x):
                repairs.setdefault(f"{name}: absurd", []).append(
                    f"{name} = {x[k]:.4g} in row {at + k + 1} (t = {piece.t[k]:.6g} s) "
                    f"{NO_MEASUREMENT}; left out"
                )
        for repair in piece.repairs:
            repairs.setdefault(NUMBER.sub("#", repair), []).append(repair)
    dt = float(np.median(np.concatenate(steps)))
    instants = round((before - first) / dt) + 1
    every = (before - first) / (instants - 1)
    drift = every - guess
    uneven = max(max(high - i * drift, i * drift - low) for i, low, high in deviations)
    clock = Clock(first, every, instants, bool(instants == count and uneven < UNEVEN * dt))
    messages = tuple(
        messages_alike[0]
        + (f" (and so in {len(messages_alike) - 1} more pieces)" if len(messages_alike) > 1 else "")
        for messages_alike in repairs.values()
        if not messages_alike[0].endswith(" is empty")
    )
    return LogOnDisk(log, clock, np.concatenate(times), values, messages, digest.hexdigest())


@dataclass(frozen=True, eq=False, repr=False)
class Excerpt(Motion):
    """The motion of some stretches that stands for that of whole logs and counts their samples."""

    recorded: tuple[tuple[str, int, float], ...] = ()  # (name, samples, rate [Hz]) of the logs

    def without(self, logs: Container[str]) -> Excerpt:
        """Return the excerpt without some logs, if any is left to be shown."""
        recorded = tuple(log for log in self.recorded if log[0] not in logs)
        names = tuple(f"{name}, " for name, *_ in recorded)  # a stretch's is that and its times
        retained = tuple(e for e in self.experiments if f"{e.name}, ".startswith(names))
        return replace(self, recorded=recorded, experiments=retained or self.experiments)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the logs."""
        return tuple(name for name, _, _ in self.recorded)

    @property
    def samples(self) -> int:
        """Samples of all logs."""
        return sum(samples for _, samples, _ in self.recorded)

    @property
    def rows(self) -> list[list[str]]:
        """The logs as a table: name, samples, duration, rate, samples in pictures; head first."""
        rows = [["log", "samples", "duration", "rate", "in pictures"]]
        for name, samples, rate in self.recorded:
            stretches = (e for e in self.experiments if f"{e.name}, ".startswith(f"{name}, "))
            shown = str(sum(map(len, stretches)))
            rows.append([name, str(samples), f"{samples / rate:.4g} s", f"{rate:.4g} Hz", shown])
        return rows


def excerpt(
    mechanism: Mechanism,
    summaries: Sequence[LogOnDisk],
    cutoff: float | str | None,
    smoothing: float | str | None,
    broken: dict[str, str],
) -> Excerpt:
    """Complete stretches of the logs."""
    remaining = [summary for summary in summaries if summary.name not in broken]
    long = sum(summary.file.rows for summary in remaining) > SAMPLES
    chosen = remaining[:: max(1, -(-len(remaining) // LOGS))] if long else remaining

    def completed(chosen_logs: Sequence[LogOnDisk]) -> tuple[Motion, list[Log]]:
        pieces = [summary.stretches(SAMPLES // len(chosen)) for summary in chosen_logs]
        logs = [log for stretches in pieces for log in stretches]
        motion = complete(mechanism, logs, cutoff=cutoff, smoothing=smoothing)
        return motion, [
            replace(stretches[0], name=s.name)
            for stretches, s in zip(pieces, chosen_logs, strict=True)
        ]

    try:
        motion, logs = completed(chosen)
    except IdentError:
        faults = {}
        for summary in chosen:
            try:
                completed([summary])
            except IdentError as error:
                faults[summary.name] = line_of(error).removeprefix(f"{summary.name}: ")
        if len(summaries) == 1 or not faults or len(faults) == len(remaining):
            raise
        broken.update(faults)
        return excerpt(mechanism, summaries, cutoff, smoothing, broken)
    notes = [f"{summary.name}: {repair}" for summary in remaining for repair in summary.repairs]
    for note in motion.notes:  # once for each log, and nothing about the ends of stretches
        for summary in remaining:
            if note.startswith(f"{summary.name}, "):
                text = note.removeprefix(f"{summary.name}, ").partition(" s:")[2]
                ends = text.endswith("left out") and "no sample near" not in text
                note = "" if ends else f"{summary.name}:{text}"
        # each log reports itself what is no measurement
        notes += [note] if note and NO_MEASUREMENT not in note else []
    return Excerpt(
        motion.experiments, motion.independent, motion.band, motion.closure_error,
        tuple(dict.fromkeys(notes)), tuple(logs), mechanism, motion.channels,
        tuple((s.name, s.clock.count, 1 / s.clock.step) for s in remaining),
    )  # fmt: skip
