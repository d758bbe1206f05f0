"""One uniform clock for columns that may have gaps, empty cells and rates of their own."""

from __future__ import annotations

import numpy as np

from ident.log import Log

UNEVEN = 1e-3  # jitter, as a share of the step, below which a clock counts as uniform
GAP = 5.0  # median steps without a sample that make a gap
SHORTEST = 12.0  # median steps that a run between two gaps must last to be used


def uniform_clock(log: Log) -> tuple[np.ndarray, bool]:
    """Times (n,) [s] of the log's median step, and whether they are the log's own."""
    dt = float(np.median(np.diff(log.t)))
    count = round(log.duration / dt) + 1
    uniform = log.t[0] + log.duration / (count - 1) * np.arange(count)
    even = count == len(log.t) and float(np.abs(uniform - log.t).max()) < UNEVEN * dt
    return (np.asarray(log.t), True) if even else (uniform, False)


def holes(t: np.ndarray, at: np.ndarray) -> np.ndarray:
    """True (n,) where t lies in a gap of a column that has samples at the times `at`."""
    step = float(np.median(np.diff(at)))
    right = np.clip(np.searchsorted(at, t), 1, len(at) - 1)
    outside = (t < at[0] - 0.5 * step) | (t > at[-1] + 0.5 * step)
    return outside | (at[right] - at[right - 1] > GAP * step) & (
        np.minimum(np.abs(at[right] - t), np.abs(t - at[right - 1])) > 1e-9
    )


def runs(usable: np.ndarray) -> list[slice]:
    """The runs of true values (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(np.int8), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def without_short_runs(usable: np.ndarray, shortest: int) -> np.ndarray:
    """`usable` (n,) without runs of fewer than `shortest` samples."""
    kept = usable.copy()
    for run in runs(usable):
        if run.stop - run.start < shortest:
            kept[run] = False
    return kept


def at_own_rate(t: np.ndarray, at: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, float]:
    """A column (m,) within t (n,), uniform, no finer than its own samples, and its step."""
    step = float(np.median(np.diff(at)))
    dt = float(t[1] - t[0])
    if step > 1.5 * dt:
        first, last = np.searchsorted(at, (t[0] - 0.5 * dt, t[-1] + 0.5 * dt))
        t, dt = np.arange(at[first], at[last - 1] + 1e-6 * step, step), step
    return np.interp(t, at, x), dt
