"""Motions that are repeated, and errors that repeat with them.

Where a log repeats its motion with a period T, the residual that repeats with it is no noise:

    likeness(T) = 1 − Var(q(t+T) − q(t)) / 2 Var(q)         of each independent joint that moves
    ρ = corr(r(t), r(t+T))

Near 1, physics is missing; near 0, none is. What the model lacks and the steps of an encoder are
the same in each of K periods, which are then not independent: the variance of a parameter is
1 + (K − 1) ρ times as large (Kish, Survey Sampling, 1965, 5.4: the design effect of clusters).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.fit.findings import Finding
from ident.fit.prediction import Trace
from ident.fit.residual_maps import ERRORS, own_correlation
from ident.motion import Motion, State

ALIKE = 0.98  # likeness of two periods of one motion
APART = 0.5  # likeness below which the motion has left where it was
MOVING = 0.05  # share of samples in which a joint moves, for it to count
FINE = 16  # samples a period of the motion's bandwidth, from which periods are found
FEWEST = 16  # samples, and pairs of rows, from which repetition can be determined
CHANCE = 0.4  # correlation between periods that the noise of good logs has


@dataclass(frozen=True)
class Periods:
    """Repetition of the motion, and of the residual with it.

    Attributes:
        period: [s], by experiment that has any.
        rho: correlation of the residual between periods, by joint.
        chance: correlation below which noise may repeat: 0.4, or four standard errors.
    """

    period: Mapping[str, float]
    rho: Mapping[str, float]
    chance: float

    def periods(self, seconds: float) -> float:
        """Return how often the motion is repeated in so many seconds."""
        return seconds / min(self.period.values())

    def variance(self, seconds: float) -> float:
        """Return by how much variances over so many seconds are larger than of white residuals."""
        rho = float(np.mean([max(0.0, each) for each in self.rho.values()]))
        return 1 + max(self.periods(seconds) - 1, 0.0) * rho

    def finding(self, seconds: float) -> Finding:
        """Return what a person should know of logs of so many seconds."""
        rho = float(np.mean([max(0.0, each) for each in self.rho.values()]))
        text = (
            f"the motion is repeated every {min(self.period.values()):.4g} s and {100 * rho:.0f} % "
            f"of the residual with it: {self.periods(seconds):.3g} periods are not independent, so "
            f"standard errors are {np.sqrt(self.variance(seconds)):.3g} times as wide"
        )
        return Finding("repeated errors", text, "", (), max(self.rho.values()), self.chance)


def repetition(
    motion: Motion, traces: Sequence[Trace], joints: np.ndarray, rate: float
) -> Periods | None:
    """Return what a motion repeats of the residual in its traces; None where it repeats nothing.

    Args:
        motion: some of whose experiments have no rows, and no trace.
        traces: in the order of the experiments.
        joints: places (d,) of the independent joints among all.
        rate: rows a second [Hz].
    """
    found, pairs, left = dict[str, float](), [], list(traces)
    for e in motion.experiments:
        if not left or left[0].name != e.name or left[0].t[0] < e.t[0]:
            continue
        trace = left.pop(0)
        if (period := period_of(e, joints, motion.band.motion)) is not None:
            name = e.name if e.name not in found else f"{e.name} ({len(found) + 1})"
            found[name] = period
            pairs.append(_pairs(trace, period))
    if sum(len(early) for early, _ in pairs) < FEWEST:
        return None
    first, second = (np.concatenate(each) for each in zip(*pairs, strict=True))
    a, b = first - first.mean(axis=0), second - second.mean(axis=0)
    rho = (a * b).sum(axis=0) / np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0) + 1e-300)
    own = own_correlation(motion.band.cutoff, rate)
    independent = len(first) / float(1 + 2 * (own**2).sum())
    chance = max(CHANCE, ERRORS / float(np.sqrt(max(independent, 1.0))))
    return Periods(found, dict(zip(motion.independent, map(float, rho), strict=True)), chance)


def _pairs(trace: Trace, T: float) -> tuple[np.ndarray, np.ndarray]:
    """Return r(t) and r(t + T) (m, d), at the rows t."""
    run = max(trace.runs(), key=lambda each: each.stop - each.start)
    t, r = trace.t[run], trace.residual[run]
    early = t + T <= t[-1] + 1e-9
    if not early.any():
        return r[:0], r[:0]
    from scipy.interpolate import CubicSpline  # takes 0.2 s to import

    return r[early], CubicSpline(t, r)(np.minimum(t[early] + T, t[-1]))


def period_of(e: State, joints: np.ndarray, bandwidth: float) -> float | None:
    """Return the period [s] of a motion in its longest run; None if it is not repeated.

    Args:
        e: the motion.
        joints: places of the joints (d,) that are looked at.
        bandwidth: of the motion [Hz].
    """
    run = max(e.segments(), key=lambda each: each.stop - each.start, default=slice(0, 0))
    stride = max(1, int(e.rate / (FINE * max(bandwidth, 1e-9))))
    t, y, yd = (x[run][::stride] for x in (e.t, e.y, e.yd))
    if len(t) < FEWEST:
        return None
    moves = (np.abs(yd[:, joints]) > e.still[joints]).mean(axis=0) > MOVING
    if not moves.any():
        return None
    likeness = np.min([_likeness(y[:, i]) for i in joints[moves]], axis=0)
    inner = likeness[1:-1]
    peak = (inner >= likeness[:-2]) & (inner >= likeness[2:]) & (inner >= ALIKE)
    away = np.flatnonzero(likeness < APART)
    lags = 1 + np.flatnonzero(peak)
    lags = lags[lags > away[0]] if len(away) else lags[:0]
    if not len(lags):
        return None
    low, mid, high = likeness[lags[0] - 1 : lags[0] + 2]
    bend = low - 2 * mid + high
    exact = lags[0] + (0.5 * (low - high) / bend if bend < 0 else 0.0)
    return float(exact * (t[-1] - t[0]) / (len(t) - 1))


def _likeness(q: np.ndarray) -> np.ndarray:
    """Return the likeness by lag (n // 2 + 3,); whole turns between periods do not count."""
    n = len(q)
    x = q - np.linspace(q[0], q[-1], n)  # a joint that turns on and on varies about this
    x -= x.mean()
    lags = np.arange(n // 2 + 3)
    product = np.fft.irfft(np.abs(np.fft.rfft(x, 2 * n)) ** 2)[: len(lags)]
    s, ss = (np.concatenate([[0.0], np.cumsum(y)]) for y in (x, x**2))
    pairs = n - lags
    mean = (s[n] - s[lags] - s[pairs]) / pairs
    difference = (ss[n] - ss[lags] + ss[pairs] - 2 * product) / pairs - mean**2
    return np.asarray(1 - difference / (2 * max(float(np.var(x)), 1e-300)))
