"""The residual of a model on a motion, and where the model fails, joint by joint.

    share_j = (rms_j / rms(τ_j))² / Σ_i (rms_i / rms(τ_i))²

Joints weigh by their measured torque, so that N m and N, strong joints and weak ones can be added.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from ident.display import Displayed, Plotted, render
from ident.equations.motion_noise import noise_floor
from ident.equations.noise_spectrum import coloured_noise
from ident.equations.problem import block_edges, too_short
from ident.errors import FitError
from ident.faults.channel_fits import DOUBT
from ident.fit import residual_maps
from ident.fit.prediction import Prediction, Trace, predict
from ident.fit.values import Model
from ident.information.blocks import Error, Squares
from ident.information.evidence import BEYOND, EXCESS, NOISY, paired, surely_t
from ident.motion import Motion
from ident.motion.signals import runs
from ident.text import stamp

FAR = 1e4  # shown: s, beyond which no experiment begins by its own clock
TORQUE_ROUNDING = 1e-9  # numerics: of the torque: a smaller residual is none
PARTS = 50  # shown: of an experiment that one window is
SHORTEST, LONGEST = 0.1, 1.0  # shown: s, of a window
WINDOW_LARGER = 2.0  # shown: times the median of local rms values
MOST_WINDOWS = 5  # shown: windows
LEAST = 30  # shown: rows from which an error away from reversals is one

# level: times the band of a motion, as far as squares and products of its speeds reach
OVERTONES = (2.0, 3.0, 4.0)


class Charted(Plotted):
    """A noun with charts of torques and residuals: a fit, or a comparison."""

    def plot_parts(self, experiment: int = 0) -> Any:
        """Return a chart of rigid bodies, effects and residual over time, per joint and model.

        Args:
            experiment: number of the log, from 0.
        """
        return render(self, "plot_parts", experiment)

    def plot_maps(self, joint: str | None = None) -> Any:
        """Return a chart of a joint's residual against t, q, v, a and load; default: the worst's.

        Raises:
            FitError: if the joint is not an independent one.
        """
        return render(self, "plot_maps", joint)


# tuned: times the squares that a model leaves beyond noise: 11 of an unchanged arm whose model
# lacks its dry friction, 27 of one with a part of it
MISFIT = 36.0


@dataclass(frozen=True)
class Window:
    """A stretch of time [s] in which the local rms stands out."""

    experiment: str
    start: float
    stop: float

    def __str__(self) -> str:
        return f"{stamp(self.start)}–{stamp(self.stop)} s"


@dataclass(frozen=True, repr=False)
class Failure(Displayed):
    """How the model fails in one joint."""

    joint: str  #: an independent one
    unit: str  #: of its torque
    rms: float  #: of the residual
    relative: float | None  #: rms over that of the torque
    share: float  #: of the weighted sum of squares over all joints
    offset: float  #: mean of the residual [N m | N]
    worst: tuple[Window, ...]  #: stretches of time that stand out, the worst first
    depends_on: tuple[residual_maps.Dependence, ...]  #: signals, the most important first
    memory: residual_maps.Memory  #: autocorrelation beyond the filter's length, and its threshold
    repeats: float | None  #: correlation of the residual between periods, if the log has any
    threshold: float  #: R² that a signal needed last, 0.03 or more where noise explains more
    white: bool  #: no memory, no signal above the threshold, nothing that repeats with the motion
    of_motion: bool  #: whether it depends on a signal, at least by halves, or repeats

    @property
    def json(self) -> dict[str, Any]:
        """As `where` of diagnosis.json has it, and the figures behind."""
        same = ("joint", "rms", "relative", "unit", "share", "offset", "repeats", "white")
        return {
            **{name: getattr(self, name) for name in same},
            "depends_on": [entry.signal for entry in self.depends_on],
            "r2": [entry.r2 for entry in self.depends_on],
            "r2_threshold": self.threshold,
            "worst": [[entry.start, entry.stop] for entry in self.worst],
            "worst_log": [entry.experiment for entry in self.worst],
            "autocorrelation": self.memory.value,
            "autocorrelation_threshold": self.memory.threshold,
        }


@dataclass(frozen=True, eq=False, repr=False)
class Residual(Displayed):
    """A model's residual on a motion. Made by `residual_of`.

    Attributes:
        name: the model's; model: the fit, or the fit.json read back.
        motion: data of the residual.
        joints: independent coordinates (d,), in which torques are compared; units: of their
            torques; coordinate_units: of their positions.
        signals: names of all joints (J,), the order of q, v and a.
        traces: one an experiment that is not too short for the filter.
        predictions: one an experiment.
    """

    name: str
    model: Model
    motion: Motion
    joints: tuple[str, ...]
    units: tuple[str, ...]
    coordinate_units: tuple[str, ...]
    signals: tuple[str, ...]
    traces: tuple[Trace, ...]
    predictions: tuple[Prediction, ...] = ()

    @cached_property
    def errors(self) -> dict[str, Error]:
        """rms and relative error by joint, as `Fit.train` has them."""
        total = sum((trace.squares for trace in self.traces), Squares.zero(len(self.joints)))
        return total.errors(self.joints, self.units)

    @cached_property
    def errors_away_from_reversals(self) -> dict[str, float]:
        """Rms by joint [N m | N] of the rows in motion, half a period of the cut-off or more away
        from where a speed with dry friction reverses; of joints with such friction and enough rows.

        Friction jumps there, so a smooth speed that crosses zero late misses much of the torque.
        """
        mechanism, cutoff = self.model.mechanism, self.motion.band.cutoff
        dry = {name for effect in mechanism.effects if effect.jumps for name in effect.joints}
        sizes = dict[str, float]()
        for u, joint in enumerate(self.joints):
            names = dry if mechanism.closures else dry & {joint}
            felt = [self.signals.index(name) for name in names if name in self.signals]
            far = []
            for trace in self.traces:
                turns = np.diff(np.sign(trace.v[:, felt]), axis=0).any(axis=1)
                half_period = 0.5 / cutoff if cutoff else 0.0
                t = np.append(trace.t[1:][turns], trace.t[:-1][turns])
                near = np.abs(trace.t[:, None] - t).min(axis=1, initial=np.inf) <= half_period
                far.append(trace.residual[~near & trace.moving[:, u], u])
            rest = np.concatenate(far)
            if felt and len(rest) >= LEAST:
                sizes[joint] = float(np.sqrt(np.mean(rest**2)))
        return sizes

    @cached_property
    def noise(self) -> dict[str, float]:
        """By joint, the rms that noise of the sensors alone would leave [N m | N]."""
        more = self.noise_over_white
        return {joint: x * more.get(joint, 1.0) for joint, x in self._white_noise.items()}

    @cached_property
    def noise_over_white(self) -> dict[str, float]:
        """By joint, times white noise that the residual's spectrum above the motion makes, where
        more is left than white noise and depends on nothing that moves; no more than is left.

        Empty where knots are coarser than the positions ask for: what they take off is no noise.
        Empty too where in some joint what is left depends on the motion: values of bodies that
        several joints move are then wrong in all of these.
        """
        floor, band = self._white_noise, self.motion.band
        loud = [
            joint
            for joint, e in self.errors.items()
            if not e.unmeasured
            and e.rms > EXCESS * floor[joint]
            # what gathers where dry friction jumps is what a smooth speed misses of it
            and self.errors_away_from_reversals.get(joint, e.rms) > EXCESS * floor[joint]
        ]
        experiments, model = self.motion.experiments, self.model
        channels = (channel for e in experiments for channel in e.channels)
        coarse = any(c.spacing and c.residual > EXCESS * c.noise for c in channels)
        if not loud or not band.motion or coarse:
            return {}
        if any(self.failure(joint).of_motion for joint in loud):
            return {}
        bands = [times * band.motion for times in (1.0, *OVERTONES)]
        noise = coloured_noise(model.mechanism, experiments, model.point, band.cutoff, bands)
        sizes = dict(zip(self.motion.independent, noise.T, strict=True))
        more = {joint: self._believed(joint, *sizes[joint]) for joint in loud}
        ratios = {joint: x / max(floor[joint], 1e-300) for joint, x in more.items()}
        return {joint: ratio for joint, ratio in ratios.items() if ratio > EXCESS}

    def _believed(self, joint: str, noise: float, *above: float) -> float:
        """Return the `noise` that a residual shows above the motion [N m | N], no more than is
        left; or the least that it shows `above` overtones of the motion, 0 where that is unknown,
        if more is left than that is: far more, or more of an error that is large and far above
        white noise, which a wrong gain leaves more often than sensors do.
        """
        error, least = self.errors[joint], min(filter(None, above), default=noise)
        large = (error.relative or 0.0) > DOUBT
        large = large and error.rms > BEYOND * self._white_noise[joint]
        believed = error.rms <= (NOISY if large else BEYOND) * least
        return min(noise if believed else least, error.rms)

    @cached_property
    def _white_noise(self) -> dict[str, float]:
        return floor_of(self.model, self.motion)

    def increased_errors(self, then: Mapping[str, Error]) -> list[str]:
        """Return the joints whose error is above that of `then`, the most first: by more than it
        differs between blocks of time and motions, not because the torque or the noise is larger;
        all the time or from some block on.

            e² > (EXCESS σ)² + MISFIT (e_then² − σ²)        σ: noise; what else it left may grow
        """
        if not then:
            return []
        noise = self._white_noise
        rises, cutoff = dict[str, float](), self.motion.band.cutoff
        for u, joint in enumerate(self.joints):
            if (old := then.get(joint)) is None:
                continue
            squares: list[float] = []
            for trace in self.traces:
                edges = block_edges(cutoff, trace.t[0], trace.t[-1], len(trace))
                rows = trace.moving[:, u] if trace.moving[:, u].any() else slice(None)
                squares_of = trace.residual[rows, u] ** 2
                blocks = np.split(squares_of, np.searchsorted(trace.t[rows], edges))
                squares += [float(block.mean()) for block in blocks if len(block)]
            torque = self.parts["measured"][u]
            sigma = noise.get(joint) or 0.0
            least = max(old.rms, (old.relative or 0.0) * torque, sigma)
            allowed = (EXCESS * sigma) ** 2 + MISFIT * (least**2 - sigma**2)
            if _exceeds(np.array(squares), allowed, len(then)):
                rises[joint] = self.errors[joint].rms / max(old.rms, 1e-300)
        return sorted(rises, key=lambda joint: -rises[joint])

    @cached_property
    def parts(self) -> dict[str, np.ndarray]:
        """rms (d,) of `measured`, each part, `gravity` and `residual` over all rows."""
        sizes = {"measured": _rms([trace.measured for trace in self.traces])}
        sizes |= {name: self.rms_together([name]) for name in self.traces[0].parts}
        for name in ("gravity", "residual"):
            sizes[name] = _rms([getattr(trace, name) for trace in self.traces])
        return sizes

    def rms_together(self, names: Sequence[str]) -> np.ndarray:
        """Return the rms (d,) of the sum of some parts, by `names`."""
        parts = [[trace.parts[name] for name in names] for trace in self.traces]
        return _rms([np.sum(series, axis=0) for series in parts])

    @cached_property
    def worst(self) -> tuple[str, ...]:
        """Joints with a torque or an error, the largest share of the misfit first."""
        joints = [name for name in self.joints if not self.errors[name].unmeasured]
        return tuple(sorted(joints, key=lambda name: -self.shares[self.joints.index(name)]))

    @cached_property
    def where(self) -> tuple[Failure, ...]:
        """Where the model fails: one entry a joint, the largest share first."""
        return tuple(map(self.failure, self.worst))

    def failure(self, joint: str) -> Failure:
        """Return how the model fails in one joint."""
        if joint in self._failures:
            return self._failures[joint]
        u, again = self.joints.index(joint), self.periods
        error = self.errors[joint]
        pieces = [trace.residual[run, u] for trace in self.traces for run in trace.runs()]
        memory = residual_maps.memory_of(pieces, self.motion.band.cutoff, self.rate)
        r = np.concatenate(pieces)
        nothing = error.rms <= TORQUE_ROUNDING * float(self.parts["measured"].max(initial=0.0))
        steps: list[residual_maps.Dependence] = []
        threshold, by_halves = 1.0, False
        if not nothing:
            rows = np.concatenate([trace.informed[:, u] for trace in self.traces])
            edges = np.cumsum([0, *map(len, pieces)])
            ends = np.append(0, np.cumsum(rows))[edges]
            together = [slice(int(a), int(b)) for a, b in pairwise(ends) if b > a]
            maps = residual_maps.own_maps(self.signal, joint, self.maps)
            if together:
                steps, threshold, of_halves = residual_maps.dependence(
                    r, rows, maps, together, self.bounds
                )
                by_halves = sum(x.r2 for x in of_halves) > residual_maps.LEAST_OF_HALVES
        repeats = again is not None and again.rho[joint] > again.chance
        self._failures[joint] = Failure(
            joint=joint,
            unit=error.unit,
            rms=error.rms,
            relative=error.relative,
            share=float(self.shares[u]),
            offset=float(r.mean()),
            worst=() if nothing else _worst(self, u, memory.effective),
            depends_on=tuple(steps),
            memory=memory,
            threshold=threshold,
            repeats=again.rho[joint] if again else None,
            white=nothing or (memory.noise and not steps and not repeats),
            of_motion=bool(steps) or by_halves or repeats,
        )
        return self._failures[joint]

    @cached_property
    def _failures(self) -> dict[str, Failure]:
        return {}

    @cached_property
    def maps(self) -> list[residual_maps.SignalMap]:
        """The maps of all signals, on the rows of all experiments."""
        return residual_maps.signal_maps(self.signal, self.signals, self.joints)

    @cached_property
    def bounds(self) -> residual_maps.ExplainedBounds:
        """The most that maps can explain, on the rows of all experiments."""
        return residual_maps.ExplainedBounds(
            residual_maps.folds([len(trace) for trace in self.traces])
        )

    @cached_property
    def shares(self) -> np.ndarray:
        """Share (d,) of each joint in the squares of all residuals, relative to the torques."""
        torque = self.parts["measured"]
        strongest = float(torque.max(initial=0.0)) or 1.0  # stands in for a joint without torque
        rms = np.array([self.errors[joint].rms for joint in self.joints])
        squares = rms**2 / np.where(torque > 0, torque, strongest) ** 2
        return np.asarray(squares / (squares.sum() or 1.0))

    @cached_property
    def periods(self) -> residual_maps.Periods | None:
        """Repetition of the motion and of the residual; None where no log repeats its motion."""
        joints = np.array([self.signals.index(joint) for joint in self.joints])
        return residual_maps.repetition(self.motion, self.traces, joints, self.rate)

    def zero(self, trace: Trace) -> float:
        """Return where a trace's time is counted from [s]: its log's start if far from 0."""
        return next(zero_of(e.t) for e in self.motion.experiments if e.name == trace.name)

    def without(self, effect: str) -> Residual:
        """Return what is left where the torque of one effect is not taken off, as it was fitted."""
        rests = [{n: x for n, x in trace.parts.items() if n != effect} for trace in self.traces]
        traces = (replace(a, parts=b) for a, b in zip(self.traces, rests, strict=True))
        return replace(self, traces=tuple(traces))

    @property
    def rows(self) -> int:
        """Number of rows over all experiments."""
        return sum(map(len, self.traces))

    @property
    def rate(self) -> float:
        """Rows a second [Hz]."""
        runs = [trace.t[run] for trace in self.traces for run in trace.runs()]
        t = max(runs, key=len)
        return (len(t) - 1) / float(t[-1] - t[0]) if len(t) > 1 else 1.0

    def signal(self, name: str) -> tuple[list[np.ndarray], str]:
        """Return the signal `name` (as `depends_on` has it), (n,) of each trace, and its unit."""
        kind, _, joint = name.partition(".")
        if kind == "t":
            return [trace.t for trace in self.traces], "s"
        if kind == "load":
            u = self.joints.index(joint)
            return [trace.load[:, u] for trace in self.traces], self.units[u]
        i, per = self.signals.index(joint), {"q": "", "v": "/s", "a": "/s²"}
        if kind in per:
            unit = self.coordinate_units[i] + per[kind]
            return [getattr(trace, kind)[:, i] for trace in self.traces], unit
        return [trace.direction[:, i] for trace in self.traces], ""


def _exceeds(squares: np.ndarray, allowed: float, joints: int) -> bool:
    """Return whether mean squares of blocks (n,) are above what is `allowed` by more than chance
    makes of any of so many joints: of all of them, or of those from some block on.
    """
    usual, n = np.full(len(squares), allowed), len(squares)
    return any(
        paired(squares[k:], usual[k:]) > surely_t(joints * (n if k else 1), n - k)
        for k in range(max(n - 1, 1))
    )


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
    # a fit keeps those of its own motion
    made_before = getattr(model, "predictions", None) if motion is model.motion else None
    predictions = made_before or predict(mechanism, motion, model.point)
    traces = tuple(
        x for prediction in predictions if len(x := prediction.filtered(motion.band.cutoff))
    )
    if not traces:
        raise too_short(motion)
    units = tuple(mechanism.joint(prediction).force_unit for prediction in motion.independent)
    names, coordinate_units = zip(
        *((joint.name, joint.unit) for joint in mechanism.joints), strict=True
    )
    return Residual(
        name or model.name, model, motion, motion.independent, units, coordinate_units, names,
        traces, tuple(predictions),
    )  # fmt: skip


def floor_of(model: Model, motion: Motion) -> dict[str, float]:
    """Return the rms by joint that noise of the sensors makes in a model's residual [N m | N]."""
    cutoff = motion.band.cutoff
    floor = noise_floor(model.mechanism, motion.experiments, model.point, cutoff)
    return dict(zip(motion.independent, map(float, floor), strict=True))


