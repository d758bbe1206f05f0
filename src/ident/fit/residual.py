"""The residual of a model on a motion, and where the model fails, joint by joint.

    share_j = (rms_j / rms(τ_j))² / Σ_i (rms_i / rms(τ_i))²

Joints weigh by their measured torque, so that N m and N, strong joints and weak ones can be added.
Where a log repeats its motion with a period T, the residual that repeats with it is no noise:

    likeness(T) = 1 − Var(q(t+T) − q(t)) / 2 Var(q)         of each independent joint that moves
    ρ_rep = corr(r(t), r(t+T))        floor = rms(r(t+T) − r(t)) / √2

Near 1, physics is missing; near 0, none is. A floor above the noise of other joints is something
missing that does not repeat, a drift perhaps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from ident.display import Displayed
from ident.equations.unknowns import Point
from ident.errors import FitError
from ident.fit.prediction import Trace, squares_of, trace_of
from ident.fit.residual_maps import (
    ERRORS,
    MapStep,
    Memory,
    SignalMap,
    depends_on,
    described,
    folds,
    memory_of,
    own_correlation,
    own_maps,
    signal_maps,
)
from ident.information.blocks import Error, Squares
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, State
from ident.motion.signals import runs

FAR = 1e4  # s, beyond which no experiment begins by its own clock
ROUNDING = 1e-9  # of the torque: a smaller residual is none
PARTS = 50  # of an experiment that one window is
SHORTEST, LONGEST = 0.1, 1.0  # s, of a window
WINDOW_LARGER = 2.0  # times the median of local rms values
MOST = 5  # windows
NEAR = 0.06  # s on either side of a reversal
SLOW = 0.25  # of the top speed: a faster joint is not about to reverse
END = 0.1  # of the range at either end
TOP = 0.75  # quantile above which a speed, an acceleration or a load is high
LARGER = 1.5  # ratio of rms that stands out
SURE = 3.0  # standard errors by which it must
FULL = 2 * np.pi  # rad; a joint that turns further has no ends
ALIKE = 0.98  # likeness of two periods of one motion
SAME = 0.005  # likeness by which a shorter period may be worse than the best
APART = 0.5  # likeness below which the motion has left where it was
CHANCE = 0.4  # correlation between periods that noise of the best logs had been seen to have
MOVING = 0.05  # share of samples in which a joint moves, for it to count
FINE = 16  # samples a period of the motion's bandwidth, from which periods are found
FEWEST = 16  # samples, and pairs of rows, from which a period can be told


class Model(Protocol):
    """A mechanism with the values of all its parameters: a fit, or one read from a file."""

    @property
    def mechanism(self) -> Mechanism:
        """With its effects."""

    @property
    def point(self) -> Point:
        """Values of all parameters."""

    @property
    def name(self) -> str:
        """In tables."""

    @property
    def motion(self) -> Motion | None:
        """Data of the fit; None if it was read from a file."""


@dataclass(frozen=True)
class Window:
    """A stretch of time [s] in which the local rms [N m | N] stands out."""

    experiment: str
    start: float
    stop: float
    rms: float

    def __str__(self) -> str:
        return f"{self.start:.4g}–{self.stop:.4g} s"


@dataclass(frozen=True)
class Regime:
    """The residual of a joint in one regime.

    Attributes:
        name: `reversal`, `standstill`, `high speed`, `lower end`, `upper end`,
            `high acceleration` or `high load`.
        rms: in it [N m | N]; ratio: to the rms of all other rows.
        share: of the rows.
        stands_out: whether the ratio is above 1.5 by more than chance.
    """

    name: str
    rms: float
    ratio: float
    share: float
    stands_out: bool

    def __str__(self) -> str:
        return f"{self.name} ×{self.ratio:.2g}"


@dataclass(frozen=True)
class Dependence:
    """A signal on which a residual depends.

    Attributes:
        signal: `q.<joint>`, `v.`, `a.`, `load.`, `sign(v).` or `t`.
        r2: what it adds to the share of the residual's variance that is explained, held out.
        seen: what a person sees when the residual is drawn against it.
    """

    signal: str
    r2: float
    seen: str

    def __str__(self) -> str:
        return f"{self.signal} (R² {self.r2:.2f}: {self.seen})"


@dataclass(frozen=True, repr=False)
class Failure(Displayed):
    """How the model fails in one joint.

    Attributes:
        joint: an independent one; unit: of its torque.
        rms, relative: of the residual; share: of the weighted sum of squares over all joints.
        offset: mean of the residual [N m | N].
        worst: stretches of time that stand out, the worst first.
        regimes: of the joint's motion, the most conspicuous first.
        depends_on: signals, the most important first.
        memory: autocorrelation beyond the filter's length, and its threshold.
        repeats: correlation of the residual between periods of the motion, if the log has any.
        threshold: R² below which a signal explains no more than it would of noise.
        white: whether the residual is noise: no memory, no signal above the threshold, and nothing
            that repeats with the motion.
    """

    joint: str
    unit: str
    rms: float
    relative: float | None
    share: float
    offset: float
    worst: tuple[Window, ...]
    regimes: tuple[Regime, ...]
    depends_on: tuple[Dependence, ...]
    memory: Memory
    repeats: float | None
    threshold: float
    white: bool

    @property
    def stands_out(self) -> tuple[Regime, ...]:
        """The regimes in which the residual is larger than elsewhere."""
        return tuple(regime for regime in self.regimes if regime.stands_out)

    @property
    def json(self) -> dict[str, Any]:
        """As `where` of diagnosis.json has it, and the figures behind."""
        return {
            "joint": self.joint,
            "rms": self.rms,
            "relative": self.relative,
            "unit": self.unit,
            "share": self.share,
            "offset": self.offset,
            "depends_on": [each.signal for each in self.depends_on],
            "r2": [each.r2 for each in self.depends_on],
            "seen": [each.seen for each in self.depends_on],
            "r2_threshold": self.threshold,
            "worst": [[each.start, each.stop] for each in self.worst],
            "worst_log": [each.experiment for each in self.worst],
            "regimes": {each.name: each.ratio for each in self.regimes},
            "stands_out": [each.name for each in self.stands_out],
            "autocorrelation": self.memory.value,
            "autocorrelation_threshold": self.memory.threshold,
            "repeats": self.repeats,
            "white": self.white,
        }


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
        logs = [f"{name}: {self.count[name]} × {T:.4g} s" for name, T in self.period.items()]
        rho = ", ".join(f"{joint} {value:.2f}" for joint, value in self.rho.items())
        floor = ", ".join(f"{joint} {value:.2g}" for joint, value in self.floor.items())
        return (
            f"the motion repeats ({'; '.join(logs)}); correlation of the residual between periods: "
            f"{rho}; what does not repeat, rms: {floor}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Residual(Displayed):
    """A model's residual on a motion. Made by `residual_of`.

    Attributes:
        name: the model's; model: the fit, or the fit.json read back.
        motion: data of the residual.
        joints: independent coordinates (d,), in which torques are compared; units: of their
            torques; coordinate_units: of their positions.
        signals: names of all joints (J,), the order of q, v and a.
        traces: one an experiment.
    """

    name: str
    model: Model
    motion: Motion
    joints: tuple[str, ...]
    units: tuple[str, ...]
    coordinate_units: tuple[str, ...]
    signals: tuple[str, ...]
    traces: tuple[Trace, ...]

    @cached_property
    def errors(self) -> dict[str, Error]:
        """rms and relative error by joint, over all rows, as `Fit.train` has them."""
        total = Squares.zero(len(self.joints))
        for trace in self.traces:
            total = total + squares_of(trace.residual, trace.measured)
        return total.errors(self.joints, self.units)

    @cached_property
    def parts(self) -> dict[str, np.ndarray]:
        """rms (d,) of `measured`, each part, `gravity` and `residual` over all rows."""
        names = ("measured", "gravity", "residual")
        whole = {name: _rms([getattr(trace, name) for trace in self.traces]) for name in names}
        parts = {
            name: _rms([trace.parts[name] for trace in self.traces])
            for name in self.traces[0].parts
        }
        return {"measured": whole.pop("measured"), **parts, **whole}

    @cached_property
    def own(self) -> dict[str, np.ndarray]:
        """rms (d,) of the parts of each joint's own row; empty for a tree."""
        names = self.traces[0].own
        return {name: _rms([trace.own[name] for trace in self.traces]) for name in names}

    @cached_property
    def where(self) -> tuple[Failure, ...]:
        """Where the model fails: one entry a joint, the largest share first."""
        return where(self)

    @cached_property
    def periods(self) -> Periods | None:
        """Repetition of the motion and of the residual; None where no log repeats its motion."""
        return _periods(self)

    def zero(self, trace: Trace) -> float:
        """Return where a trace's time is counted from [s]: its log's start if far from 0."""
        return next(zero_of(e.t) for e in self.motion.experiments if e.name == trace.name)

    @property
    def rows(self) -> int:
        """Number of rows over all experiments."""
        return sum(len(trace) for trace in self.traces)

    @property
    def rate(self) -> float:
        """Rows a second [Hz]."""
        longest = max(self.traces, key=len)
        t = longest.t[max(longest.runs(), key=lambda each: each.stop - each.start)]
        return (len(t) - 1) / float(t[-1] - t[0]) if len(t) > 1 else 1.0

    def signal(self, name: str) -> tuple[list[np.ndarray], str]:
        """Return the signal `name` (as `depends_on` has it), (n,) of each trace, and its unit."""
        kind, _, joint = name.partition(".")
        if kind == "t":
            return [trace.t for trace in self.traces], "s"
        if kind == "load":
            u = self.joints.index(joint)
            return [trace.load[:, u] for trace in self.traces], self.units[u]
        i = self.signals.index(joint)
        per = {"q": "", "v": "/s", "a": "/s²"}
        unit = self.coordinate_units[i] + per[kind] if kind in per else ""
        array = kind if kind in per else "direction"
        return [getattr(trace, array)[:, i] for trace in self.traces], unit


