"""From a log of normal running to what the charts look for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ident.monitor.clean import Clean, check_long_enough, settled
from ident.monitor.interval import Cutter, Interval, Piece
from ident.monitor.rehearse import Rehearsal, rehearsed
from ident.monitor.watched import Watched
from ident.motion import Motion
from ident.solve.factor import Factor

DIRECT = 4  # columns of a suspect that have charts; of a payload the mass and its first moments


def learnt(
    watched: Watched, motion: Motion, seconds: float, material: float
) -> tuple[Rehearsal, np.ndarray]:
    """Charts that hold their rate, and the reference x (k,) that they hold it for.

    Args:
        watched: what is watched.
        motion: of normal running.
        seconds: of an interval.
        material: share of the torques that a change must be.

    Raises:
        FitError: for a clean log that is too short.
    """
    x = watched.reference
    pieces = [piece for e in motion.experiments for piece in watched.pieces(e)]
    count = sum(piece.informed.sum(axis=0) for piece in pieces)
    squares = sum(
        (np.where(piece.informed, piece.b - piece.A @ x, 0.0) ** 2).sum(axis=0) for piece in pieces
    )
    sigma = np.sqrt(np.maximum(squares / np.maximum(count, 1), 1e-300))
    first = list(_intervals(pieces, seconds, sigma, x))
    check_long_enough(first)
    x = settled(Factor.merge([each.factor for each in first]), x)
    intervals = list(_intervals(pieces, seconds, sigma, x))
    mask = np.zeros(len(watched.columns), dtype=bool)
    for suspect in watched.suspects:
        mask[suspect.places[:DIRECT]] = True
    return rehearsed(Clean.of(intervals, sigma, x, material), mask, intervals, x), x


def _intervals(
    pieces: Sequence[Piece], seconds: float, sigma: np.ndarray, x: np.ndarray
) -> Iterator[Interval]:
    cutter = Cutter(seconds)
    for piece in pieces:
        for part in cutter.cut(piece):
            yield Interval.of(part, sigma, x)
    for part in cutter.flush():
        yield Interval.of(part, sigma, x)
