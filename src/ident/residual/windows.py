"""When a joint's residual is clearly larger than it usually is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.fit.residual import Residual
from ident.motion.signals import runs

PARTS = 50  # of an experiment that one window is
SHORTEST, LONGEST = 0.1, 1.0  # s
LARGER = 2.0  # times the median of local rms values
MOST = 5


@dataclass(frozen=True)
class Window:
    """A stretch of time [s] in which the local rms [N m | N] stands out."""

    experiment: str
    start: float
    stop: float
    rms: float

    def __str__(self) -> str:
        return f"{self.start:.4g}–{self.stop:.4g} s"


def worst(residual: Residual, joint: str, effective: float) -> tuple[Window, ...]:
    """At most five stretches of time, the one with the largest sum of squares first.

    Args:
        residual: of a model.
        joint: an independent one.
        effective: independent rows of all rows (n / Σ r²); noise alone makes short windows vary.
    """
    u, pieces = residual.joints.index(joint), []
    for trace in residual.traces:
        width = float(np.clip((trace.t[-1] - trace.t[0]) / PARTS, SHORTEST, LONGEST))
        for run in trace.runs():
            r, t = trace.residual[run, u], trace.t[run]
            step = (t[-1] - t[0]) / max(len(t) - 1, 1) or width
            size = int(np.clip(round(width / step), min(3, len(r)), len(r)))
            box = np.ones(size)
            count = np.convolve(np.ones(len(r)), box, "same")
            local = np.sqrt(np.convolve(r**2, box, "same") / count)
            pieces.append((trace.name, t, r, local, size))
    every = np.concatenate([piece[3] for piece in pieces])
    rows = float(np.mean([piece[4] for piece in pieces])) * effective / residual.rows
    limit = max(LARGER, 1 + 4 / np.sqrt(2 * max(rows, 0.5))) * float(np.median(every))
    limit = max(limit, float(np.sqrt(np.mean(every**2))))
    found = []
    for name, t, r, local, _ in pieces:
        for run in runs(local > limit):
            if run.stop - run.start < 2:
                continue
            energy = float((r[run] ** 2).sum())
            rms = float(np.sqrt(np.mean(r[run] ** 2)))
            found.append((energy, Window(name, float(t[run][0]), float(t[run][-1]), rms)))
    found.sort(key=lambda each: -each[0])
    return tuple(window for _, window in found[:MOST])