def residual_of(model: Model, motion: Motion | None = None, *, name: str = "") -> Residual:
    """Return the torque that a model leaves unexplained, and the parts of its prediction.

    Args:
        model: a fit, or a fit.json read back.
        motion: of which log; default: the one that the fit was made from.
        name: of the model; default: the file's, or the effects in it.

    Raises:
        FitError: if a model read from a file comes without a motion, or no stretch of the motion is
            long enough for its filter.
    """
    motion = model.motion if motion is None else motion
    if motion is None:
        raise FitError("a fit read from a file has no motion; give motion=ident.complete(…)")
    mechanism = model.mechanism
    traces = [trace_of(mechanism, model.point, motion, e) for e in motion.experiments]
    if not any(len(trace) for trace in traces):
        lost = ", ".join(trace.name for trace in traces)
        raise FitError(
            f"{lost}: no stretch is long enough for the filter ({motion.band.cutoff:.3g} Hz); "
            "give a longer log or a higher --cutoff"
        )
    return Residual(
        name=name or model.name,
        model=model,
        motion=motion,
        joints=motion.independent,
        units=tuple(mechanism.joint(each).force_unit for each in motion.independent),
        coordinate_units=tuple(joint.unit for joint in mechanism.joints),
        signals=tuple(joint.name for joint in mechanism.joints),
        traces=tuple(trace for trace in traces if len(trace)),
    )


