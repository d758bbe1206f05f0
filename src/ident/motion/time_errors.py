"""Errors of time stamps that all channels of a log have in common.

Stamps jitter and rows repeat: positions are then off by speed times one time error δ_i,

    r_ij = q_ij − s_j(t_i) = ṡ_j(t_i) δ_i + e_ij
    δ_i = Σ_j ṡ_j r_ij/σ_j² / (Σ_j ṡ_j²/σ_j² + 1/σ_t²)

of row i and joint j, s: the smooth motion. Whether there is such an error is shown by each joint's
r, as far as the δ of all other joints predicts it: noise of encoders is not predicted at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.motion.signals import LogSignals
from ident.motion.smoothing import Derived

STEPS = 5  # of the alternation between δ and the sizes of both noises
STRETCHES = 10  # of a log, lest one jump decides
PREDICTED = 0.2  # share of a joint's squared r that the others must predict, in half of all cases
ROUGH = 0.3  # of 2 δ² that its steps must be: what a spline misses of a corner is smooth
SLOWEST = 0.05  # share of the top speed below which positions say nothing of time


def without_time_errors(
    signals: LogSignals, derived: Derived, names: Sequence[str]
) -> tuple[LogSignals, float] | None:
    """The log with positions and rates at its stamps, and the rms of its time errors [s]; None if
    the joints `names` have none in common.
    """
    smooth, log = derived.smooth, signals.log
    moving = [n for n in names if smooth is not None and n in smooth.names]
    t = np.asarray(log.t)
    if smooth is None or len(moving) < 2:
        return None
    r, v, a = np.zeros((3, len(t), len(moving)))
    for run, spline in smooth.runs:
        inside = (t >= signals.t[run][0]) & (t <= signals.t[run][-1])
        at = [smooth.names.index(name) for name in moving]
        q, v[inside], a[inside] = spline.at(t[inside])[:, :, at]
        logged = np.stack([log.columns[f"q.{name}"][inside] for name in moving], axis=1)
        r[inside] = np.nan_to_num(logged - q)
    error, shares = common(r, v)
    size = float(np.mean(error**2))
    if np.median(shares) < PREDICTED or np.mean(np.diff(error) ** 2) < ROUGH * 2 * size:
        return None
    columns, here = dict(log.columns), dict(signals.columns)
    for j, name in enumerate(moving):
        for column, rate in ((f"q.{name}", v), (f"v.{name}", a)):
            if column in here:
                columns[column] = columns[column] - rate[:, j] * error
                good = np.isfinite(columns[column])
                here[column] = np.interp(signals.t, t[good], columns[column][good])
    return replace(signals, log=replace(log, columns=columns), columns=here), float(np.sqrt(size))


def common(r: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """δ (n,) [s] of residuals r and speeds v (n, J), and by stretch of time and joint the share
    (STRETCHES, J) of its squared residual that the others' δ predicts.
    """
    v = np.where(np.abs(v) > SLOWEST * np.abs(v).max(axis=0), v, 0.0)
    noise, spread = (r**2).mean(axis=0) + 1e-300, np.inf
    for _ in range(STEPS):
        up, down = v * r / noise, v**2 / noise
        error = up.sum(axis=1) / (down.sum(axis=1) + 1 / spread + 1e-300)
        noise = ((r - v * error[:, None]) ** 2).mean(axis=0) + 1e-300
        spread = float(np.mean(error**2)) + 1e-300
    others = (up.sum(axis=1)[:, None] - up) / (down.sum(axis=1)[:, None] - down + 1 / spread)
    squares = [
        [(x[part] ** 2).sum(axis=0) for x in (r - v * others, r)]
        for part in np.array_split(np.arange(len(r)), STRETCHES)
    ]
    return error, np.array([1 - left / (all_ + 1e-300) for left, all_ in squares])
