"""Whether a log repeats its motion, and whether the residual repeats with it.

    likeness(T) = 1 − Var(q(t+T) − q(t)) / 2 Var(q)         of each independent joint that moves
    ρ_rep = corr(r(t), r(t+T))        floor = rms(r(t+T) − r(t)) / √2

What repeats is no noise: near 1, physics is missing; near 0, none is. A floor above the noise of
other joints is something missing that does not repeat, a drift perhaps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ident.fit.residual import Residual, Trace
from ident.motion import State
from ident.residual.noise import ERRORS, own_correlation

ALIKE = 0.98  # likeness of two periods of one motion
SAME = 0.005  # likeness by which a shorter period may be worse than the best
APART = 0.5  # likeness below which the motion has left where it was
CHANCE = 0.4  # correlation between periods that noise of the best logs had been seen to have
MOVING = 0.05  # share of samples in which a joint moves, for it to count
FINE = 16  # samples a period of the motion's bandwidth, from which periods are found
FEWEST = 16  # samples, and pairs of rows, that say anything


@dataclass(frozen=True)
class Periods:
    """Repetition of the motion, and of the residual with it.

    Attributes:
        period: [s] and count: of whole periods, by experiment that has any.
        likeness: of the motion, the least of all joints and experiments.
        rho: correlation of the residual between periods, by joint.
        floor: what does not repeat [N m | N], by joint: the noise floor.
        chance: correlation below which noise may repeat: 0.4, or four standard errors.
    """

    period: Mapping[str, float]
    count: Mapping[str, int]
    likeness: float
    rho: Mapping[str, float]
    floor: Mapping[str, float]
    chance: float

    def __str__(self) -> str:
        said = [f"{name}: {self.count[name]} × {T:.4g} s" for name, T in self.period.items()]
        rho = ", ".join(f"{joint} {value:.2f}" for joint, value in self.rho.items())
        floor = ", ".join(f"{joint} {value:.2g}" for joint, value in self.floor.items())
        return (
            f"the motion repeats ({'; '.join(said)}); correlation of the residual between periods: "
            f"{rho}; what does not repeat, rms: {floor}"
        )


def periods(residual: Residual) -> Periods | None:
    """Repeated periods and what the residual does in them; None where no log repeats its motion."""
    found: dict[str, tuple[Trace, float, int, float]] = {}
    traces = list(residual.traces)  # in the order of the experiments, of which some have no rows
    for e in residual.motion.experiments:
        if not traces or (traces[0].name, traces[0].t[0] < e.t[0]) != (e.name, False):
            continue
        trace = traces.pop(0)
        if (known := period_of(e, residual)) is not None:
            name = e.name if e.name not in found else f"{e.name} ({len(found) + 1})"
            found[name] = trace, *known
    pairs = [_pairs(trace, T) for trace, T, _, _ in found.values()]
    if sum(len(early) for early, _ in pairs) < FEWEST:
        return None
    first, second = (np.concatenate(each) for each in zip(*pairs, strict=True))
    rho, floor = {}, {}
    for u, joint in enumerate(residual.joints):
        a, b = first[:, u] - first[:, u].mean(), second[:, u] - second[:, u].mean()
        rho[joint] = float(a @ b / max(np.sqrt((a @ a) * (b @ b)), 1e-300))
        floor[joint] = float(np.sqrt(np.mean((first[:, u] - second[:, u]) ** 2) / 2))
    return Periods(
        period={name: T for name, (_, T, _, _) in found.items()},
        count={name: n for name, (_, _, n, _) in found.items()},
        likeness=min(like for _, _, _, like in found.values()),
        rho=rho,
        floor=floor,
        chance=max(CHANCE, ERRORS / float(np.sqrt(max(_independent(residual, len(first)), 1.0)))),
    )


def _independent(residual: Residual, rows: int) -> float:
    """How many of the rows noise that went through the filter makes independent."""
    own = own_correlation(residual.motion.band.cutoff, residual.rate)
    return rows / float(1 + 2 * (own**2).sum())


def period_of(e: State, residual: Residual) -> tuple[float, int, float] | None:
    """(period [s], whole periods, likeness) of one experiment's motion in its longest run."""
    run = max(e.segments(), key=lambda each: each.stop - each.start, default=slice(0, 0))
    stride = max(1, int(e.rate / (FINE * max(residual.motion.band.motion, 1e-9))))
    t, y, yd = (x[run][::stride] for x in (e.t, e.y, e.yd))
    at = np.array([residual.signals.index(joint) for joint in residual.joints])
    if len(t) < FEWEST:
        return None
    moves = (np.abs(yd[:, at]) > e.still[at]).mean(axis=0) > MOVING
    if not moves.any():
        return None
    likeness = np.min([_likeness(y[:, i]) for i in at[moves]], axis=0)
    away = np.flatnonzero(likeness < APART)
    if not len(away):
        return None
    inner = likeness[int(away[0]) :]
    peaks = 1 + np.flatnonzero((inner[1:-1] >= inner[:-2]) & (inner[1:-1] >= inner[2:]))
    if not len(peaks) or inner[peaks].max() < ALIKE:
        return None
    good = peaks[inner[peaks] >= max(ALIKE, inner[peaks].max() - SAME)]
    lag = int(away[0] + good[0])
    low, mid, high = likeness[lag - 1 : lag + 2]
    bend = low - 2 * mid + high
    exact = lag + (0.5 * (low - high) / bend if bend < 0 else 0.0)
    step = float(t[-1] - t[0]) / (len(t) - 1)
    return float(exact * step), int(len(t) / exact + 0.05), float(mid)


def _likeness(q: np.ndarray) -> np.ndarray:
    """By lag (n // 2 + 3,); whole turns between periods do not count."""
    n = len(q)
    x = q - q.mean()
    lags = np.arange(n // 2 + 3)
    spectrum = np.fft.rfft(x, 2 * n)
    product = np.fft.irfft(np.abs(spectrum) ** 2)[: len(lags)]
    s, ss = (np.concatenate([[0.0], np.cumsum(y)]) for y in (x, x**2))
    pairs = n - lags
    mean = (s[n] - s[lags] - s[pairs]) / pairs
    difference = (ss[n] - ss[lags] + ss[pairs] - 2 * product) / pairs - mean**2
    rise = np.linspace(q[0], q[-1], n)  # a joint that turns on and on varies about this
    return np.asarray(1 - difference / (2 * max(float(np.var(q - rise)), 1e-300)))


def _pairs(trace: Trace, T: float) -> tuple[np.ndarray, np.ndarray]:
    """r(t) and r(t + T) (m, d), at the rows t."""
    run = max(trace.runs(), key=lambda each: each.stop - each.start)
    t, r = trace.t[run], trace.residual[run]
    early = t + T <= t[-1] + 1e-9
    if not early.any():
        return r[:0], r[:0]
    return r[early], CubicSpline(t, r)(np.minimum(t[early] + T, t[-1]))