def zero_of(t: np.ndarray) -> float:
    """Return the first of some stamps (n,) [s] if far from 0, as seconds since 1970 are; else 0."""
    return float(t[0]) if abs(float(t[0])) > FAR else 0.0


def _rms(pieces: list[np.ndarray]) -> np.ndarray:
    total = sum(((x**2).sum(axis=0) for x in pieces), np.zeros(pieces[0].shape[1]))
    return np.asarray(np.sqrt(total / max(sum(len(x) for x in pieces), 1)))


# --- where a model fails -------------------------------------------------------------------------


def where(residual: Residual) -> tuple[Failure, ...]:
    """Return where the model of a `residual` fails: one entry a joint, the largest share first."""
    torque = residual.parts["measured"]
    strongest = float(torque.max(initial=0.0)) or 1.0  # stands in for a joint without torque
    rms = np.array([residual.errors[joint].rms for joint in residual.joints])
    squares = rms**2 / np.where(torque > 0, torque, strongest) ** 2
    shares = squares / squares.sum() if squares.sum() > 0 else np.zeros(len(squares))
    maps = signal_maps(residual.signal, residual.signals, residual.joints)
    fold = folds([len(trace) for trace in residual.traces])
    failures = [
        _failure(residual, joint, float(share), maps, fold)
        for joint, share in zip(residual.joints, shares, strict=True)
    ]
    return tuple(sorted(failures, key=lambda each: -each.share))


