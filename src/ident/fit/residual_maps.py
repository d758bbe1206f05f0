"""What a residual depends on: smooth maps of signals, and periods with which it repeats.

    f(x) = Σ_k c_k h_k(x)                             h_k: hat functions of evenly spaced knots
    R² = 1 − Σ_folds ‖r − Φ ĉ₋fold‖² / Σ_folds ‖r − r̄₋fold‖²        ĉ by least squares

The direction of motion has a column of its own, since a step is no smooth map; so has a joint's own
load for bands that widen with it, |load| sign(v). Signals are chosen one after the other (greedy,
forward), so that one that only copies another earns nothing; each must beat what it would earn on
noise with the spectrum of the present residual, by the partial regression of a diagnosis.

Where a log repeats its motion with a period T, the residual that repeats with it is no noise:

    likeness(T) = 1 − Var(q(t+T) − q(t)) / 2 Var(q)         of each independent joint that moves
    ρ = corr(r(t), r(t+T))

Near 1, physics is missing; near 0, none is. What the model lacks and the steps of an encoder are
the same in each of K periods, which are then not independent: the variance of a parameter is
1 + (K − 1) ρ times as large (Kish, Survey Sampling, 1965, 5.4: the design effect of clusters).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ident.equations.filter import Decimator
from ident.faults.channel_fits import SAME_SHAPE
from ident.finding import Finding
from ident.fit.prediction import Trace
from ident.information.blocks import Part
from ident.information.chance import surrogates
from ident.information.hypotheses import PartialRegression
from ident.information.projection import VISIBLE
from ident.motion import Motion, State

KNOTS, KNOTS_WAVE, KNOTS_TIME = 9, 41, 4  # work: of a map; of a joint's own position; of time
JOINTS = 12  # work: whose signals are compared
# tuned: share of the residual's variance that makes a signal, or another map, matter: with 0.05 the
# TX40's joint 5 depended on the sign of v.joint_6, to which it is coupled by viscous friction
LEAST = 0.03
SLACK = 1e-6  # numerics: of a share, by which the most that it can be may be off
LEAST_OF_HALVES = 0.25  # level: half of its size, that maps of both halves must explain
SIGNALS = 4  # shown: of one joint
DRAWS = 60  # work: surrogates of noise
FEWEST = 20  # work: rows of which signals can be told
MEMORY = 0.15  # tuned: autocorrelation beyond the filter's length that is always taken for noise
ERRORS = 4.0  # level: or so many of its standard errors
FARTHEST = 400  # work: lags of the autocorrelation
UNFILTERED = 2  # range: lags at which differentiated noise is correlated without any filter
FINER = 10  # work: samples a row at which the filter's own correlation is computed
SIGNAL_ROUNDING = 1e-9  # numerics: of a signal: a smaller change is none

Signal = Callable[[str], tuple[Sequence[np.ndarray], str]]


# --- correlation in time ----------------------------------------------------------------------


@dataclass(frozen=True)
class Memory:
    """Largest autocorrelation of a series beyond the length of its filter."""

    value: float  #: the autocorrelation
    threshold: float  #: below which |value| is noise, 0.15 or four standard errors (Bartlett)
    effective: float  #: number of independent rows, n / Σ r² of the filter alone

    @property
    def noise(self) -> bool:
        """Whether rows farther apart than the filter is long are uncorrelated."""
        return abs(self.value) <= self.threshold


def _autocorrelation(runs: Sequence[np.ndarray], lags: int) -> np.ndarray:
    """Return r (lags + 1,) of a series in runs without a gap, about their mean; r[0] = 1."""
    mean = np.concatenate(runs).mean()
    total, pairs = np.zeros((2, lags + 1))
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
    of_filter = own_correlation(cutoff, rate)
    first, last = len(of_filter) + 1, min(longest // 3, FARTHEST)
    r = _autocorrelation(runs, max(last, first))
    effective = n / float(1 + 2 * ((of_filter if cutoff else r[1:first]) ** 2).sum())
    if last <= first:
        return Memory(0.0, MEMORY, effective)
    lags = np.arange(first, last + 1)
    pairs = sum(np.maximum(len(run) - lags, 0) for run in runs) * effective / n
    limit = np.maximum(MEMORY, ERRORS / np.sqrt(pairs))
    worst = int(np.argmax(np.abs(r[lags]) / limit))
    return Memory(float(r[lags[worst]]), float(limit[worst]), effective)


# --- maps of signals -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SignalMap:
    """One signal (`v.elbow`, `sign(v).elbow`, `t`, …) and the columns (n, c) of its map."""

    name: str
    columns: np.ndarray

    def of_rows(self, rows: np.ndarray) -> SignalMap:
        """Return the map on some rows, a mask (n,), without columns that are zero there."""
        columns = self.columns[rows]
        return SignalMap(self.name, columns[:, columns.any(axis=0)])


def _hats(name: str, x: np.ndarray, count: int) -> SignalMap:
    """Return the map of a signal (n,) by hat functions over its range, of those with samples."""
    knots = np.linspace(x.min(), x.max(), count)
    at = (x - knots[0]) / max(knots[1] - knots[0], 1e-300)
    columns = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(count)))
    return SignalMap(name, columns[:, columns.any(axis=0)])


def signal_maps(
    signal: Signal, joints: Sequence[str], independent: Sequence[str]
) -> list[SignalMap]:
    """Return the maps of time and of all joints' signals (`Residual.signal`), on all rows."""
    since = np.concatenate([t - t[0] for t in signal("t")[0]])
    maps = [_hats("t", since, KNOTS_TIME)]
    others = [name for name in joints if name not in independent]
    for joint in [*independent, *others[: max(0, JOINTS - len(independent))]]:
        direction = np.concatenate(signal(f"sign(v).{joint}")[0])[:, None]
        maps.append(SignalMap(f"sign(v).{joint}", direction))
        for kind in ("v", "q", "a", "load") if joint in independent else ("v", "q", "a"):
            x = np.concatenate(signal(f"{kind}.{joint}")[0])
            if np.ptp(x) > SIGNAL_ROUNDING * np.abs(x).max():
                maps.append(_hats(f"{kind}.{joint}", x, KNOTS))
        if joint in independent:
            load = np.concatenate(signal(f"load.{joint}")[0])
            bands = np.abs(load)[:, None] / max(float(np.abs(load).max()), 1e-300)
            maps.append(SignalMap(f"load.{joint}", np.hstack([direction, bands * direction])))
    return [
        signal_map
        for signal_map in maps
        if np.ptp(signal_map.columns, axis=0).max() > SIGNAL_ROUNDING
    ]


