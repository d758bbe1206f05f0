"""Signals on which a residual depends: smooth maps of them, held out in stretches of time.

    f(x) = Σ_k c_k h_k(x)                             h_k: hat functions of evenly spaced knots
    R² = 1 − Σ_folds ‖r − Φ ĉ₋fold‖² / Σ_folds ‖r − r̄₋fold‖²        ĉ by ridge least squares

The direction of motion has a column of its own, since a step is no smooth map; so has a joint's own
load for bands that widen with it, |load| sign(v). Signals are chosen one after the other (greedy,
forward), so that one that only copies another earns nothing; each must beat what it would earn on
noise with the spectrum of the present residual. All of it comes from ΦᵀΦ and Φᵀr of the folds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ident.equations.filter import Decimator

KNOTS = 9  # of a map
FINE = 41  # of the map of a joint's own position, for waves
SLOW = 4  # of the map of time: fewer than folds, so that what is held out lies between
MOST = 12  # joints whose signals are compared
STIFF, STIFF_FINE = 1e-2, 1e-3  # weight of the map's bends, in shares of a knot's data
LEAST = 0.03  # R² that is worth a mention, of the residual after the signals before it
GAIN = 0.02  # and of the whole
SURE = 0.6  # R² that is always believed, however short the log
SIMPLER = 0.02  # R² that is given up for the simpler map, or for the joint's own signal
DRAWS = 60  # surrogates of noise
LONGEST = 4  # signals of one joint
MEMORY = 0.15  # autocorrelation beyond the filter's length that is always taken for noise
ERRORS = 4.0  # or so many of its standard errors
FARTHEST = 400  # lags of the autocorrelation
UNFILTERED = 2  # lags at which differentiated noise of encoders is correlated without any filter
OVERSAMPLED = 40  # samples a period of the cut-off at which the filter's correlation is computed
ALIKE = 0.9  # share of a map's variation that a shape must explain to give it its name
OUTER = 1 / 3  # of the range: where a kink is at an end
PROMINENT = 0.3  # of a map's range: smaller bends are no wave

Signal = Callable[[str], tuple[Sequence[np.ndarray], str]]


# --- correlation in time, and noise of the same spectrum -----------------------------------------


@dataclass(frozen=True)
class Memory:
    """Largest autocorrelation of a series beyond the length of its filter.

    Attributes:
        value: the autocorrelation; lag: where [s].
        threshold: below which |value| is that of noise: 0.15, or four standard errors (Bartlett).
        effective: number of independent rows, n / Σ r² of the filter alone.
    """

    value: float
    lag: float
    threshold: float
    effective: float

    @property
    def noise(self) -> bool:
        """Whether rows farther apart than the filter is long are uncorrelated."""
        return abs(self.value) <= self.threshold


def autocorrelation(runs: Sequence[np.ndarray], lags: int) -> np.ndarray:
    """Return r (lags + 1,) of a series in runs without a gap, about their mean; r[0] = 1."""
    mean = np.concatenate(runs).mean()
    total, pairs = np.zeros(lags + 1), np.zeros(lags + 1)
    for run in runs:
        n = len(run)
        product = np.fft.irfft(np.abs(np.fft.rfft(run - mean, 2 * n)) ** 2)[: min(lags + 1, n)]
        total[: len(product)] += product
        pairs[: len(product)] += n - np.arange(len(product))
    r = total / np.maximum(pairs, 1)
    return r / r[0] if r[0] > 0 else np.eye(1, lags + 1)[0]


def own_correlation(cutoff: float | None, rate: float) -> np.ndarray:
    """Return r (lags,) from lag 1 on that a filter gives to white noise, in rows at `rate` [Hz].

    Without a filter there are two lags of 0, over which differentiated noise of encoders extends.
    """
    if cutoff is None:
        return np.zeros(UNFILTERED)
    fine = Decimator.of(cutoff, OVERSAMPLED * cutoff)
    assert fine.taps is not None
    product = np.correlate(fine.taps, fine.taps, "full")[len(fine.taps) - 1 :]
    each = OVERSAMPLED * cutoff / rate
    at = each * np.arange(1, max(UNFILTERED, int(np.ceil(fine.half / each))) + 1)
    return np.interp(at, np.arange(len(product)), product / product[0], right=0.0)


def memory_of(runs: Sequence[np.ndarray], cutoff: float | None, rate: float) -> Memory:
    """Return the autocorrelation of a series, in runs without a gap, beyond its filter's length."""
    n, longest = sum(map(len, runs)), max(map(len, runs))
    own = own_correlation(cutoff, rate)
    first, last = len(own) + 1, min(longest // 3, FARTHEST)
    r = autocorrelation(runs, max(last, first))
    effective = n / float(1 + 2 * ((own if cutoff else r[1:first]) ** 2).sum())
    if last <= first:
        return Memory(0.0, 0.0, MEMORY, effective)
    lags = np.arange(first, last + 1)
    pairs = sum(np.maximum(len(run) - lags, 0) for run in runs) * effective / n
    limit = np.maximum(MEMORY, ERRORS / np.sqrt(pairs))
    worst = int(np.argmax(np.abs(r[lags]) / limit))
    return Memory(float(r[lags[worst]]), lags[worst] / rate, float(limit[worst]), effective)


def surrogates(runs: Sequence[np.ndarray], count: int, seed: int = 0) -> np.ndarray:
    """Return (n, count) series with each run's spectrum and random phases.

    Source: Theiler et al., Physica D 58, 1992.
    """
    random = np.random.default_rng(seed)
    series = []
    for run in runs:
        spectrum = np.abs(np.fft.rfft(run))[:, None]
        phase = np.exp(2j * np.pi * random.random((len(spectrum), count)))
        phase[0] = np.sign(phase[0].real)
        series.append(np.fft.irfft(spectrum * phase, len(run), axis=0))
    return np.concatenate(series)


# --- maps of signals -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SignalMap:
    """One signal and its map.

    Attributes:
        name: `v.elbow`, `sign(v).elbow`, `t`, …; kind: `v`, `sign(v)`, …, `wave`, `bands`.
        unit: of the signal.
        columns: (n, c) of the map; knots: (c,) [unit], empty where columns are not hats.
        stiff: weight of the second differences of the map's values.
    """

    name: str
    kind: str
    unit: str
    columns: np.ndarray
    knots: np.ndarray
    stiff: float = 0.0

    def penalty(self, n: int) -> np.ndarray:
        """Return κ D₂ᵀD₂ + ε (c, c), by which the map is determined where there are no data."""
        c = self.columns.shape[1]
        bends = np.diff(np.eye(c), 2, axis=0)
        return n / c * (1e-6 * np.eye(c) + self.stiff * bends.T @ bends)


def hats(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return h_k(x) (n, c) of evenly spaced knots (c,); constant beyond the ends."""
    at = np.clip((x - knots[0]) / max(knots[1] - knots[0], 1e-300), 0.0, len(knots) - 1.0)
    first = np.minimum(at.astype(int), len(knots) - 2)
    out = np.zeros((len(x), len(knots)))
    rows = np.arange(len(x))
    out[rows, first], out[rows, first + 1] = 1 - (at - first), at - first
    return out


def signal_maps(signal: Signal, joints: Sequence[str], independent: Sequence[str]) -> list:
    """Return the maps of time and of all joints' signals, on the rows of all experiments.

    `signal` gives the series of each experiment and the unit by name (`Residual.signal`).
    """
    times, _ = signal("t")
    t = np.concatenate([each - each[0] for each in times])
    knots = np.linspace(0.0, max(float(t.max()), 1e-9), SLOW)
    maps = [SignalMap("t", "t", "s", hats(t, knots), knots, STIFF)]
    others = [name for name in joints if name not in independent]
    for joint in [*independent, *others[: max(0, MOST - len(independent))]]:
        step = np.concatenate(signal(f"sign(v).{joint}")[0])[:, None]
        maps.append(SignalMap(f"sign(v).{joint}", "sign(v)", "", step, np.zeros(0)))
        for kind in ("v", "q", "a", *(["load"] if joint in independent else [])):
            maps += _smooth(signal, kind, joint, KNOTS, STIFF)
        if joint in independent:
            load, unit = signal(f"load.{joint}")
            bands = np.abs(np.concatenate(load))[:, None] * step
            columns = np.hstack([step, bands / max(float(np.abs(bands).max()), 1e-300)])
            maps.append(SignalMap(f"load.{joint}", "bands", unit, columns, np.zeros(0)))
    return [each for each in maps if np.ptp(each.columns, axis=0).max() > 1e-9]


def _smooth(signal: Signal, kind: str, joint: str, count: int, stiff: float) -> list[SignalMap]:
    pieces, unit = signal(f"{kind}.{joint}")
    x = np.concatenate(pieces)
    if np.ptp(x) <= 1e-9 * max(float(np.abs(x).max()), 1e-9):
        return []
    knots = np.linspace(x.min(), x.max(), count)
    return [SignalMap(f"{kind}.{joint}", kind, unit, hats(x, knots), knots, stiff)]


def own_maps(signal: Signal, joint: str, maps: Sequence[SignalMap]) -> list[SignalMap]:
    """Return maps in one joint's order of preference, with a fine one of its position for waves."""
    fine = _smooth(signal, "q", joint, FINE, STIFF_FINE)
    every = [*maps, *(replace(each, kind="wave") for each in fine)]
    return sorted(every, key=lambda each: each.name.partition(".")[2] != joint)


def folds(lengths: Sequence[int], count: int = 10) -> np.ndarray:
    """Return the fold (n,) of every row: whole experiments from three on, else parts of them."""
    if len(lengths) >= 3:
        return np.repeat(np.arange(len(lengths)), lengths)
    each = -(-count // len(lengths))
    return np.concatenate([i * each + np.arange(n) * each // n for i, n in enumerate(lengths)])


# --- the choice of signals -----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class MapStep:
    """One signal that was chosen: its map's values (c,), and R² without and with it."""

    map: SignalMap
    values: np.ndarray
    before: float
    after: float


class _FoldSums:
    """ΦᵀΦ (F, c, c), Φᵀr (F, c, m) and rᵀr (F, m) of the folds, for m series r at a time."""

    def __init__(self, maps: Sequence[SignalMap], fold: np.ndarray) -> None:
        edges = np.cumsum([0, 1, *(each.columns.shape[1] for each in maps)])
        self.columns = [np.arange(a, b) for a, b in pairwise(edges)]
        self.Phi = np.hstack([np.ones((len(fold), 1)), *(each.columns for each in maps)])
        self.parts = np.split(np.arange(len(fold)), np.flatnonzero(np.diff(fold)) + 1)
        self.gram = np.stack([self.Phi[part].T @ self.Phi[part] for part in self.parts])
        self.penalty = np.zeros(self.gram.shape[1:])
        for each, place in zip(maps, self.columns[1:], strict=True):
            self.penalty[np.ix_(place, place)] = each.penalty(len(fold))

    def moments(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return Φᵀr (F, c, m) and rᵀr (F, m) of series r (n, m)."""
        cross = np.stack([self.Phi[part].T @ r[part] for part in self.parts])
        return cross, np.stack([(r[part] ** 2).sum(axis=0) for part in self.parts])

    def at(self, chosen: Sequence[int]) -> np.ndarray:
        """Return the columns of a constant and some maps."""
        return np.concatenate([self.columns[0], *(self.columns[i + 1] for i in chosen)])

    def solve(self, chosen: Sequence[int], cross: np.ndarray) -> np.ndarray:
        """Return the values (c,) of a constant and some maps, from all folds."""
        at = self.at(chosen)
        A = self.gram.sum(axis=0)[np.ix_(at, at)] + self.penalty[np.ix_(at, at)]
        return np.asarray(np.linalg.solve(A, cross.sum(axis=0)[at])[:, 0])

    def held_out(self, chosen: Sequence[int], cross: np.ndarray, square: np.ndarray) -> np.ndarray:
        """Return Σ_folds ‖r − Φ ĉ₋fold‖² (m,)."""
        at = self.at(chosen)
        G, b = self.gram[:, at[:, None], at], cross[:, at]
        A = G.sum(axis=0) - G + self.penalty[np.ix_(at, at)]
        c = np.linalg.solve(A, b.sum(axis=0) - b)
        squares = square - 2 * (c * b).sum(axis=1) + (c * (G @ c)).sum(axis=1)
        return np.asarray(squares.sum(axis=0))


def depends_on(
    r: np.ndarray, fold: np.ndarray, maps: Sequence[SignalMap], runs: Sequence[slice]
) -> tuple[list[MapStep], float]:
    """Return the signals that explain a residual, and the R² that the next one would have needed.

    Args:
        r: (n,) the residual; fold: (n,) consecutive rows of one number are one stretch of time.
        maps: in order of preference where they explain alike.
        runs: of rows without a gap.
    """
    steps: list[MapStep] = []
    scale = float(np.sqrt(np.mean(r**2)))
    if len(r) < 20 or scale == 0:
        return steps, 1.0
    r = r / scale
    sums = _FoldSums(maps, fold)
    moments = sums.moments(r[:, None])
    now = total = float(sums.held_out([], *moments)[0])
    chosen: list[int] = []
    while total > 0:  # one stretch of time alone has nothing that can be held out
        unexplained = r
        if chosen:
            unexplained = r - sums.Phi[:, sums.at(chosen)] @ sums.solve(chosen, moments[0])
        noise = sums.moments(
            surrogates([unexplained[run] for run in runs], DRAWS, seed=len(chosen))
        )
        without = sums.held_out(chosen, *noise)
        rest = [i for i in range(len(maps)) if i not in chosen]
        after = {i: float(sums.held_out([*chosen, i], *moments)[0]) for i in rest}
        after = {i: error for i, error in after.items() if np.isfinite(error)}
        if not after:
            break
        chance = max(float((1 - sums.held_out([*chosen, i], *noise) / without).max()) for i in rest)
        threshold = float(np.clip(chance, LEAST, SURE))
        least = min(after.values())
        near = [i for i, error in after.items() if error <= least + SIMPLER * now]
        pick = min(near, key=lambda i: (maps[i].columns.shape[1], i))
        enough = 1 - least / now > threshold and now - after[pick] > GAIN * total
        if not enough or len(chosen) == LONGEST:
            return steps, threshold
        chosen.append(pick)
        values = scale * sums.solve(chosen, moments[0])[-len(sums.columns[pick + 1]) :]
        steps.append(MapStep(maps[pick], values, 1 - now / total, 1 - after[pick] / total))
        now = after[pick]
    return steps, 1.0


# --- the shape of a map in words -----------------------------------------------------------------


def described(step: MapStep, unit: str) -> str:
    """Return the shape that a map of one signal has in a chart; `unit`: of the torque."""
    own, f = step.map, step.values
    if own.kind == "sign(v)":
        return f"a step of {2 * abs(f[0]):.3g} {unit} at v = 0"
    if own.kind == "bands":
        return "two bands, one for each direction, that widen with the load"
    x, weight = own.knots, own.columns.sum(axis=0)
    f = f - np.average(f, weights=weight)
    size = float(np.average(f**2, weights=weight)) or 1e-300

    def explained(*shapes: np.ndarray) -> float:
        """Return the share of f that a combination of shapes explains, beside a constant."""
        A = np.stack([np.ones_like(f), *shapes], axis=1) * np.sqrt(weight)[:, None]
        b = f * np.sqrt(weight)
        error = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
        return float((b @ b - error @ error) / weight.sum()) / size

    if explained(x) > ALIKE:
        slope = np.polyfit(x, f, 1, w=np.sqrt(weight))[0]
        line = "drift" if own.kind == "t" else "straight line"
        return f"a {line} of {slope:.3g} {unit} per {own.unit}"
    jump = np.clip(x / (x[1] - x[0]), -1.0, 1.0)
    if own.kind == "v" and explained(jump) > ALIKE:
        return f"a step of about {np.ptp(f):.2g} {unit} at v = 0"
    if own.kind == "v" and explained(jump, x) > ALIKE:
        return "a step at v = 0 and a slope"
    upper, lower = x[-1] - OUTER * np.ptp(x), x[0] + OUTER * np.ptp(x)
    kinks = [(explained(np.maximum(0, x - at)), at, "upper") for at in x[:-1] if at >= upper]
    kinks += [(explained(np.maximum(0, at - x)), at, "lower") for at in x[1:] if at <= lower]
    if kinks and max(kinks)[0] > ALIKE:
        _, at, end = max(kinks)
        return f"level, then a kink at the {end} end, from {at:.3g} {own.unit}"
    turns = _turns(f)
    if turns >= 3 and own.name.startswith("q."):
        return f"a wave of about {np.ptp(x) * 2 / (turns + 1):.2g} {own.unit}"
    even = x - x[weight > 0].mean() if own.kind == "q" else x
    if explained(even**2) > ALIKE or turns == 1:
        return "a bow, the same at both ends"
    return "a curve" if turns < 3 else f"a curve with {turns} bends"


def _turns(f: np.ndarray) -> int:
    """Return the number of extrema inside a map that stand out by more than 0.3 of its range."""
    count, way, last = 0, 0, f[0]
    least = PROMINENT * max(float(np.ptp(f)), 1e-300)
    for value in f[1:]:
        if (way >= 0 and value > last) or (way <= 0 and value < last):
            if way == 0 and abs(value - last) < least:
                continue
            way = way or int(np.sign(value - last))
            last = value
        elif abs(value - last) > least:
            way, last, count = -way, value, count + 1
    return count