def zero_of(t: np.ndarray) -> float:
    """Return the first of some stamps (n,) [s] if far from 0, as seconds since 1970 are; else 0."""
    return float(t[0]) if abs(float(t[0])) > FAR else 0.0


def _rms(pieces: list[np.ndarray]) -> np.ndarray:
    squares = sum((x**2).sum(axis=0) for x in pieces)
    return np.asarray(np.sqrt(squares / max(sum(map(len, pieces)), 1)))


# --- where a model fails -------------------------------------------------------------------------


def where(residual: Residual) -> tuple[Failure, ...]:
    """Return where the model of a `residual` fails: one entry a joint, the largest share first."""
    return residual.where


def _worst(residual: Residual, u: int, effective: float) -> tuple[Window, ...]:
    """Return the stretches of time that stand out, the one with the largest sum of squares first,
    of the rows in motion, if there are any.

    `effective` is the number of independent rows: noise alone makes short windows vary.
    """
    pieces, still = [], not any(trace.moving[:, u].any() for trace in residual.traces)
    for trace in residual.traces:
        width = float(np.clip((trace.t[-1] - trace.t[0]) / PARTS, SHORTEST, LONGEST))
        for run in trace.runs():
            r, t, moving = trace.residual[run, u], trace.t[run], trace.moving[run, u] | still
            size = int(np.clip(round(width * residual.rate), min(3, len(r)), len(r)))
            r = np.where(moving, r, 0.0)
            count = np.convolve(moving.astype(float), np.ones(size), "same")
            local = np.sqrt(np.convolve(r**2, np.ones(size), "same") / np.maximum(count, 1))
            pieces.append((trace.name, t, r, moving, local, size))
    every = np.concatenate([local[moving] for *_, moving, local, _ in pieces])
    rows = float(np.mean([piece[-1] for piece in pieces])) * effective / residual.rows
    limit = max(WINDOW_LARGER, 1 + 4 / np.sqrt(2 * max(rows, 0.5))) * float(np.median(every))
    limit = max(limit, float(np.sqrt(np.mean(every**2))))
    windows = []
    for name, t, r, moving, local, _ in pieces:
        for run in runs(local > limit):
            within = t[run][moving[run]]  # a reversal may lie in between
            if len(within) >= 2:
                window = Window(name, float(within[0]), float(within[-1]))
                windows.append((-float((r[run] ** 2).sum()), window))
    return tuple(
        window
        for _, window in sorted(windows, key=lambda window_and_size: window_and_size[0])[
            :MOST_WINDOWS
        ]
    )