def own_maps(signal: Signal, joint: str, maps: Sequence[SignalMap]) -> list[SignalMap]:
    """Return maps in one joint's order of preference, with a fine one of its position for waves."""
    every, position = list(maps), f"q.{joint}"
    if any(signal_map.name == position for signal_map in maps):
        every.append(_hats(position, np.concatenate(signal(position)[0]), KNOTS_WAVE))
    return sorted(every, key=lambda signal_map: signal_map.name.partition(".")[2] != joint)


def folds(lengths: Sequence[int], count: int = 10) -> np.ndarray:
    """Return the fold (n,) of every row: whole experiments from three on, else parts of them."""
    per_log = -(-count // len(lengths)) if len(lengths) < 3 else 1
    return np.concatenate(
        [i * per_log + np.arange(n) * per_log // n for i, n in enumerate(lengths)]
    )


# --- the choice of signals -----------------------------------------------------------------------


@dataclass(frozen=True)
class Dependence:
    """A signal on which a residual depends."""

    signal: str  #: `q.<joint>`, `v.`, `a.`, `load.`, `sign(v).` or `t`
    r2: float  #: what it adds to the share of variance that those before it explain, held out

    def __str__(self) -> str:
        return f"{self.signal} (R² {self.r2:.2f})"


def depends_on(
    r: np.ndarray, fold: np.ndarray, maps: Sequence[SignalMap], runs: Sequence[slice]
) -> tuple[list[Dependence], float]:
    """Return the signals that explain a residual r (n,), the one that adds most first, and the R²
    that was needed last.

    Consecutive rows with one number in `fold` (n,) are one stretch of time; `maps` are in order of
    preference where they explain alike; `runs` of rows have no gap.
    """
    added, threshold = dict[str, float](), 1.0  # R² by signal, which may have maps of two widths
    if _undetermined(r, fold):
        return [], threshold
    now, groups = _regression(r, fold, maps)
    total, rest, random = float(now.loss.sum()), [*range(len(maps))], np.random.default_rng(0)
    while rest and len(added) < SIGNALS:
        groups_left, loss = [groups[i] for i in rest], float(now.loss.sum())
        noise = surrogates(now.residual[0], runs, DRAWS, random)[:, 0]
        asked = now.with_targets([np.column_stack([now.parts[0].Y, noise])])
        gains = asked.gains(groups_left)
        g, threshold = asked.explained(gains.by) * loss / total, LEAST
        if g.max() <= threshold:
            break
        null = asked.explained(gains.null.transpose(0, 2, 1), asked.null_losses.T)
        threshold = max(LEAST, float(null.max() * loss / total))
        if g.max() <= threshold:
            break
        near = np.flatnonzero(g >= g.max() - LEAST)
        pick = min(near, key=lambda k: (len(groups[rest[k]]), rest[k]))
        chosen = rest.pop(pick)
        now = now.extended(groups[chosen])
        name = maps[chosen].name
        added[name] = added.get(name, 0.0) + float(g[pick])
    dependences = [Dependence(name, r2) for name, r2 in added.items()]
    return sorted(dependences, key=lambda dependence: -dependence.r2), threshold


def _undetermined(r: np.ndarray, fold: np.ndarray) -> bool:
    """Return whether no signal of a residual can be told, as of few rows or of one stretch."""
    return len(r) < FEWEST or not r.any() or fold[0] == fold[-1]


def _regression(
    r: np.ndarray, fold: np.ndarray, maps: Sequence[SignalMap]
) -> tuple[PartialRegression, list[np.ndarray]]:
    """Return a residual with its mean in the model, and maps by the places of their columns."""
    X = np.hstack([np.ones((len(r), 1)), *(signal_map.columns for signal_map in maps)])
    ends = np.cumsum([1, *(signal_map.columns.shape[1] for signal_map in maps)])
    edges = np.array([0, *(np.flatnonzero(np.diff(fold)) + 1), len(r)])
    r = r / float(np.sqrt(np.mean(r**2)))  # squares are compared
    part = Part(0, np.arange(ends[-1]), X, r[:, None], edges)
    now = PartialRegression((part,), np.zeros(1, dtype=np.intp), np.ones(1))
    return now, [np.arange(a, b) for a, b in pairwise(ends)]


def _shares(now: PartialRegression, groups: Sequence[np.ndarray]) -> np.ndarray:
    """Return the share of the left-out squares that each group of columns explains."""
    return now.explained(now.gains(groups).by)


@dataclass(frozen=True, eq=False)
class ExplainedBounds:
    """The most that maps can explain of residuals: a bound that takes few products of columns.

    With T such that A T, A = [1 Φ], are orthonormal columns, G_k = TᵀA_kᵀA_k T of stretch k,
    α = TᵀAᵀr and c_k = TᵀA_kᵀr − G_k α, stretches that are left out have errors with the squares

        rᵀr − αᵀα + Σ_k Σ_m (m + 1) c_kᵀ G_k^(m − 1) c_k,    m ≥ 1

    as |(I − H)⁻¹ e|² = Σ_m (m + 1) eᵀ H^m e: no term is negative, and the first ones are a bound.
    """

    fold: np.ndarray  # (n,) of every row, ascending
    _made: dict[tuple[bytes, tuple[SignalMap, ...]], MapProducts] = field(default_factory=dict)

    def most(
        self, r: np.ndarray, rows: np.ndarray, maps: Sequence[SignalMap]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds (maps,) of R², and those of maps with values of their own in each half, of
        some rows, a mask (n,), of a residual r (n,).
        """
        fold, r, shares = self.fold[rows], np.where(rows, r, 0.0), np.ones((2, len(maps)))
        if _undetermined(r[rows], fold):
            return shares[0], shares[1]
        total, by_width = _left_out_squares(r[rows], fold), dict[int, list[int]]()
        stretches = np.zeros((len(r), len(np.unique(fold))))  # r in the column of its stretch
        stretches[rows, np.unique(fold, return_inverse=True)[1]] = r[rows]
        for i in sorted(range(len(maps)), key=lambda i: maps[i].name):  # in any joint's order
            by_width.setdefault(maps[i].columns.shape[1], []).append(i)
        for of_width in by_width.values():
            chosen = tuple(maps[i] for i in of_width)
            key = rows.tobytes(), chosen
            if key not in self._made:
                columns = np.stack([x.columns[rows] for x in chosen])
                self._made[key] = MapProducts.of(columns, fold)
            products = np.stack([stretches.T @ x.columns for x in chosen])
            falls = self._made[key].falls(stretches.sum(axis=0), products)
            shares[:, of_width] = 1 - (r @ r - falls) / max(total, 1e-300)
        return shares[0], shares[1]


@dataclass(frozen=True, eq=False)
class MapProducts:
    """Products of the columns of M maps of equal width by stretch of time."""

    first: np.ndarray  # (stretches,) whether they are in the first half
    # for all rows, and for halves with values of their own: T (M, c, c) and G (M, stretches, c, c)
    factors: tuple[tuple[np.ndarray, np.ndarray], ...]

    @classmethod
    def of(cls, columns: np.ndarray, fold: np.ndarray) -> MapProducts:
        """Return those of columns (M, n, c − 1) of rows with stretches `fold` (n,)."""
        A = np.concatenate([np.ones((*columns.shape[:2], 1)), columns], axis=2)
        starts = np.append(0, np.flatnonzero(np.diff(fold)) + 1)
        first, parts = _in_first_half(fold)[starts], np.split(A, starts[1:], axis=1)
        squares = np.stack([x.swapaxes(1, 2) @ x for x in parts], axis=1)
        half = _by_half(_by_half(squares, first).swapaxes(2, 3), first).swapaxes(2, 3)
        return cls(first, (_orthonormal(squares), _orthonormal(half)))

    def falls(self, sums: np.ndarray, products: np.ndarray) -> np.ndarray:
        """Return αᵀα less the first terms of the sum (2, M), of a residual with `sums` (stretches,)
        and `products` with the columns (M, stretches, c − 1).
        """
        falls, first = [], np.broadcast_to(sums[:, None], (*products.shape[:2], 1))
        b = np.concatenate([first, products], axis=2)
        for (T, G), x in zip(self.factors, (b, _by_half(b, self.first)), strict=True):
            y = x @ T
            alpha = y.sum(axis=1)
            c = y - (G @ alpha[:, None, :, None])[..., 0]
            further = (G @ c[..., None])[..., 0]
            last = (G @ further[..., None])[..., 0]
            terms = 2 * c * c + 3 * c * further + 4 * further**2 + 5 * further * last
            falls.append((alpha**2).sum(axis=1) - terms.sum(axis=(1, 2)))
        return np.array(falls)


def _by_half(x: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Return what has [1 Φ] of stretches (M, stretches, …, c) for [1 Φ₁ Φ₂], with Φ of the `first`
    stretches (stretches,) and of the others, (M, stretches, …, 2 c − 1).
    """
    c = x.shape[-1]
    out = np.zeros((*x.shape[:-1], 2 * c - 1))
    out[..., 0] = x[..., 0]
    out[:, first, ..., 1:c] = x[:, first, ..., 1:]
    out[:, ~first, ..., c:] = x[:, ~first, ..., 1:]
    return out


def _orthonormal(squares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return T (M, c, c), zero for dependent columns, and G of squares (M, stretches, c, c)."""
    total = squares.sum(axis=1)
    of_columns = np.einsum("mii->mi", total)
    size = np.sqrt(np.where(of_columns > 0, of_columns, 1.0))
    T = np.eye(total.shape[1]) / size[:, None, :]
    T[:, 0, 1:] = -total[:, 0, 1:] / (total[:, :1, 0] * size[:, 1:])  # without their means
    values, V = np.linalg.eigh(T.swapaxes(1, 2) @ total @ T)
    new = values > VISIBLE**2
    T = T @ (V * (new / np.sqrt(np.where(new, values, 1.0)))[:, None, :])
    return T, T.swapaxes(1, 2)[:, None] @ squares @ T[:, None]


def _left_out_squares(r: np.ndarray, fold: np.ndarray) -> float:
    """Return Σ_folds ‖r − r̄₋fold‖² of r (n,)."""
    count, total, squares = (np.bincount(fold, x) for x in (np.ones(len(r)), r, r * r))
    mean = (total.sum() - total) / np.maximum(count.sum() - count, 1)
    return float((squares - 2 * mean * total + count * mean**2).sum())


def _in_first_half(fold: np.ndarray) -> np.ndarray:
    """Return which rows (n,) are in the first half of the stretches of time, by row `fold`."""
    return np.asarray(fold < np.median(np.unique(fold)))


def dependence(
    r: np.ndarray,
    rows: np.ndarray,
    maps: Sequence[SignalMap],
    runs: Sequence[slice],
    bounds: ExplainedBounds,
) -> tuple[list[Dependence], float, list[Dependence]]:  # fmt: skip
    """Return what `depends_on` does for some rows, a mask (n,), of a residual r (n,), and, where
    that is no signal, on which maps of both halves it depends.

    Columns of maps are taken only where some may explain enough.
    """
    most, most_of_halves = bounds.most(r, rows, maps)
    r, fold = r[rows], bounds.fold[rows]
    if _undetermined(r, fold):
        return [], 1.0, []

    def dependences(
        most: np.ndarray, make: Callable[[Sequence[SignalMap]], Sequence[SignalMap]]
    ) -> tuple[list[Dependence], float]:
        def within(chosen: Sequence[SignalMap]) -> Sequence[SignalMap]:
            return make(chosen if rows.all() else [x.of_rows(rows) for x in chosen])

        likely = [x for x, share in zip(maps, most, strict=True) if share > LEAST - SLACK]
        few_likely = 2 * len(likely) < len(
            maps
        )  # else the others' columns cost less than asking twice
        if not likely or (
            few_likely and _shares(*_regression(r, fold, within(likely))).max() <= LEAST
        ):
            return [], LEAST
        return depends_on(r, fold, within(maps), runs)

    steps, threshold = dependences(most, lambda chosen: chosen)
    halves = [] if steps else dependences(most_of_halves, lambda chosen: by_halves(chosen, fold))[0]
    return steps, threshold, halves


def by_halves(maps: Sequence[SignalMap], fold: np.ndarray) -> list[SignalMap]:
    """Return maps with values of their own in each half of the stretches of time, by row `fold`
    (n,): a friction that changed leaves opposite signs in both, which no map of all rows shows.
    """
    first = _in_first_half(fold)
    halves = [np.where(first[:, None], x.columns, 0.0) for x in maps]
    both = [np.hstack([x, y.columns - x]) for x, y in zip(halves, maps, strict=True)]
    return [SignalMap(x.name, y[:, y.any(axis=0)]) for x, y in zip(maps, both, strict=True)]


APART = 0.5  # level: likeness below which the motion has left where it was
MOVING = 0.05  # tuned: share of samples in which a joint moves, for it to count
FINE = 16  # work: samples a period of the motion's bandwidth, from which periods are found
LONGEST = 0.6  # range: of a log, of its period: a motion that is made twice loses its ends
FEWEST_PAIRS = 16  # work: samples, and pairs of rows, from which repetition can be determined
CHANCE = 0.4  # tuned: correlation between periods that the noise of good logs has


@dataclass(frozen=True)
class Periods:
    """Repetition of the motion, and of the residual with it."""

    period: Mapping[str, float]  #: [s], by experiment that has any
    rho: Mapping[str, float]  #: correlation of the residual between periods, by joint
    chance: float  #: correlation below which noise may repeat, 0.4 or four standard errors

    def periods(self, seconds: float) -> float:
        """Return how often the motion is repeated in so many seconds."""
        return seconds / min(self.period.values())

    @property
    def repeated(self) -> float:
        """Mean share of the residual that repeats, over joints."""
        return float(np.mean([max(0.0, rho) for rho in self.rho.values()]))

    def variance(self, seconds: float) -> float:
        """Return by how much variances over so many seconds are larger than of white residuals."""
        return 1 + max(self.periods(seconds) - 1, 0.0) * self.repeated

    def with_less(self, remaining: np.ndarray) -> Periods:
        """Return the same where shares (d,) of the residual's squares remain, of what does not
        repeat: errors of the calibration are in each period.
        """
        shares = zip(self.rho.items(), remaining, strict=True)
        rho = {name: 1 - (1 - rho) / max(share, 1e-12) for (name, rho), share in shares}
        return replace(self, rho=rho)

    def finding(self, seconds: float) -> Finding:
        """Return what a person should know of logs of so many seconds."""
        share = f"{100 * self.repeated:.0f} %"
        text = (
            f"the motion repeats every {min(self.period.values()):.4g} s and {share} of the error "
            f"with it: {self.periods(seconds):.3g} periods count as one (± are wider by "
            f"{np.sqrt(self.variance(seconds)):.3g})"
        )
        return Finding("repeated errors", text, "", (), max(self.rho.values()), self.chance)


def repetition(
    motion: Motion, traces: Sequence[Trace], joints: np.ndarray, rate: float
) -> Periods | None:
    """Return what a motion repeats of the residual in its traces, in the order of the experiments
    that have rows at a `rate` [Hz]; None where it repeats nothing. `joints` (d,): places of the
    independent joints among all.
    """
    periods, pairs, remaining = dict[str, float](), [], list(traces)
    for e in motion.experiments:
        if not remaining or remaining[0].name != e.name or remaining[0].t[0] < e.t[0]:
            continue
        trace = remaining.pop(0)
        if (period := period_of(e, joints, motion.band.motion)) is not None:
            name = e.name if e.name not in periods else f"{e.name} ({len(periods) + 1})"
            periods[name] = period
            run = max(trace.runs(), key=lambda pair: pair.stop - pair.start)
            t, r = trace.t[run], trace.residual[run]
            early = t + period <= t[-1] + 1e-9
            pairs.append((r[early], _between(t, r, np.minimum(t[early] + period, t[-1]))))
    if sum(len(early) for early, _ in pairs) < FEWEST_PAIRS:
        return None
    first, second = (np.concatenate(pair) for pair in zip(*pairs, strict=True))
    a, b = first - first.mean(axis=0), second - second.mean(axis=0)
    rho = (a * b).sum(axis=0) / np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0) + 1e-300)
    of_filter = own_correlation(motion.band.cutoff, rate)
    independent = len(first) / float(1 + 2 * (of_filter**2).sum())
    chance = max(CHANCE, ERRORS / float(np.sqrt(max(independent, 1.0))))
    return Periods(periods, dict(zip(motion.independent, map(float, rho), strict=True)), chance)


def _between(t: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return x (n, d) of equal steps t at other times (m,): cubics through four rows."""
    # SciPy's spline would take 0.2 s to import
    nodes = np.arange(min(4, len(t)))
    s = (at - t[0]) / (t[1] - t[0]) if len(t) > 1 else np.zeros(len(at))
    first = np.clip(s.astype(int) - 1, 0, len(t) - len(nodes))
    values = np.zeros((len(at), x.shape[1]))
    for k in nodes:
        others = nodes[nodes != k]
        weight = np.prod((s[:, None] - first[:, None] - others) / (k - others), axis=1)
        values += weight[:, None] * x[first + k]
    return values


def period_of(e: State, joints: np.ndarray, bandwidth: float) -> float | None:
    """Return the period [s] of the motion of some joints (d,), by their places, in its longest run;
    None if it is not repeated. `bandwidth`: of the motion [Hz].
    """
    run = max(e.segments(), key=lambda run: run.stop - run.start, default=slice(0, 0))
    stride = max(1, int(e.rate / (FINE * max(bandwidth, 1e-9))))
    t, y, yd = (x[run][::stride] for x in (e.t, e.y, e.yd))
    if len(t) < FEWEST_PAIRS:
        return None
    moves = (np.abs(yd[:, joints]) > e.still[joints]).mean(axis=0) > MOVING
    if not moves.any():
        return None
    likeness = np.min([_likeness(y[:, i]) for i in joints[moves]], axis=0)
    inner = likeness[1:-1]
    peak = (inner >= likeness[:-2]) & (inner >= likeness[2:]) & (inner >= SAME_SHAPE)
    far_lags = np.flatnonzero(likeness < APART)
    lags = 1 + np.flatnonzero(peak)
    lags = lags[lags > far_lags[0]] if len(far_lags) else lags[:0]
    if not len(lags):
        return None
    low, mid, high = likeness[lags[0] - 1 : lags[0] + 2]
    bend = low - 2 * mid + high
    exact = lags[0] + (0.5 * (low - high) / bend if bend < 0 else 0.0)
    return float(exact * (t[-1] - t[0]) / (len(t) - 1))


def _likeness(q: np.ndarray) -> np.ndarray:
    """Return the likeness by lag (LONGEST n + 3,); whole turns between periods do not count."""
    n = len(q)
    x = q - np.linspace(q[0], q[-1], n)  # a joint that turns on and on varies about this
    x -= x.mean()
    lags = np.arange(int(LONGEST * n) + 3)
    product = np.fft.irfft(np.abs(np.fft.rfft(x, 2 * n)) ** 2)[: len(lags)]
    s, ss = (np.concatenate([[0.0], np.cumsum(y)]) for y in (x, x**2))
    pairs = n - lags
    mean = (s[n] - s[lags] - s[pairs]) / pairs
    difference = (ss[n] - ss[lags] + ss[pairs] - 2 * product) / pairs - mean**2
    return np.asarray(1 - difference / (2 * max(float(np.var(x)), 1e-300)))