def _failure(
    residual: Residual, joint: str, share: float, maps: Sequence[SignalMap], fold: np.ndarray
) -> Failure:
    u, error, again = residual.joints.index(joint), residual.errors[joint], residual.periods
    pieces = [trace.residual[run, u] for trace in residual.traces for run in trace.runs()]
    memory = memory_of(pieces, residual.motion.band.cutoff, residual.rate)
    r = np.concatenate(pieces)
    nothing = error.rms <= ROUNDING * float(residual.parts["measured"].max(initial=0.0))
    steps: list[MapStep] = []
    threshold = 1.0
    if not nothing:
        rows = np.concatenate([trace.informed[:, u] for trace in residual.traces])
        ends = np.append(0, np.cumsum(rows))[np.cumsum([0, *map(len, pieces)])]
        together = [slice(int(a), int(b)) for a, b in pairwise(ends) if b - a > 3]
        mine = own_maps(residual.signal, joint, maps)
        if not rows.all():
            mine = [replace(each, columns=each.columns[rows]) for each in mine]
        steps, threshold = depends_on(r[rows], fold[rows], mine, together)
    repeats = again is not None and again.rho[joint] > again.chance
    return Failure(
        joint=joint,
        unit=error.unit,
        rms=error.rms,
        relative=error.relative,
        share=share,
        offset=float(r.mean()),
        worst=() if nothing else _worst(residual, u, memory.effective),
        regimes=() if nothing else _regimes(residual, joint, memory.effective),
        depends_on=tuple(
            Dependence(step.map.name, step.after - step.before, described(step, error.unit))
            for step in steps
        ),
        memory=memory,
        threshold=threshold,
        repeats=again.rho[joint] if again else None,
        white=nothing or (memory.noise and not steps and not repeats),
    )


