"""Signals on which a residual depends: smooth maps of them, held out in stretches of time.

    f(x) = Σ_k c_k h_k(x)                             h_k: hat functions of evenly spaced knots
    R² = 1 − Σ_folds ‖r − Φ ĉ₋fold‖² / Σ_folds ‖r − r̄₋fold‖²        ĉ by least squares

The direction of motion has a column of its own, since a step is no smooth map; so has a joint's own
load for bands that widen with it, |load| sign(v). Signals are chosen one after the other (greedy,
forward), so that one that only copies another earns nothing; each must beat what it would earn on
noise with the spectrum of the present residual, by the partial regression of a diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ident.equations.filter import Decimator
from ident.information import linear
from ident.information.hypotheses import PartialRegression
from ident.information.parts import Part

KNOTS, KNOTS_WAVE, KNOTS_TIME = 9, 41, 4  # of a map; of a joint's own position; of time
JOINTS = 12  # whose signals are compared
LEAST = 0.03  # share of the residual's variance that a signal must explain to be mentioned
SIMPLER = 0.02  # R² that is given up for the simpler map, or for the joint's own signal
SIGNALS = 4  # of one joint
DRAWS = 60  # surrogates of noise
FEWEST = 20  # rows of which signals can be told
MEMORY = 0.15  # autocorrelation beyond the filter's length that is always taken for noise
ERRORS = 4.0  # or so many of its standard errors
FARTHEST = 400  # lags of the autocorrelation
UNFILTERED = 2  # lags at which differentiated noise of encoders is correlated without any filter
FINER = 10  # samples a row at which the filter's own correlation is computed
ALIKE = 0.9  # share of a map's variation that a shape must explain to give it its name
ROUNDING = 1e-9  # of a signal: a smaller change is none
RANK = 1e-9  # of the largest singular value: below, maps of several signals are alike
PROMINENT = 0.3  # of a map's range: smaller bends are no wave

Signal = Callable[[str], tuple[Sequence[np.ndarray], str]]


# --- correlation in time, and noise of the same spectrum -----------------------------------------


@dataclass(frozen=True)
class Memory:
    """Largest autocorrelation of a series beyond the length of its filter.

    Attributes:
        value: the autocorrelation.
        threshold: below which |value| is that of noise: 0.15, or four standard errors (Bartlett).
        effective: number of independent rows, n / Σ r² of the filter alone.
    """

    value: float
    threshold: float
    effective: float

    @property
    def noise(self) -> bool:
        """Whether rows farther apart than the filter is long are uncorrelated."""
        return abs(self.value) <= self.threshold


def _autocorrelation(runs: Sequence[np.ndarray], lags: int) -> np.ndarray:
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
    taps = Decimator.of(cutoff, FINER * rate).taps
    if taps is None:
        return np.zeros(UNFILTERED)
    r = np.correlate(taps, taps, "full")[len(taps) - 1 :]
    return r[FINER : max(len(taps) // 2, UNFILTERED * FINER) + FINER : FINER] / r[0]


def memory_of(runs: Sequence[np.ndarray], cutoff: float | None, rate: float) -> Memory:
    """Return the autocorrelation of a series, in runs without a gap, beyond its filter's length."""
    n, longest = sum(map(len, runs)), max(map(len, runs))
    own = own_correlation(cutoff, rate)
    first, last = len(own) + 1, min(longest // 3, FARTHEST)
    r = _autocorrelation(runs, max(last, first))
    effective = n / float(1 + 2 * ((own if cutoff else r[1:first]) ** 2).sum())
    if last <= first:
        return Memory(0.0, MEMORY, effective)
    lags = np.arange(first, last + 1)
    pairs = sum(np.maximum(len(run) - lags, 0) for run in runs) * effective / n
    limit = np.maximum(MEMORY, ERRORS / np.sqrt(pairs))
    worst = int(np.argmax(np.abs(r[lags]) / limit))
    return Memory(float(r[lags[worst]]), float(limit[worst]), effective)


def _surrogates(runs: Sequence[np.ndarray], count: int, seed: int) -> np.ndarray:
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
    """

    name: str
    kind: str
    unit: str
    columns: np.ndarray
    knots: np.ndarray


def _hats(x: np.ndarray, name: str, kind: str, unit: str, count: int) -> SignalMap:
    """Return the map of a signal (n,) by hat functions over its range, of those with samples."""
    knots = np.linspace(x.min(), x.max(), count)
    at = (x - knots[0]) / max(knots[1] - knots[0], 1e-300)
    columns = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(count)))
    some = columns.any(axis=0)
    return SignalMap(name, kind, unit, columns[:, some], knots[some])


def signal_maps(
    signal: Signal, joints: Sequence[str], independent: Sequence[str]
) -> list[SignalMap]:
    """Return the maps of time and of all joints' signals, on the rows of all experiments.

    `signal` gives the series of each experiment and the unit by name (`Residual.signal`).
    """
    since = np.concatenate([t - t[0] for t in signal("t")[0]])
    maps = [_hats(since, "t", "t", "s", KNOTS_TIME)]
    others = [name for name in joints if name not in independent]
    for joint in [*independent, *others[: max(0, JOINTS - len(independent))]]:
        direction = np.concatenate(signal(f"sign(v).{joint}")[0])[:, None]
        maps.append(SignalMap(f"sign(v).{joint}", "sign(v)", "", direction, np.zeros(0)))
        for kind in ("v", "q", "a", "load") if joint in independent else ("v", "q", "a"):
            x, unit = _joined(signal, f"{kind}.{joint}")
            if np.ptp(x) > ROUNDING * np.abs(x).max():
                maps.append(_hats(x, f"{kind}.{joint}", kind, unit, KNOTS))
        if joint in independent:
            load, unit = _joined(signal, f"load.{joint}")
            bands = np.abs(load)[:, None] / max(float(np.abs(load).max()), 1e-300)
            columns = np.hstack([direction, bands * direction])
            maps.append(SignalMap(f"load.{joint}", "bands", unit, columns, np.zeros(0)))
    return [each for each in maps if np.ptp(each.columns, axis=0).max() > ROUNDING]


def _joined(signal: Signal, name: str) -> tuple[np.ndarray, str]:
    pieces, unit = signal(name)
    return np.concatenate(pieces), unit


def own_maps(signal: Signal, joint: str, maps: Sequence[SignalMap]) -> list[SignalMap]:
    """Return maps in one joint's order of preference, with a fine one of its position for waves."""
    every = list(maps)
    if any(each.name == f"q.{joint}" for each in maps):
        q, unit = _joined(signal, f"q.{joint}")
        every.append(_hats(q, f"q.{joint}", "wave", unit, KNOTS_WAVE))
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
    """One signal that was chosen: its map's values (c,), and the share R² that it adds."""

    map: SignalMap
    values: np.ndarray
    r2: float


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
    if len(r) < FEWEST or not r.any() or fold[0] == fold[-1]:
        return steps, 1.0
    X = np.hstack([np.ones((len(r), 1)), *(each.columns for each in maps)])
    ends = np.cumsum([1, *(each.columns.shape[1] for each in maps)])
    groups = [np.arange(a, b) for a, b in pairwise(ends)]
    edges = np.array([0, *(np.flatnonzero(np.diff(fold)) + 1), len(r)])
    chosen, total = list[int](), 0.0
    while True:
        model = np.concatenate([[0], *(groups[i] for i in chosen)])
        values = linear.lstsq(X[:, model], r, rcond=RANK)[0]
        if chosen:
            steps[-1] = replace(steps[-1], values=values[-len(groups[chosen[-1]]) :])
        unexplained = r - X[:, model] @ values
        noise = _surrogates([unexplained[run] for run in runs], DRAWS, seed=len(chosen))
        part = Part(0, np.arange(ends[-1]), X, np.column_stack([r, noise]), edges)
        now = PartialRegression((part,), model, np.ones(1))
        rest = [i for i in range(len(maps)) if i not in chosen]
        gains, loss = now.gains([groups[i] for i in rest]), float(now.loss.sum())
        total = total or loss
        chance = float((gains.null / now.null_loss).max(initial=0.0)) if rest else 1.0
        threshold = max(LEAST * total / loss, chance)
        fall = gains.G / loss
        if fall.max(initial=0.0) <= threshold or len(chosen) == SIGNALS:
            return steps, threshold
        near = np.flatnonzero(fall >= fall.max() - SIMPLER)
        pick = min(near, key=lambda k: (len(groups[rest[k]]), rest[k]))
        chosen.append(rest[pick])
        steps.append(MapStep(maps[rest[pick]], values, float(fall[pick]) * loss / total))


# --- the shape of a map in words -----------------------------------------------------------------


def described(step: MapStep, unit: str) -> str:
    """Return the shape that a map of one signal has in a chart; `unit`: of the torque."""
    from scipy.signal import find_peaks  # takes half a second to be imported

    own, f = step.map, step.values
    if own.kind == "sign(v)":
        return f"a step of {2 * abs(f[0]):.3g} {unit} at v = 0"
    if own.kind == "bands":
        return "two bands, one for each direction, that widen with the load"
    x, weight = own.knots, own.columns.sum(axis=0)

    def explained(*shapes: np.ndarray) -> float:
        """Return the share of the map that shapes explain, beside a constant."""
        root = np.sqrt(weight)
        A = np.stack([np.ones_like(f), *shapes], axis=1) * root[:, None]
        error = root * f - A @ linear.lstsq(A, root * f, rcond=None)[0]
        size = (root * (f - np.average(f, weights=weight))) ** 2
        return 1 - float(error @ error) / max(float(size.sum()), 1e-300)

    slope = np.polyfit(x, f, 1, w=np.sqrt(weight))[0]
    line = "drift" if own.kind == "t" else "straight line"
    shapes: list[tuple[str, tuple[np.ndarray, ...]]] = [
        (f"a {line} of {slope:.3g} {unit} per {own.unit}", (x,))
    ]
    if own.kind == "v":
        jump = np.clip(x / (x[1] - x[0]), -1.0, 1.0)
        shapes.append((f"a step of about {np.ptp(f):.2g} {unit} at v = 0", (jump,)))
        shapes.append(("a step at v = 0 and a slope", (jump, x)))
    shares = np.ptp(x) / 3 * np.linspace(0, 1, 7)[1:]  # in the outer thirds
    kinks = [("upper", at, np.maximum(0, x - at)) for at in x[-1] - shares]
    kinks += [("lower", at, np.maximum(0, at - x)) for at in x[0] + shares]
    end, at, kink = max(kinks, key=lambda each: explained(each[2]))
    text = f"level, then a kink at the {end} end, from {at:.3g} {own.unit}"
    for words, columns in [*shapes, (text, (kink,))]:
        if explained(*columns) > ALIKE:
            return words
    high = PROMINENT * np.ptp(f)
    turns = sum(len(find_peaks(side, prominence=high)[0]) for side in (f, -f))
    if turns >= 3 and own.name.startswith("q."):
        return f"a wave of about {np.ptp(x) * 2 / (turns + 1):.2g} {own.unit}"
    middle = x[weight > 0].mean() if own.kind == "q" else 0.0
    if turns == 1 or explained((x - middle) ** 2) > ALIKE:
        return "a bow, the same at both ends"
    return "a curve" if turns < 3 else f"a curve with {turns} bends"