def _worst(residual: Residual, u: int, effective: float) -> tuple[Window, ...]:
    """Return the stretches of time that stand out, the one with the largest sum of squares first.

    `effective` is the number of independent rows: noise alone makes short windows vary.
    """
    pieces = []
    for trace in residual.traces:
        width = float(np.clip((trace.t[-1] - trace.t[0]) / PARTS, SHORTEST, LONGEST))
        for run in trace.runs():
            r, t = trace.residual[run, u], trace.t[run]
            step = (t[-1] - t[0]) / max(len(t) - 1, 1) or width
            size = int(np.clip(round(width / step), min(3, len(r)), len(r)))
            count = np.convolve(np.ones(len(r)), np.ones(size), "same")
            local = np.sqrt(np.convolve(r**2, np.ones(size), "same") / count)
            pieces.append((trace.name, t, r, local, size))
    every = np.concatenate([piece[3] for piece in pieces])
    rows = float(np.mean([piece[4] for piece in pieces])) * effective / residual.rows
    limit = max(WINDOW_LARGER, 1 + 4 / np.sqrt(2 * max(rows, 0.5))) * float(np.median(every))
    limit = max(limit, float(np.sqrt(np.mean(every**2))))
    windows = []
    for name, t, r, local, _ in pieces:
        for run in runs(local > limit):
            if run.stop - run.start >= 2:
                squares = float((r[run] ** 2).sum())
                rms = float(np.sqrt(np.mean(r[run] ** 2)))
                windows.append((squares, Window(name, float(t[run][0]), float(t[run][-1]), rms)))
    windows.sort(key=lambda each: -each[0])
    return tuple(window for _, window in windows[:MOST])


def _regimes(residual: Residual, joint: str, effective: float) -> tuple[Regime, ...]:
    """Return the regimes that occur, the most conspicuous first; `effective`: independent rows."""
    u, i = residual.joints.index(joint), residual.signals.index(joint)
    r = np.concatenate([trace.residual[:, u] for trace in residual.traces])
    endless = residual.coordinate_units[i] == "rad"
    regimes = []
    for name, inside in _masks(residual.traces, u, i, endless):
        n, others = int(inside.sum()), int((~inside).sum())
        if min(n, others) < 5:
            continue
        rms, rest = np.sqrt(np.mean(r[inside] ** 2)), np.sqrt(np.mean(r[~inside] ** 2))
        ratio = float(rms / rest) if rest > 0 else 1.0
        error = np.sqrt(0.5 * len(r) / effective * (1 / n + 1 / others))  # of ln(rms / rest)
        out = ratio > LARGER and np.log(ratio) > SURE * error
        regimes.append(Regime(name, float(rms), ratio, n / len(r), bool(out)))
    return tuple(sorted(regimes, key=lambda each: -each.ratio))


def _masks(
    traces: Sequence[Trace], u: int, i: int, endless: bool
) -> Iterator[tuple[str, np.ndarray]]:
    q, v, a = (np.concatenate([getattr(trace, x)[:, i] for trace in traces]) for x in "qva")
    load = np.abs(np.concatenate([trace.load[:, u] for trace in traces]))
    still = np.concatenate([np.abs(trace.v[:, i]) < trace.still[i] for trace in traces])
    turning = np.concatenate([_reversals(trace, i) for trace in traces])
    yield "reversal", turning
    yield "standstill", still & ~turning
    moving = ~still
    if moving.sum() < 5:
        return
    yield "high speed", moving & (np.abs(v) >= np.quantile(np.abs(v[moving]), TOP))
    low, high = q.min(), q.max()
    if high - low <= FULL or not endless:
        yield "lower end", q < low + END * (high - low)
        yield "upper end", q > high - END * (high - low)
    yield "high acceleration", np.abs(a) >= np.quantile(np.abs(a), TOP)
    yield "high load", load >= np.quantile(load, TOP)


def _reversals(trace: Trace, i: int) -> np.ndarray:
    """Return the rows (n,) within 60 ms of a change of the direction in which joint i moves."""
    reversing = np.zeros(len(trace), dtype=bool)
    v, still = trace.v[:, i], trace.still[i]
    for run in trace.runs():
        t = trace.t[run]
        moving = np.flatnonzero(np.abs(v[run]) >= still) + run.start
        turned = np.sign(v[moving[1:]]) != np.sign(v[moving[:-1]])
        before, after = trace.t[moving[:-1][turned]], trace.t[moving[1:][turned]]
        quick = after - before < 2 * NEAR + 2 * (t[-1] - t[0]) / len(t)
        middle = (before + after)[quick] / 2
        if len(middle):
            at = np.searchsorted(middle, t)
            near = [np.abs(t - middle[np.clip(at - k, 0, len(middle) - 1)]) for k in (0, 1)]
            reversing[run] = np.minimum(*near) <= NEAR
    return reversing & (np.abs(v) < max(SLOW * np.abs(v).max(initial=0.0), still))


# --- repetition ----------------------------------------------------------------------------------


def _periods(residual: Residual) -> Periods | None:
    repeated: dict[str, tuple[Trace, float, int, float]] = {}
    traces = list(residual.traces)  # in the order of the experiments, of which some have no rows
    for e in residual.motion.experiments:
        if not traces or (traces[0].name, traces[0].t[0] < e.t[0]) != (e.name, False):
            continue
        trace = traces.pop(0)
        if (period := _period(e, residual)) is not None:
            name = e.name if e.name not in repeated else f"{e.name} ({len(repeated) + 1})"
            repeated[name] = trace, *period
    pairs = [_pairs(trace, T) for trace, T, _, _ in repeated.values()]
    if sum(len(early) for early, _ in pairs) < FEWEST:
        return None
    first, second = (np.concatenate(each) for each in zip(*pairs, strict=True))
    rho, floor = {}, {}
    for u, joint in enumerate(residual.joints):
        a, b = first[:, u] - first[:, u].mean(), second[:, u] - second[:, u].mean()
        rho[joint] = float(a @ b / max(np.sqrt((a @ a) * (b @ b)), 1e-300))
        floor[joint] = float(np.sqrt(np.mean((first[:, u] - second[:, u]) ** 2) / 2))
    own = own_correlation(residual.motion.band.cutoff, residual.rate)
    independent = len(first) / float(1 + 2 * (own**2).sum())
    return Periods(
        period={name: T for name, (_, T, _, _) in repeated.items()},
        count={name: n for name, (_, _, n, _) in repeated.items()},
        likeness=min(like for _, _, _, like in repeated.values()),
        rho=rho,
        floor=floor,
        chance=max(CHANCE, ERRORS / float(np.sqrt(max(independent, 1.0)))),
    )


def _period(e: State, residual: Residual) -> tuple[float, int, float] | None:
    """Return the period [s], number of periods and likeness of a motion, in its longest run."""
    run = max(e.segments(), key=lambda each: each.stop - each.start, default=slice(0, 0))
    stride = max(1, int(e.rate / (FINE * max(residual.motion.band.motion, 1e-9))))
    t, y, yd = (x[run][::stride] for x in (e.t, e.y, e.yd))
    if len(t) < FEWEST:
        return None
    at = np.array([residual.signals.index(joint) for joint in residual.joints])
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
    """Return the likeness by lag (n // 2 + 3,); whole turns between periods do not count."""
    n = len(q)
    x = q - q.mean()
    lags = np.arange(n // 2 + 3)
    product = np.fft.irfft(np.abs(np.fft.rfft(x, 2 * n)) ** 2)[: len(lags)]
    s, ss = (np.concatenate([[0.0], np.cumsum(y)]) for y in (x, x**2))
    pairs = n - lags
    mean = (s[n] - s[lags] - s[pairs]) / pairs
    difference = (ss[n] - ss[lags] + ss[pairs] - 2 * product) / pairs - mean**2
    rise = np.linspace(q[0], q[-1], n)  # a joint that turns on and on varies about this
    return np.asarray(1 - difference / (2 * max(float(np.var(q - rise)), 1e-300)))


def _pairs(trace: Trace, T: float) -> tuple[np.ndarray, np.ndarray]:
    """Return r(t) and r(t + T) (m, d), at the rows t."""
    run = max(trace.runs(), key=lambda each: each.stop - each.start)
    t, r = trace.t[run], trace.residual[run]
    early = t + T <= t[-1] + 1e-9
    if not early.any():
        return r[:0], r[:0]
    return r[early], CubicSpline(t, r)(np.minimum(t[early] + T, t[-1]))
